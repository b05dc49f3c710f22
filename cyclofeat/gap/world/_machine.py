"""Recordings of the rigs of one machine, as summaries."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from cyclofeat.gap.simulations import KERNEL, NO_SUCH_RIG, SPARE, Population, record
from cyclofeat.gap.world._cells import conditions_of, recording_cells, turn_samples
from cyclofeat.gap.world._prior import DrawnSession, draw_session, with_floor
from cyclofeat.simulators import Effect, MachineRun, PlannedRun, SimulationFailed
from cyclofeat.simulators.many import attempt_planned

if TYPE_CHECKING:
    from cyclofeat.gap.world._world import World

Float = NDArray[np.float64]

# Children of the world's seed.
_MACHINE, _RIG, _RECORDING, _SHOWN = range(4)
FEWEST = 4  # recordings of a rig


@dataclasses.dataclass(frozen=True)
class _Drawn:
    """One machine before its simulation: its effects, its session, and the plans of its recordings."""

    number: int
    effects: tuple[Effect, ...]
    session: DrawnSession
    plans: list[PlannedRun | ValueError]


def simulate_machines(world: World, numbers: Sequence[int]) -> list[dict[str, NDArray[Any]]]:
    """Simulate machines and summarise their rigs; each machine depends on the world and its number only.

    Returns the columns of the rigs of each machine (:class:`cyclofeat.gap.world.Rigs`), the number of the rig
    first.
    """
    machines = [_draw(world, number) for number in numbers]
    made = iter(attempt_planned([plan for machine in machines for plan in machine.plans], KERNEL))
    return [_summarised(world, machine, [next(made) for _ in machine.plans]) for machine in machines]


def _seed(world: World, *key: int) -> np.random.SeedSequence:
    return np.random.SeedSequence(world.random_state, spawn_key=key)


def _draw(world: World, number: int) -> _Drawn:
    random = np.random.default_rng(_seed(world, _MACHINE, number))
    session = draw_session(world.speeds_rpm, world.loads_nm, world.defect_counts, world.n_recordings, random)
    effects = world.prior.in_machine(random)
    rig = with_floor(world.rig, world.may_differ).with_added(*effects)
    plans: list[PlannedRun | ValueError] = []
    for i in range(world.n_recordings):
        speed, load = float(session.speeds_rpm[i]), float(session.loads_nm[i])
        at = rig.replace(gearbox=rig.gearbox.replace(input_speed=speed * np.pi / 30, load_torque=load))
        n_samples = turn_samples(conditions_of(world.sampling_rate, speed, world.n_lobes))
        population = Population(at, n_samples, world.sampling_rate, world.wheels)
        seed = _seed(world, _RECORDING, number, i)
        try:
            plans.append(population.plan_run(int(session.counts[i]), seed, spare=SPARE))
        except ValueError as error:
            plans.append(error)
    return _Drawn(number, effects, session, plans)


def _summarised(
    world: World, machine: _Drawn, runs: list[MachineRun | SimulationFailed | ValueError]
) -> dict[str, NDArray[Any]]:
    """Return the columns of the rigs of a machine; NaN for recordings that a rig does not have."""
    session = machine.session
    first = machine.number * world.n_rigs_per_machine
    numbers = range(first, first + world.n_rigs_per_machine)
    chains = [
        world.prior.on_torque(len(machine.effects), np.random.default_rng(_seed(world, _RIG, number)))
        for number in numbers
    ]
    shape = (len(chains), world.n_recordings)
    shown = np.array([_shown(world, number) for number in numbers])
    values = np.full((*shape, len(world.cells)), np.nan, dtype=np.float32)
    speeds = np.full(shape, np.nan)
    for speed in np.unique(session.speeds_rpm):
        conditions = conditions_of(world.sampling_rate, float(speed), world.n_lobes)
        places, torques = [], []
        for i in np.flatnonzero(session.speeds_rpm == speed):
            for j in np.flatnonzero(shown[:, i]):
                torque, turned = _recorded(runs[i], chains[j], int(session.directions[i]))
                if torque is not None and torque.size == turn_samples(conditions):
                    places.append((j, i))
                    torques.append(torque)
                    speeds[j, i] = turned * 60
        if places:
            made, _ = recording_cells(np.array(torques), conditions)
            values[tuple(np.array(places).T)] = made
    every = [(*machine.effects, *chain) for chain in chains]
    at = np.column_stack([session.speeds_rpm, session.loads_nm, session.directions])
    return {
        "numbers": np.array(numbers),
        "values": values,
        "conditions": np.broadcast_to(at, (len(chains), *at.shape)),
        "counts": np.broadcast_to(session.counts, shape),
        "speeds": speeds,
        "sizes": np.array([world.sizes_of(effects) for effects in every]),
    }


def _shown(world: World, number: int) -> NDArray[np.bool_]:
    """Draw the recordings of the machine that a rig has: few more often than all.

    Other rigs teach more than further recordings of the same rig.
    """
    random = np.random.default_rng(_seed(world, _SHOWN, number))
    fewest = min(FEWEST, world.n_recordings)
    n = fewest + int((world.n_recordings - fewest + 1) * random.random() ** 2)
    return random.permutation(world.n_recordings) < n


def _recorded(
    run: MachineRun | SimulationFailed | ValueError, chain: tuple[Effect, ...], direction: int
) -> tuple[NDArray[np.float32] | None, float]:
    """Return the torque of a chain of measurement, times the direction, and the input's speed in Hz.

    In reverse the mirror image of the gearbox runs: the torque has the other sign before it is measured.
    """
    if not isinstance(run, MachineRun):
        return None, np.nan
    if direction < 0:
        run = dataclasses.replace(run, run=dataclasses.replace(run.run, torque_out=-run.run.torque_out))
    try:
        made = record(run, chain)
    except NO_SUCH_RIG:
        return None, np.nan
    if not np.all(np.isfinite(made.torque)):
        return None, np.nan
    return made.torque * np.float32(direction), made.speed
