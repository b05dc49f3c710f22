"""All missing effects at once: where, what, how large, how much better."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence

import numpy as np

from cyclofeat.gap._measured import Condition, MeasuredRig
from cyclofeat.gap._overlays import Overlay, overlays
from cyclofeat.gap._result import FoundEffect, GapResult, Remainder, RemainderRow, Size, VisibleFrom
from cyclofeat.gap._settings import GapSettings
from cyclofeat.gap._where import where_of
from cyclofeat.gap.confirm import Confirmed, confirm, draw_effects, simulate_possible
from cyclofeat.gap.posterior import (
    ABSENT,
    EffectPosterior,
    answer_of,
    load_posterior,
    named_effects,
)
from cyclofeat.gap.proof.prove import Proof, prove_all
from cyclofeat.gap.where import LocatedGap, locate_all
from cyclofeat.gap.world import Session, World
from cyclofeat.recordings import Recording
from cyclofeat.simulators import Effect, Rig
from cyclofeat.simulators.effects.library import look_alikes

_ROWS = 12
_VARIANTS = 200  # a probability is off by up to 0.07


def find_gap(
    measured: Iterable[Recording],
    held_out: Iterable[Recording] | None = None,
    *,
    posterior: EffectPosterior | None = None,
    settings: GapSettings | None = None,
    progress: Callable[[str], object] | None = None,
) -> GapResult:
    """Name everything that a model lacks, at once, from recordings at one condition or several.

    Parameters
    ----------
    measured : iterable of Recording
        Of one rig; each with ``speed_rpm``, at least one output turn and 3 % more.
    held_out : iterable of Recording, optional
        Other recordings of the rig, at these conditions or others, on which the corrected model is judged.
    posterior : EffectPosterior, optional
        Learned from simulated rigs of the model. Default: that of paper B's gearbox
        (:func:`cyclofeat.gap.posterior.load_posterior`).
    settings : GapSettings, optional
    progress : callable, optional
        Called with the name of each step.

    Raises
    ------
    ValueError
        If recordings and posterior do not fit together.

    Notes
    -----
    1. Where: recordings and model are compared at each condition (:func:`cyclofeat.gap.locate`).
    2. What: the posterior states the probability of each effect.
    3. What is possible: rigs drawn from this posterior are simulated, with further recordings, which tells
       what to measure next.
    4. How large: sessions with the effects that are more probable than not (of look-alikes, that share their
       probability, the most probable one) are simulated, their sizes fitted,
       and what they leave unexplained is stated (:func:`cyclofeat.gap.confirm.confirm`). If something is
       left, the sizes stay those of the posterior; open effects may explain it, or no effect does.
    5. How sure: sets of effects with sizes are drawn from all that the recordings leave possible
       (:func:`cyclofeat.gap.confirm.draw_effects`), to train on.
    6. How much better: the corrected model is judged on recordings held out.
    """
    began = time.monotonic()
    settings, say = settings or GapSettings(), progress or (lambda _: None)
    posterior = posterior or load_posterior()
    world = posterior.world
    rig = MeasuredRig.of(measured, world.rig, world.sampling_rate, quantity=world.quantity)
    session = rig.session(one_assembly=settings.one_assembly)
    presence = posterior.presence(session)
    held = None
    if held_out is not None:
        held = MeasuredRig.of(
            held_out, world.rig, world.sampling_rate, quantity=world.quantity, conditions=rig.conditions
        )
    say("comparing measurement and model")
    located = locate_all(rig, world, settings)
    say("simulating rigs that the recordings leave possible")
    possible = simulate_possible(
        posterior, session, random_state=settings.random_state, n_jobs=settings.n_jobs
    )
    named = named_effects(presence)
    confirmed = confirm(
        posterior, session, named, possible=possible.sessions,
        random_state=settings.random_state, n_jobs=settings.n_jobs, progress=say,
    )  # fmt: skip
    corrected = corrected_rig(located, world.rig, confirmed.effects)
    variants = draw_effects(posterior, session, confirmed, _VARIANTS, random_state=settings.random_state)
    left = _remainder(world, confirmed)
    proof: tuple[Proof, ...] = ()
    if held is not None and named:
        say("judging on recordings held out")
        proof = prove_all(rig, held, corrected, world, settings)
    return GapResult(
        where=tuple(where_of(one, pictures=settings.pictures) for one in located),
        rig=corrected,
        quantity=rig.quantity,
        posterior_rig=corrected_rig(located, world.rig, variants=variants),
        effects=_effects(posterior, session, presence, confirmed),
        named=confirmed.effects,
        remainder=left,
        next_measurements=possible.next_measurements(posterior),
        overlays=_overlays(located, corrected, settings) if settings.pictures else (),
        proof=proof,
        warnings=(*rig.warnings, *rig.doubts, *_not_fitted(confirmed)),
        seconds=time.monotonic() - began,
    )


def corrected_rig(
    located: Sequence[LocatedGap],
    rig: Rig,
    effects: Sequence[Effect] = (),
    variants: Sequence[Sequence[Effect]] = (),
) -> Rig:
    """Return the model with effects added, for all assemblies or in variants."""
    return located[0].comparison.corrected_rig(effects, variants).replace(gearbox=rig.gearbox)


def _effects(
    posterior: EffectPosterior, session: Session, presence: dict[str, float], confirmed: Confirmed
) -> tuple[FoundEffect, ...]:
    """Return what is known of each effect, the most probable first."""
    quantiles = {name: (row[0], row[2], row[-1]) for name, row in posterior.sizes(session).items()}
    fitted = zip(confirmed.low, confirmed.middle, confirmed.high, strict=True)
    quantiles |= dict(zip(confirmed.names, fitted, strict=True))
    limits = posterior.visible_from()
    visible = dict(zip(posterior.names_, posterior.predict_visible([session])[0].tolist(), strict=True))
    found = []
    for effect in posterior.world.effects or ():
        name = effect.effect_id
        if not np.isfinite(presence[name]):
            continue
        p = presence[name]
        seen_from = None
        if name in limits:
            key, *beyond = limits[name]
            seen_from = VisibleFrom(key, effect.parameters[key].unit, *beyond)
        sizes = []
        for key in effect.vector_names():
            low, middle, high = (float(value) for value in quantiles[f"{name}.{key}"])
            sizes.append(Size(key, effect.parameters[key].unit, middle, low, high))
        others = [other for group in look_alikes() if name in group for other in group if other != name]
        ties = tuple(other for other in others if presence.get(other, 0.0) > ABSENT)
        found.append(
            FoundEffect(
                name, p, answer_of(p), tuple(sizes), ties if p > ABSENT else (),
                visible[name], seen_from,
            )
        )  # fmt: skip
    return tuple(sorted(found, key=lambda one: -one.probability))


def _not_fitted(confirmed: Confirmed) -> tuple[str, ...]:
    if confirmed.fitted or not confirmed.accepted:
        return ()
    return (
        "sizes are those of the posterior: with fitted ones, simulated recordings are less like the measured",
    )


def _remainder(world: World, confirmed: Confirmed) -> Remainder:
    left, cells = confirmed.remainder, world.described_cells
    rows = [
        RemainderRow(**vars(cells[k]), difference=float(confirmed.difference[k]), z=float(left.z[k]))
        for k in np.argsort(-np.abs(left.z[: len(cells)]))[:_ROWS]
    ]
    p_open = None if confirmed.accepted or not np.isfinite(left.p_open) else left.p_open
    return Remainder(left.p, not (confirmed.accepted or confirmed.open), tuple(rows), p_open)


def _overlays(located: Sequence[LocatedGap], corrected: Rig, settings: GapSettings) -> tuple[Overlay, ...]:
    found: list[Overlay] = []
    for one in located:
        condition = Condition.of(one.comparison)
        after = one.comparison.replace(rig=condition.set_on(corrected), n_bank=settings.n_after)
        bank = after.bank_like(one.measured)
        found += overlays(one.comparison, one.measured.windows, one.bank.X, bank.X)
    return tuple(found)
