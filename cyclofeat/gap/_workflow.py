"""All missing effects at once: where, what, how large, how much better."""

from __future__ import annotations

import functools
import math
import time
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import entropy

from cyclofeat._base.checks import is_number
from cyclofeat.gap.comparison import GapSettings, bank_like, corrected_rig
from cyclofeat.gap.confirm.confirm import Confirmation, confirm_effects, draw_effects
from cyclofeat.gap.confirm.next_measurement import rank_measurements
from cyclofeat.gap.measured import SAME_LOAD, SAME_SPEED, MeasuredRig, set_points
from cyclofeat.gap.overlays import Overlay, summarise_overlays
from cyclofeat.gap.posterior.answers import ABSENT, state_of
from cyclofeat.gap.posterior.effect_posterior import EffectPosterior
from cyclofeat.gap.posterior.of_model import is_of_model, posterior_of_world
from cyclofeat.gap.proof.prove import Proof, prove_all
from cyclofeat.gap.result import LEFT, FoundEffect, GapResult, Remainder, RemainderRow, Size, VisibleFrom
from cyclofeat.gap.where.locate import LocatedGap, locate_all, where_of
from cyclofeat.gap.world.world import Session, World
from cyclofeat.recordings import Recording
from cyclofeat.recordings.recording import common_n_lobes
from cyclofeat.simulators import BrakeRotor, CycloidalGearbox, Effect, Rig
from cyclofeat.simulators.effects.library import look_alikes
from cyclofeat.simulators.simulation import torsion

Float = NDArray[np.float64]

_ROWS = 12
_VARIANTS = 200  # a probability is off by up to 0.07


def find_gap(
    measured: Iterable[Recording],
    held_out: Iterable[Recording] | None = None,
    *,
    model: Rig | None = None,
    posterior: EffectPosterior | None = None,
    settings: GapSettings | None = None,
    progress: Callable[[str], object] | None = None,
) -> GapResult:
    """Name everything that a model lacks, at once, from recordings at one condition or several.

    Parameters
    ----------
    measured : iterable of Recording
        Recordings of one rig, each with ``speed_rpm`` and at least 1.03 output turns long.
    held_out : iterable of Recording, optional
        Other recordings of the rig, at these conditions or others, on which the corrected model is judged.
    model : Rig, optional
        The simulation to correct. Default: that of the posterior, or paper B's gearbox.
    posterior : EffectPosterior, optional
        Learned from simulated rigs of the model. Default: the packaged one (:func:`load_posterior`), if it
        was learned for this model, quantity and conditions; if not, one is learned first from 3,840
        simulated rigs (some ten minutes of two cores; needs the extra ``prepare``). It is kept for the next
        time in ``settings.cache``, or in the user's cache folder.
    settings : GapSettings, optional
    progress : callable, optional
        Called with the name of each step.

    Returns
    -------
    GapResult

    Raises
    ------
    ValueError
        If recordings, model and posterior do not fit together.

    Notes
    -----
    1. Where: recordings and model are compared at each condition.
    2. What: the posterior states the probability of each effect.
    3. How large: the session is simulated with the effects that are more probable than not (of look-alikes
       that share their probability, the most probable one), with their sizes changed, and with undecided
       effects added. Sizes and sets that explain the recordings best stand. What they leave is explained by
       chance, by undecided effects, or by no effect considered.
    4. How sure: sets of effects with sizes are drawn from all that the recordings leave possible.
    5. How much better: the corrected model is judged on recordings held out.
    """
    began = time.monotonic()
    settings, say = settings or GapSettings(), progress or (lambda _: None)
    measured = tuple(measured)
    posterior = _choose_posterior(measured, model, posterior, settings, say)
    world = posterior.world
    described = functools.partial(
        MeasuredRig.of, rig=world.rig, sampling_rate=world.sampling_rate, quantity=world.quantity
    )
    rig = described(measured)
    held = None if held_out is None else described(held_out, beside=rig)
    session = rig.session(one_assembly=settings.one_assembly)
    presence = posterior.presence(session)
    say("comparing measurement and model")
    located = locate_all(rig, world, settings)
    confirmed = confirm_effects(
        posterior, session, presence,
        random_state=settings.seed, n_jobs=settings.n_jobs, progress=say,
    )  # fmt: skip
    presence |= confirmed.presence
    speeds, loads = zip(*((at.speed_rpm, at.load_nm) for at in rig.conditions), strict=True)
    ranges = {"speeds_rpm": (min(speeds), max(speeds)), "loads_nm": (min(loads), max(loads))}
    # Of any condition: its speed and load are replaced.
    comparison, at = located[0].comparison, {"gearbox": world.rig.gearbox, **ranges}
    corrected = corrected_rig(comparison, confirmed.effects).replace(**at)
    variants = draw_effects(posterior, session, confirmed, _VARIANTS, random_state=settings.seed)
    remainder = _make_remainder(world, confirmed)
    proof: tuple[Proof, ...] = ()
    if held is not None and confirmed.effects:
        say("judging on recordings held out")
        proof = prove_all(rig, held, corrected, world, settings)
    effects = _effect_rows(posterior, session, presence, confirmed, variants)
    undecided = [row for row in effects if row.state in ("probably missing", "undecided")]
    bits = {row.effect: float(entropy([row.probability, 1 - row.probability], base=2)) for row in undecided}
    left = LEFT[remainder.cause] if confirmed.effects and remainder.cause != "chance" else ""
    note = f"sizes are wider, because the corrected model leaves {left}" if left else ""
    return GapResult(
        where=tuple(where_of(gap, pictures=settings.pictures) for gap in located),
        rig=corrected,
        quantity=rig.quantity,
        posterior_rig=corrected_rig(comparison, variants=variants).replace(**at),
        effects=effects,
        named=confirmed.effects,
        remainder=remainder,
        size_note=note,
        next_measurements=rank_measurements(bits, session, world),
        overlays=_simulate_overlays(located, settings, corrected),
        proof=proof,
        warnings=(*([note] if note else ()), *rig.warnings, *rig.doubts),
        seconds=time.monotonic() - began,
    )


