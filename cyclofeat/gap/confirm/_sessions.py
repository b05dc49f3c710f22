"""Simulation of sessions like a measured one, with drawn sizes of given effects."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import joblib
import numpy as np
from numpy.typing import NDArray

from cyclofeat.gap.world import DrawnMachine, DrawnSession, Session, World, simulate_drawn
from cyclofeat.simulators import Effect

Float = NDArray[np.float64]

_RIGS_PER_MACHINE = 2  # with different sizes of the effects on the torque signal
_MACHINES_AT_ONCE = 4


@dataclass(frozen=True)
class SimulatedSessions:
    """Simulated sessions.

    Attributes
    ----------
    sessions : list of Session
    sizes : ndarray, shape (n_sessions, n_sizes)
        Parameters of the effects, in the world's order and on the scale of their fit.
    """

    sessions: list[Session] = field(repr=False)
    sizes: Float = field(repr=False)


def simulate_sessions(
    world: World,
    template: Session,
    draw: Callable[[np.random.Generator], Sequence[Effect]],
    n_sessions: int,
    *,
    random_state: int = 0,
    n_jobs: int = 1,
) -> SimulatedSessions:
    """Simulate sessions with the conditions of another; two at a time share the runs of a machine.

    Parameters
    ----------
    world : World
    template : Session
        Whose conditions, counts and tachometer they have; unknown counts are drawn.
    draw : callable
        Returns effects with random sizes; of those that share a machine, the first's effects on the gearbox
        are used.
    n_sessions : int
    random_state, n_jobs : int
    """
    seeds = np.random.SeedSequence(random_state).spawn(-(-n_sessions // _RIGS_PER_MACHINE))
    machines = [_drawn(world, template, draw, seed) for seed in seeds]
    parts = [machines[k : k + _MACHINES_AT_ONCE] for k in range(0, len(machines), _MACHINES_AT_ONCE)]
    made = joblib.Parallel(n_jobs=n_jobs)(joblib.delayed(simulate_drawn)(world, part) for part in parts)
    sessions, sizes = [], []
    for columns in (columns for part in made for columns in part):
        for values, counts, speeds, drawn in zip(
            columns["values"], columns["counts"], columns["speeds"], columns["sizes"], strict=True
        ):
            if np.isfinite(values[:, 0]).all():
                session = Session(
                    values.astype(np.float64), template.conditions,
                    None if template.counts is None else counts,
                    None if template.speeds_rpm is None else speeds,
                )  # fmt: skip
                sessions.append(session)
                sizes.append(drawn)
    return SimulatedSessions(
        sessions[:n_sessions], np.array(sizes[:n_sessions]).reshape(-1, len(world.size_names))
    )


def _drawn(
    world: World,
    template: Session,
    draw: Callable[[np.random.Generator], Sequence[Effect]],
    seed: np.random.SeedSequence,
) -> DrawnMachine:
    n = len(template.values)
    for_draws, *for_runs = seed.spawn(n + 1)
    random = np.random.default_rng(for_draws)
    counts = template.counts
    if counts is None:
        counts = random.choice(np.array(world.defect_counts), n)
    speeds, loads, directions = template.conditions.T
    rigs = [draw(random) for _ in range(_RIGS_PER_MACHINE)]
    return DrawnMachine(
        effects=tuple(effect for effect in rigs[0] if effect.needs_simulation()),
        chains=[tuple(effect for effect in rig if not effect.needs_simulation()) for rig in rigs],
        session=DrawnSession(speeds, loads, directions.astype(np.int64), counts),
        seeds=for_runs,
    )


def at_most(session: Session, most: int) -> Session:
    """Return no more than so many recordings of a session, its conditions in turn."""
    _, of_condition = np.unique(session.conditions, axis=0, return_inverse=True)
    earlier = np.array([np.sum(of_condition[:k] == one) for k, one in enumerate(of_condition)])
    return part_of(session, np.sort(np.argsort(earlier, kind="stable")[:most]))


def part_of(session: Session, rows: NDArray[np.intp]) -> Session:
    """Return some recordings of a session."""
    return dataclasses.replace(
        session, **{name: values[rows] for name, values in vars(session).items() if values is not None}
    )


def sized(effects: Sequence[Effect], sizes: Float) -> tuple[Effect, ...]:
    """Return effects with sizes on the scale of their fit, held within their bounds."""
    made, first = [], 0
    for effect in effects:
        low, high = effect.vector_bounds()
        part = sizes[first : first + low.size]
        first += low.size
        made.append(effect.from_vector(np.clip(part, low, high)))
    return tuple(made)
