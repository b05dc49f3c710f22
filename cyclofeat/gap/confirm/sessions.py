"""Simulation of sessions like a measured one, of given rigs and of drawn ones."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import joblib
import numpy as np
from numpy.typing import NDArray

from cyclofeat._base.progress import stopped_quietly
from cyclofeat.gap.world.prepare import FEWEST_RECORDINGS, DrawnMachine, simulate_drawn
from cyclofeat.gap.world.rigs import Rigs, Session
from cyclofeat.gap.world.world import DrawnSession, World
from cyclofeat.simulators import Effect, SimulationFailed

Float = NDArray[np.float64]
# Effects on the gearbox, effects on the torque signal of each rig, factor on what differs anyway.
DrawnRigs = tuple[tuple[Effect, ...], list[tuple[Effect, ...]], float]

MOST_RECORDINGS = 12  # of a session, that are simulated
_RIGS_PER_MACHINE = 2  # with different effects on the torque signal
_MACHINES_AT_ONCE = 4


def simulate_pairs(
    world: World,
    template: Session,
    rigs: Sequence[tuple[Sequence[Effect], float]],
    numbers: range,
    *,
    random_state: int,
    n_jobs: int = 1,
) -> Float:
    """Simulate sessions with the conditions of a template, of rigs that share all random numbers.

    A rig is its effects and a factor on what differs anyway. Those with equal effects on the gearbox share
    its runs. Session ``k`` of ``numbers`` has the same random numbers whatever other numbers there are;
    unknown counts are drawn. Returns cells, shape (n_rigs, n_sessions, n_recordings, n_cells), NaN where a
    simulation failed.
    """
    machines: dict[tuple[tuple[Effect, ...], float], list[int]] = {}
    for k, (effects, tolerance) in enumerate(rigs):
        in_machine = tuple(effect for effect in effects if effect.needs_simulation())
        machines.setdefault((in_machine, tolerance), []).append(k)
    drawn, places = [], []
    for (in_machine, tolerance), members in machines.items():
        on_torque = [tuple(one for one in rigs[k][0] if not one.needs_simulation()) for k in members]
        for place, number in enumerate(numbers):
            seed = np.random.SeedSequence([random_state, number])
            drawn.append(_draw_machine(world, template, (in_machine, on_torque, tolerance), seed))
            places.append((members, place))
    cells = np.full((len(rigs), len(numbers), *template.values.shape), np.nan)
    for columns, (members, place) in zip(_simulate_machines(world, drawn, n_jobs), places, strict=True):
        cells[members, place] = columns["values"]
    return cells


def simulate_prior(
    world: World,
    template: Session,
    n_rigs: int,
    *,
    random_state: int,
    n_jobs: int = 1,
    progress: Callable[[int, int], object] | None = None,
) -> Rigs:
    """Simulate sessions with the conditions of a template, of rigs whose effects are drawn from the prior.

    Two rigs at a time share the runs of a machine. Unknown counts are drawn. ``progress`` is called with the
    number of rigs done and ``n_rigs``. Rigs of which too many recordings failed are left out; raises
    SimulationFailed if all failed.
    """

    def draw_rigs(random: np.random.Generator) -> DrawnRigs:
        in_machine = world.prior.in_machine(random)
        n = len(in_machine)
        return in_machine, [world.prior.on_torque(n, random) for _ in range(_RIGS_PER_MACHINE)], 1.0

    parts: list[dict[str, NDArray[Any]]] = []
    n_machines = -(-n_rigs // _RIGS_PER_MACHINE)
    seeds = np.random.SeedSequence(random_state).spawn(n_machines)
    machines = [_draw_machine(world, template, draw_rigs, seed) for seed in seeds]
    for part in _simulate_machines(world, machines, n_jobs):
        parts.append(part)
        if progress is not None:
            progress(min(len(parts) * _RIGS_PER_MACHINE, n_rigs), n_rigs)
    columns: dict[str, Any] = {
        name: np.concatenate([part[name] for part in parts])[:n_rigs] for name in parts[0]
    }
    numbers = np.arange(n_rigs)
    rigs = Rigs(
        world.names, world.size_names, world.logarithmic, world.cells, numbers,
        numbers // _RIGS_PER_MACHINE, world=world.to_dict(), **columns,
    )  # fmt: skip
    n_made = np.isfinite(rigs.values[:, :, 0]).sum(axis=1)
    usable = rigs.of(n_made >= min(FEWEST_RECORDINGS, len(template.values)))
    if not len(usable):
        raise SimulationFailed(f"none of {n_rigs} simulated rigs gave enough recordings")
    return usable


def _draw_machine(
    world: World,
    template: Session,
    rigs: DrawnRigs | Callable[[np.random.Generator], DrawnRigs],
    seed: np.random.SeedSequence,
) -> DrawnMachine:
    """Return a machine with the conditions of a session, and rigs that are given or drawn."""
    n = len(template.values)
    speeds, loads, directions = template.conditions.T
    assemblies = np.arange(n) if template.assemblies is None else template.assemblies
    for_draws, *for_runs = seed.spawn(n + 1)
    random = np.random.default_rng(for_draws)
    counts = template.counts
    if counts is None:
        counts = random.choice(np.array(world.defect_counts), n)
    in_machine, on_torque, tolerance = rigs(random) if callable(rigs) else rigs
    session = DrawnSession(speeds, loads, directions.astype(np.int64), counts, assemblies, tolerance)
    return DrawnMachine(in_machine, on_torque, session, for_runs)


def _simulate_machines(
    world: World, machines: Sequence[DrawnMachine], n_jobs: int
) -> Iterator[dict[str, NDArray[Any]]]:
    """Yield the columns of the rigs of each machine."""
    parts = [machines[k : k + _MACHINES_AT_ONCE] for k in range(0, len(machines), _MACHINES_AT_ONCE)]
    calls = (joblib.delayed(simulate_drawn)(world, part) for part in parts)
    with stopped_quietly(joblib.Parallel(n_jobs=n_jobs, return_as="generator")(calls)) as made:
        for part in made:
            yield from part


def limit_recordings(session: Session, most: int) -> Session:
    """Return at most ``most`` recordings of a session, round-robin over its conditions."""
    _, of_condition = np.unique(session.conditions, axis=0, return_inverse=True)
    earlier = np.array([np.sum(of_condition[:k] == condition) for k, condition in enumerate(of_condition)])
    return select_recordings(session, np.sort(np.argsort(earlier, kind="stable")[:most]))


def select_recordings(session: Session, rows: NDArray[np.intp]) -> Session:
    """Return some recordings of a session."""
    return dataclasses.replace(
        session, **{name: values[rows] for name, values in vars(session).items() if values is not None}
    )


def with_sizes(effects: Sequence[Effect], sizes: Float) -> tuple[Effect, ...]:
    """Return effects with sizes on the scale of their fit, held within their bounds."""
    made, first = [], 0
    for effect in effects:
        low, high = effect.vector_bounds()
        part = sizes[first : first + low.size]
        first += low.size
        made.append(effect.from_vector(np.clip(part, low, high)))
    return tuple(made)