def _choose_posterior(
    measured: Sequence[Recording],
    model: Rig | None,
    posterior: EffectPosterior | None,
    settings: GapSettings,
    progress: Callable[[str], object],
) -> EffectPosterior:
    """Return the posterior that was given, if it is of the model, or one for the model and the recordings."""
    if posterior is None:
        model = model or Rig()
        world = MeasuredRig.of(measured, model).world(World(rig=model))
        return posterior_of_world(world, cache=settings.cache, n_jobs=settings.n_jobs, progress=progress)
    if model is not None and not is_of_model(posterior, model):
        raise ValueError(
            "posterior must have been learned from model, got one of another rig: leave posterior out to "
            "learn one, or prepare it for this model"
        )
    return posterior


def _rotor_resonance(variants: Iterable[Sequence[Effect]], gearbox: CycloidalGearbox) -> list[Size]:
    """Return the resonance of the brake's rotor on torque meter and gearbox, over drawn sets of effects."""
    hz = []
    for rotor in (effect for effects in variants for effect in effects if isinstance(effect, BrakeRotor)):
        braked = gearbox.with_brake(rotor.inertia, rotor.stiffness, rotor.damping_ratio)
        hz.append(math.sqrt(torsion(braked)[0] / braked.brake_inertia) / (2 * math.pi))
    low, middle, high = np.quantile(hz or [math.nan], [0.05, 0.5, 0.95]).tolist()
    return [Size("resonance_hz", "Hz", middle, low, high)] if hz else []


def _effect_rows(
    posterior: EffectPosterior,
    session: Session,
    presence: dict[str, float],
    confirmed: Confirmation,
    variants: Sequence[Sequence[Effect]],
) -> tuple[FoundEffect, ...]:
    """Return what is known of each effect, the most probable first."""
    guess = posterior.guess([session])[0]
    quantiles = {name: (row[0], row[2], row[-1]) for name, row in guess.sizes.items()} | confirmed.quantiles
    limits, named = posterior.visible_from, [effect.effect_id for effect in confirmed.effects]
    rows = []
    for effect in posterior.world.effects or ():
        name, seen_from = effect.effect_id, None
        p, seen = presence[name], guess.visible[name]
        if not np.isfinite(p):
            continue
        if name in limits:
            key, *beyond = limits[name]
            seen_from = VisibleFrom(key, effect.parameters[key].unit, *beyond)
        sizes = []
        for key in effect.vector_names():
            low, middle, high = (float(value) for value in quantiles[f"{name}.{key}"])
            sizes.append(Size(key, effect.parameters[key].unit, middle, low, high))
        if name == BrakeRotor.effect_id:
            gearbox = posterior.world.rig.gearbox
            sizes += _rotor_resonance(variants, gearbox.replace(load_torque=session.conditions[:, 1].mean()))
        others = [other for group in look_alikes() if name in group for other in group if other != name]
        ties = [other for other in others if presence.get(other, 0.0) > ABSENT and other not in named]
        state = state_of(p, seen, named=name in named)
        rows.append(
            FoundEffect(name, p, state, tuple(sizes), tuple(ties) if p > ABSENT else (), seen, seen_from)
        )
    return tuple(sorted(rows, key=lambda row: -row.probability))


