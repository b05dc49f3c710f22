"""The next measurement: conditions whose recordings would settle most of what is unresolved."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from cyclofeat.gap._result import NextMeasurement
from cyclofeat.gap.confirm._sessions import MOST_RECORDINGS, at_most, part_of, simulate_sessions, sized
from cyclofeat.gap.posterior import EffectPosterior
from cyclofeat.gap.world import Session, World
from cyclofeat.simulators import Effect

Float = NDArray[np.float64]

_PER_CANDIDATE = 4  # further recordings
_DRAWS = 32
_OPEN = 0.02  # probability from which, and below whose complement, an effect is open
_LOAD_RATIO, _SPEED_RATIO = 2.0, 1.25
_SEPARATED = 0.1  # bits that an effect must lose to count as settled


def next_measurements(
    posterior: EffectPosterior, session: Session, *, random_state: int = 0, n_jobs: int = 1
) -> tuple[NextMeasurement, ...]:
    """Rank further recordings by the information that they are expected to give.

    Rigs are drawn from the posterior, sessions like the measured one are simulated for each with further
    recordings, and the posterior answers with and without these. The gain is the mean fall of the entropy of
    the effects' presence (Lindley 1956), each effect by itself.

    Parameters
    ----------
    posterior : EffectPosterior
    session : Session
        Of more than 12 recordings, 12 are used.
    random_state, n_jobs : int

    Returns
    -------
    tuple of NextMeasurement
        Those that give anything, the most informative first; empty where nothing is open.
    """
    world, session = posterior.world, at_most(session, MOST_RECORDINGS)
    presence = posterior.predict_proba([session])[0]
    if not np.any((presence > _OPEN) & (presence < 1 - _OPEN)):
        return ()
    further = FurtherRecordings(session, world)
    sizes = posterior.size_distribution(session, world.size_names)
    simulated = simulate_sessions(
        world, further.session, lambda random: _drawn(world, presence, sizes, random), _DRAWS,
        random_state=random_state, n_jobs=n_jobs,
    ).sessions  # fmt: skip
    return further.rank(simulated, lambda sessions: -_entropy(posterior, sessions))


class FurtherRecordings:
    """Recordings that could be made besides those of a session.

    At another load, another speed, in reverse, and more of the same; speeds and loads are those of the world.

    Parameters
    ----------
    session : Session
    world : World

    Attributes
    ----------
    session : Session
        With all these recordings, whose summaries are still to be simulated.
    """

    def __init__(self, session: Session, world: World) -> None:
        self._names, self._n = world.names, len(session.values)
        candidates = _candidates(session, world)
        self._what = [what for what, _ in candidates]
        rows = np.r_[np.arange(self._n), np.arange(len(candidates) * _PER_CANDIDATE) % self._n]
        self.session = part_of(session, rows)
        further = np.array([conditions for _, conditions in candidates])
        self.session.conditions[self._n :] = np.repeat(further, _PER_CANDIDATE, axis=0)

    def rank(
        self,
        simulated: Sequence[Session],
        information: Callable[[list[Session]], Float],
        *,
        n_errors: float = 0.0,
    ) -> tuple[NextMeasurement, ...]:
        """Rank them by the information that they give on simulated rigs.

        Parameters
        ----------
        simulated : sequence of Session
            Like ``session``.
        information : callable
            Returns what the sessions of these rigs tell of each effect in bits, (n_sessions, n_effects).
        n_errors : float
            Standard errors that a gain must exceed.
        """
        if not simulated:
            return ()
        n = self._n
        before = information([part_of(one, np.arange(n)) for one in simulated])
        found: list[tuple[float, NextMeasurement]] = []
        for k, what in enumerate(self._what):
            more = np.r_[:n, n + k * _PER_CANDIDATE : n + (k + 1) * _PER_CANDIDATE]
            rises = information([part_of(one, more) for one in simulated]) - before
            gains, error = rises.mean(axis=0), rises.sum(axis=1).std() / np.sqrt(len(simulated))
            settles = tuple(name for name, gain in zip(self._names, gains, strict=True) if gain > _SEPARATED)
            gain = float(gains.sum())
            if gain > max(_SEPARATED, n_errors * error):
                found.append((gain, NextMeasurement(what, settles, gain)))
        return tuple(one for _, one in sorted(found, key=lambda one: -one[0]))


def _candidates(session: Session, world: World) -> list[tuple[str, tuple[float, float, float]]]:
    """Further conditions inside the world."""
    speed, load, direction = session.conditions[0].tolist()
    loads = [load * ratio for ratio in (_LOAD_RATIO, 1 / _LOAD_RATIO)]
    speeds = [speed * ratio for ratio in (_SPEED_RATIO, 1 / _SPEED_RATIO)]
    found = [(f"{_PER_CANDIDATE} more recordings as before", (speed, load, direction))]
    for other in (loads, speeds):
        low, high = world.loads_nm if other is loads else world.speeds_rpm
        inside = [value for value in other if low <= value <= high]
        if inside and other is loads:
            found.append((f"recordings at {inside[0]:.3g} Nm", (speed, inside[0], direction)))
        elif inside:
            found.append((f"recordings at {inside[0]:.4g} RPM", (inside[0], load, direction)))
    if np.all(session.conditions[:, 2] == direction):
        found.append(("recordings in reverse", (speed, load, -direction)))
    return found


def _drawn(
    world: World, presence: Float, sizes: tuple[Float, Float], random: np.random.Generator
) -> tuple[Effect, ...]:
    """Draw effects by their probabilities, with sizes of these medians and standard deviations."""
    there = dict(zip(world.names, random.random(presence.size) < np.nan_to_num(presence), strict=True))
    drawn = [there[name.partition(".")[0]] for name in world.size_names]
    effects = [effect for effect in world.effects or () if there[effect.effect_id]]
    middle, spread = (values[drawn] for values in sizes)
    return sized(effects, random.normal(middle, spread))


def _entropy(posterior: EffectPosterior, sessions: Sequence[Session]) -> Float:
    """Entropy of each effect's presence in bits, shape (n_sessions, n_effects); 0 for one not learned."""
    p = np.clip(np.nan_to_num(posterior.predict_proba(sessions)), 1e-9, 1 - 1e-9)
    return np.asarray(-(p * np.log2(p) + (1 - p) * np.log2(1 - p)))
