"""The next measurement: conditions whose recordings would settle most of what is unresolved."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from cyclofeat.gap.confirm.sessions import (
    MOST_RECORDINGS,
    limit_recordings,
    select_recordings,
    simulate_sessions,
    with_sizes,
)
from cyclofeat.gap.posterior.effect_posterior import EffectPosterior
from cyclofeat.gap.result import NextMeasurement
from cyclofeat.gap.world.rigs import Session, present_effects
from cyclofeat.gap.world.world import World
from cyclofeat.simulators import Effect

Float = NDArray[np.float64]

_PER_CANDIDATE = 4  # further recordings
_DRAWS, _RIGS_PER_MACHINE = 32, 4
_SURE = 1.0  # standard errors that a gain must exceed
_OPEN = 0.02  # an effect is open if its probability lies between this and 1 - this
_LOAD_RATIO, _SPEED_RATIO = 2.0, 1.25
_SEPARATED = 0.1  # bits that an effect must gain to count as settled
_LEAST = 1e-6  # probability


@dataclass(frozen=True)
class PossibleRigs:
    """Simulated sessions of rigs that the recordings leave possible, with further recordings.

    ``simulated`` sessions are like ``further.session``; ``present`` (n_sessions, n_effects) are the effects
    that their rigs have.
    """

    further: FurtherRecordings
    simulated: list[Session] = field(repr=False)
    present: NDArray[np.bool_] = field(repr=False)

    @property
    def sessions(self) -> list[Session]:
        """The sessions without the further recordings."""
        return [select_recordings(session, np.arange(self.further.n_before)) for session in self.simulated]

    def next_measurements(self, posterior: EffectPosterior) -> tuple[NextMeasurement, ...]:
        """Rank further recordings by the information that they are expected to give; empty if none does."""
        return self.further.rank(posterior, self.simulated, self.present, n_errors=_SURE)


def simulate_possible_rigs(
    posterior: EffectPosterior, session: Session, *, random_state: int, n_jobs: int = 1
) -> PossibleRigs:
    """Simulate rigs drawn from the posterior: each effect is there as often as it is probable.

    At most 12 of the recordings are used. If no effect is open, no sessions are simulated.
    """
    world, session = posterior.world, limit_recordings(session, MOST_RECORDINGS)
    presence = posterior.predict_proba([session])[0]
    further = FurtherRecordings(session, world)
    if not np.any((presence > _OPEN) & (presence < 1 - _OPEN)):
        return PossibleRigs(further, [], np.empty((0, presence.size), dtype=bool))
    middles, spreads = posterior.size_distribution(session, world.size_names)

    def draw_effects(random: np.random.Generator) -> tuple[Effect, ...]:
        present = dict(zip(world.names, random.random(presence.size) < np.nan_to_num(presence), strict=True))
        drawn = [present[name.partition(".")[0]] for name in world.size_names]
        effects = [effect for effect in world.effects or () if present[effect.effect_id]]
        return with_sizes(effects, random.normal(middles[drawn], spreads[drawn]))

    simulated = simulate_sessions(
        world, further.session, draw_effects, _DRAWS,
        n_rigs_per_machine=_RIGS_PER_MACHINE, random_state=random_state, n_jobs=n_jobs,
    )  # fmt: skip
    present = present_effects(simulated.sizes, world.size_names, world.names)
    return PossibleRigs(further, simulated.sessions, present)


class FurtherRecordings:
    """Recordings that could be made besides those of a session.

    At another load, another speed, in reverse, and more of the same; speeds and loads are those of the world.
    ``session`` has the ``n_before`` recordings first, then all these, whose summaries are still to be
    simulated.
    """

    def __init__(self, session: Session, world: World) -> None:
        self._names, self.n_before = world.names, len(session.values)
        speed, load, direction = session.conditions[0].tolist()
        candidates = [(f"{_PER_CANDIDATE} more recordings as before", (speed, load, direction))]
        low, high = world.loads_nm
        inside = [value for value in (load * _LOAD_RATIO, load * (1 / _LOAD_RATIO)) if low <= value <= high]
        candidates += [(f"recordings at {value:.3g} Nm", (speed, value, direction)) for value in inside[:1]]
        low, high = world.speeds_rpm
        inside = [
            value for value in (speed * _SPEED_RATIO, speed * (1 / _SPEED_RATIO)) if low <= value <= high
        ]
        candidates += [(f"recordings at {value:.4g} RPM", (value, load, direction)) for value in inside[:1]]
        if np.all(session.conditions[:, 2] == direction):
            candidates.append(("recordings in reverse", (speed, load, -direction)))
        self._what = [what for what, _ in candidates]
        rows = np.r_[np.arange(self.n_before), np.arange(len(candidates) * _PER_CANDIDATE) % self.n_before]
        self.session = select_recordings(session, rows)
        further = np.array([conditions for _, conditions in candidates])
        self.session.conditions[self.n_before :] = np.repeat(further, _PER_CANDIDATE, axis=0)

    def rank(
        self,
        posterior: EffectPosterior,
        simulated: Sequence[Session],
        present: NDArray[np.bool_],
        *,
        n_errors: float,
    ) -> tuple[NextMeasurement, ...]:
        """Rank them by the information that they give on simulated rigs, the most informative first.

        The posterior answers with and without them. The gain is how much more probability it then gives to
        what the rigs have and lack, each effect by itself, as the mean of the logarithm (Lindley 1956). A
        posterior that only grows surer of wrong answers gains nothing.

        The ``simulated`` sessions are like ``session``, of rigs that have the effects ``present``
        (n_sessions, n_effects). A gain must exceed ``n_errors`` standard errors.
        """
        if not simulated:
            return ()

        def information_bits(rows: NDArray[np.intp]) -> Float:
            """Return the logarithm of the probability of what is true, (n_sessions, n_effects), in bits."""
            p = posterior.predict_proba([select_recordings(one, rows) for one in simulated])
            bits = np.log2(np.clip(np.where(present, p, 1 - p), _LEAST, None))
            return np.asarray(np.nan_to_num(bits))  # of effects that were not learned

        as_before = np.arange(self.n_before)
        before = information_bits(as_before)
        ranked: list[tuple[float, NextMeasurement]] = []
        for k, what in enumerate(self._what):
            added = self.n_before + k * _PER_CANDIDATE + np.arange(_PER_CANDIDATE)
            rises = information_bits(np.r_[as_before, added]) - before
            gains, error = rises.mean(axis=0), rises.sum(axis=1).std() / np.sqrt(len(simulated))
            settles = tuple(name for name, gain in zip(self._names, gains, strict=True) if gain > _SEPARATED)
            gain = float(gains.sum())
            if gain > max(_SEPARATED, n_errors * error):
                ranked.append((gain, NextMeasurement(what, settles, gain)))
        return tuple(one for _, one in sorted(ranked, key=lambda one: -one[0]))