def _make_remainder(world: World, confirmed: Confirmation) -> Remainder:
    """Return the remainder of the corrected model, the clearest statistics first."""
    test, cells = confirmed.remainder, world.described_cells
    rows = [
        RemainderRow(**vars(cells[k]), difference=float(confirmed.difference[k]), z=float(test.z[k]))
        for k in np.argsort(-np.abs(test.z[: len(cells)]))[:_ROWS]
    ]
    p_undecided = None if confirmed.accepted or not np.isfinite(test.p_undecided) else test.p_undecided
    return Remainder(test.p, not (confirmed.accepted or confirmed.open), tuple(rows), p_undecided)


def _simulate_overlays(
    located: Sequence[LocatedGap], settings: GapSettings, corrected: Rig | None = None
) -> tuple[Overlay, ...]:
    """Return the overlays of each condition; none without ``settings.pictures``."""
    overlays: list[Overlay] = []
    for gap in located if settings.pictures else ():
        after = None
        if corrected is not None:
            at = gap.comparison.condition
            corrected = corrected.at(at.speed_rpm, at.load_nm)
            after = bank_like(gap.comparison.replace(rig=corrected, n_bank=settings.n_after), gap.measured).X
        overlays += summarise_overlays(gap.comparison, gap.measured.windows, gap.bank.X, after)
    return tuple(overlays)


_FEW_SIMULATED = 40  # below it "disagree" is said too often where nothing differs


def compare_recordings(
    measured: Sequence[Recording], simulated: Sequence[Recording], *, settings: GapSettings | None = None
) -> GapResult:
    """Find where measured recordings differ from those of any simulator.

    Nothing is named, as the simulator is not known. Kinematics, counts and tachometers are used as far as
    both sets state them.

    Parameters
    ----------
    measured, simulated : sequence of Recording
    settings : GapSettings, optional
        ``alpha``, ``n_permutations``, ``pictures`` and ``random_state`` are used.

    Returns
    -------
    GapResult
        Without effects.

    Raises
    ------
    ValueError
        If the two sets have no condition in common at which each has two recordings, or do not fit together.

    Notes
    -----
    In 60 comparisons each of 6 recordings without a difference and alpha = 0.05, "disagree" was said of 3 %
    with 48 simulated recordings or more, of 17 % with 12 to 24 and of 65 % with 6: simulate 40 or more of
    each condition.

    Examples
    --------
    >>> import numpy as np
    >>> random, time = np.random.default_rng(0), np.arange(12_000) / 6400
    >>> def recorded(hum_nm):
    ...     torque = 22 + hum_nm * np.sin(100 * np.pi * time) + random.normal(0, 0.1, time.size)
    ...     return Recording(torque, 6400, speed_rpm=500, load_nm=22)
    >>> measured, simulated = [recorded(0.2) for _ in range(6)], [recorded(0) for _ in range(40)]
    >>> compare_recordings(measured, simulated, settings=GapSettings(pictures=False)).verdict
    'disagree'
    """
    began = time.monotonic()
    settings = GapSettings() if settings is None else settings
    given = [*measured, *simulated]
    gearbox = Rig().gearbox.replace(n_pins=common_n_lobes(given) + 1)
    rig = Rig(gearbox)
    both = MeasuredRig.of(given, rig)
    numbers = range(len(given))
    parts = both.part(numbers[: len(measured)]), both.part(numbers[len(measured) :])
    located = locate_all(parts[0], World(rig=rig), settings, simulated=parts[1])
    warnings = [*both.warnings, *parts[0].doubts]
    compared = [gap.comparison.condition for gap in located]
    left_out = [condition.text for condition in parts[0].conditions if condition not in compared]
    if left_out:
        warnings.append(f"not compared, as each set needs two recordings there: {'; '.join(left_out)}")
    fewest = min(len(gap.bank.X) for gap in located)
    if fewest < _FEW_SIMULATED:
        warnings.append(
            f"{fewest} simulated recordings of a condition: with fewer than {_FEW_SIMULATED} differences "
            "look surer than they are"
        )
    if any(parts[0].of_one_assembly(condition) for condition in compared):
        warnings.append(
            "all recordings of a condition are of one assembly: what is peculiar to it counts as a difference"
        )
    return GapResult(
        where=tuple(where_of(gap, pictures=settings.pictures) for gap in located),
        rig=rig,
        quantity=both.quantity,
        overlays=_simulate_overlays(located, settings),
        warnings=tuple(warnings),
        seconds=time.monotonic() - began,
    )


