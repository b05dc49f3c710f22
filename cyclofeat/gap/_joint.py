"""All missing effects at once: where, what, how large, how much better."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Iterable, Sequence

import numpy as np

from cyclofeat.gap._answer import FoundEffect, JointGap, Remainder, RemainderRow, Size
from cyclofeat.gap._measured import Condition, MeasuredRig
from cyclofeat.gap._overlays import Overlay, overlays
from cyclofeat.gap._settings import GapSettings
from cyclofeat.gap._where import where_of
from cyclofeat.gap.confirm import Confirmed, confirm, next_measurements
from cyclofeat.gap.posterior import TIES, EffectPosterior, named_effects
from cyclofeat.gap.proof import Proof, prove
from cyclofeat.gap.simulations import as_rig
from cyclofeat.gap.where import LocatedGap, locate_all
from cyclofeat.gap.world import Session, World
from cyclofeat.recordings import Recording
from cyclofeat.simulators import Rig

_PRESENT, _ABSENT = 0.95, 0.05
_TIED = 0.05  # probability from which a look-alike is told
_ROWS = 12


def find_joint_gap(
    measured: Iterable[Recording],
    held_out: Iterable[Recording] | None = None,
    *,
    posterior: EffectPosterior,
    settings: GapSettings | None = None,
    progress: Callable[[str], object] | None = None,
) -> JointGap:
    """Name everything that a model lacks, at once, from recordings at one condition or several.

    Parameters
    ----------
    measured : iterable of Recording
        Of one rig; each with ``speed_rpm``, at least one output turn and 3 % more.
    held_out : iterable of Recording, optional
        Other recordings of the rig, at these conditions or others, on which the corrected model is judged.
    posterior : EffectPosterior
        Learned from simulated rigs of the model.
    settings : GapSettings, optional
    progress : callable, optional
        Called with the name of each step.

    Returns
    -------
    JointGap

    Raises
    ------
    ValueError
        If recordings and posterior do not fit together, or ``settings.library`` is given.

    Notes
    -----
    1. Where: recordings and model are compared at each condition (:func:`cyclofeat.gap.locate`).
    2. What: the posterior states the probability of each effect.
    3. How large: sessions with the effects that are more probable than not (of look-alikes, that share their
       probability, the most probable one) are simulated, their sizes fitted,
       and what they leave unexplained is stated (:func:`cyclofeat.gap.confirm.confirm`). If something is
       left, the sizes stay those of the posterior, and the result is not confirmed.
    4. How much better: the corrected model is judged on recordings held out.
    """
    began = time.monotonic()
    settings, say = settings or GapSettings(), progress or (lambda _: None)
    if settings.library is not None:
        raise ValueError(
            f"settings.library must be None, got {settings.library!r}: the posterior has learned the effects "
            "that it asks for; prepare one for others"
        )
    world = posterior.world
    rig = MeasuredRig.of(measured, world.rig, world.sampling_rate)
    session = rig.session()
    presence = posterior.presence(session)
    held = None
    if held_out is not None:
        held = MeasuredRig.of(held_out, world.rig, world.sampling_rate, conditions=rig.conditions)
    say("comparing measurement and model")
    located = locate_all(rig, world, settings)
    named = named_effects(presence)
    confirmed = confirm(
        posterior, session, named, random_state=settings.random_state, n_jobs=settings.n_jobs, progress=say
    )
    corrected = corrected_rig(located, world.rig, confirmed)
    say("looking for the next measurement")
    further = next_measurements(
        posterior, session, random_state=settings.random_state, n_jobs=settings.n_jobs
    )
    left = _remainder(world, confirmed)
    proof: tuple[Proof, ...] = ()
    if held is not None and named:
        say("judging on recordings held out")
        proof = _proof(rig, held, corrected, world, settings)
    return JointGap(
        where=tuple(where_of(one, pictures=settings.pictures) for one in located),
        rig=corrected,
        effects=_effects(posterior, session, presence, confirmed),
        named=confirmed.effects,
        confirmed=confirmed.accepted,
        remainder=left,
        next_measurements=further,
        overlays=_overlays(located, corrected, settings) if settings.pictures else (),
        proof=proof,
        unknown=not confirmed.accepted,
        warnings=(*rig.warnings, *rig.doubts),
        seconds=time.monotonic() - began,
    )


def corrected_rig(located: Sequence[LocatedGap], rig: Rig, confirmed: Confirmed) -> Rig:
    """Return the model with the confirmed effects."""
    added = located[0].comparison.corrected_rig(confirmed.effects)
    return added.replace(gearbox=rig.gearbox)


def _effects(
    posterior: EffectPosterior, session: Session, presence: dict[str, float], confirmed: Confirmed
) -> tuple[FoundEffect, ...]:
    """Return what is known of each effect, the most probable first."""
    quantiles = {name: (row[0], row[2], row[-1]) for name, row in posterior.sizes(session).items()}
    fitted = zip(confirmed.low, confirmed.middle, confirmed.high, strict=True)
    quantiles |= dict(zip(confirmed.names, fitted, strict=True))
    found = []
    for effect in posterior.world.effects or ():
        name = effect.effect_id
        if not np.isfinite(presence[name]):
            continue
        p = presence[name]
        answer = "present" if p >= _PRESENT else "absent" if p <= _ABSENT else "unresolved"
        sizes = []
        for key in effect.vector_names():
            low, middle, high = (float(value) for value in quantiles[f"{name}.{key}"])
            sizes.append(Size(key, effect.parameters[key].unit, middle, low, high))
        others = [other for group in TIES if name in group for other in group if other != name]
        ties = tuple(other for other in others if presence.get(other, 0.0) > _TIED)
        found.append(FoundEffect(name, p, answer, tuple(sizes), ties if p > _TIED else ()))
    return tuple(sorted(found, key=lambda one: -one.probability))


def _remainder(world: World, confirmed: Confirmed) -> Remainder:
    left, cells = confirmed.remainder, world.described_cells
    rows = [
        RemainderRow(**vars(cells[k]), difference=float(confirmed.difference[k]), z=float(left.z[k]))
        for k in np.argsort(-np.abs(left.z[: len(cells)]))[:_ROWS]
    ]
    return Remainder(left.p, not confirmed.accepted, tuple(rows))


def _overlays(located: Sequence[LocatedGap], corrected: Rig, settings: GapSettings) -> tuple[Overlay, ...]:
    found: list[Overlay] = []
    for one in located:
        condition = Condition.of(one.comparison)
        after = one.comparison.replace(rig=condition.set_on(corrected), n_bank=settings.n_after)
        bank = after.bank_like(one.measured)
        found += overlays(one.comparison, one.measured.windows, one.bank.X, bank.X)
    return tuple(found)


def _proof(
    rig: MeasuredRig, held: MeasuredRig, corrected: Rig, world: World, settings: GapSettings
) -> tuple[Proof, ...]:
    """Judge the corrected model at each condition held out.

    At a condition without fitted recordings only the model as it was is an alternative: the others would have
    nothing to learn from.
    """
    rig, held = rig.known_as(held), held.known_as(rig)
    proofs = []
    for condition in held.conditions:
        judged = held.windows(condition)
        seen = condition in rig.conditions
        alternatives = settings if seen else dataclasses.replace(settings, baselines=("nothing",))
        oracle = {} if settings.oracle is None else {"oracle": condition.set_on(as_rig(settings.oracle))}
        proofs.append(
            prove(
                held.comparison(condition, world, settings), condition.set_on(corrected),
                rig.windows(condition) if seen else judged, judged, settings=alternatives, others=oracle,
            )
        )  # fmt: skip
    return tuple(proofs)