_FEWEST = 3  # set-points, so that fitted ones lie on both sides of the one held out
_SET_POINTS = {"speed": ("speed_rpm", "RPM", SAME_SPEED), "load": ("load_nm", "Nm", SAME_LOAD)}

Parts = tuple[list[Recording], list[Recording]]


def hold_out(recordings: Sequence[Recording], by: float | str, *, random_state: int | None = None) -> Parts:
    """Split recordings into those to fit and those to judge on.

    Parameters
    ----------
    recordings : sequence of Recording
    by : float, "speed" or "load"
        A share between 0 and 1: assemblies are held out as a whole, of every count and condition about this
        share. ``"speed"`` or ``"load"``: all recordings at the middle one of at least three speeds or loads,
        so that what is fitted surrounds it.
    random_state : int, optional
        Seed of a share. Default: drawn at random.

    Returns
    -------
    fitted, held_out : list of Recording

    Raises
    ------
    ValueError
        If ``by`` is something else, recordings state no speed or load, or there are too few of them.

    Examples
    --------
    >>> recordings = [Recording([22.0, 22.1], 25_600, speed_rpm=speed) for speed in (400, 500, 500, 600)]
    >>> fitted, held_out = hold_out(recordings, "speed")
    >>> [recording.speed_rpm for recording in held_out]
    [500.0, 500.0]
    """
    points: dict[str, Float] = {}
    for name, (label, unit, share) in _SET_POINTS.items():
        values = [getattr(recording, label) for recording in recordings]
        if None not in values:
            points[name] = set_points(np.abs(values), share)
        elif by == name:
            raise ValueError(
                f"by {by} needs {label} of every recording, {values.count(None)} of {len(values)} state none"
            )
        if by == name and len(distinct := np.unique(points[name])) < _FEWEST:
            got = ", ".join(f"{value:g}" for value in distinct)
            raise ValueError(
                f"by {by} needs recordings at {_FEWEST} {by}s or more, so that fitted ones lie on both "
                f"sides, got {distinct.size}: {got} {unit}"
            )
    if by in points:
        distinct = np.unique(points[str(by)])
        held = points[str(by)] == distinct[distinct.size // 2]
    elif is_number(by) and 0 < float(by) < 1:
        held = _held_share(recordings, float(by), [*points.values()], random_state)
    else:
        raise ValueError(f"by must be a share between 0 and 1, speed or load, got {by}")
    fitted, held_out = ([recordings[i] for i in np.flatnonzero(flags).tolist()] for flags in (~held, held))
    return fitted, held_out


def _held_share(
    recordings: Sequence[Recording], share: float, points: list[Float], random_state: int | None
) -> NDArray[np.bool_]:
    """Mask a share of the assemblies of every count and condition."""
    known = all(recording.assembly is not None for recording in recordings)
    # Both parts hold the same classes and conditions.
    counts = [recording.defect_count for recording in recordings]
    kinds = list(zip(counts, [recording.torque.mean() < 0 for recording in recordings], *points, strict=True))
    assemblies: dict[Any, list[int]] = {}
    for i, recording in enumerate(recordings):
        assemblies.setdefault(recording.assembly if known else i, []).append(i)
    strata: dict[Any, list[list[int]]] = {}
    members = list(assemblies.values())
    for k in np.random.default_rng(random_state).permutation(len(members)):
        strata.setdefault(frozenset(kinds[i] for i in members[k]), []).append(members[k])
    order = [assembly for of_one_kind in strata.values() for assembly in of_one_kind]
    held = np.zeros(len(recordings), dtype=bool)
    held[[i for k in range(int(share * len(order))) for i in order[int(k / share)]]] = True
    if not held.any() or held.all():
        raise ValueError(
            f"by {share:g} leaves {int(np.sum(~held))} of {len(recordings)} recordings to fit, of "
            f"{len(assemblies)} assemblies each held out as a whole: more are needed"
        )
    return held
