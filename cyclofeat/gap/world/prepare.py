"""Simulation of rigs of a world as summaries, and of a whole world into shards on disk."""

from __future__ import annotations

import dataclasses
import json
import os
from collections.abc import Callable, Sequence
from typing import Any

import joblib
import numpy as np
from numpy.typing import NDArray

from cyclofeat._base.checks import n_jobs as checked_jobs
from cyclofeat._base.checks import whole
from cyclofeat._base.progress import stopped_quietly
from cyclofeat._base.shards import ShardStore
from cyclofeat.gap.simulations import KERNEL, NO_SUCH_RIG, Population, record, versions
from cyclofeat.gap.summaries.summarise import Kinematics
from cyclofeat.gap.world.cells import recording_cells, turn_samples
from cyclofeat.gap.world.rigs import Rigs
from cyclofeat.gap.world.world import DrawnSession, World, draw_session, with_noise_and_drift
from cyclofeat.simulators import Effect, SimulationFailed
from cyclofeat.simulators.machine import MachineRun
from cyclofeat.simulators.sampling import sample_runs

Float = NDArray[np.float64]

# Children of the world's seed.
_MACHINE, _RIG, _RECORDING = range(3)
FEWEST_RECORDINGS = 4  # recordings of a machine


@dataclasses.dataclass(frozen=True)
class DrawnMachine:
    """One machine before its simulation.

    ``effects`` are those that the gearbox answers, ``chains`` those on the torque signal of each rig that
    shares the machine, ``session`` the conditions of the recordings, and ``seeds`` the seeds of the
    recordings.
    """

    effects: tuple[Effect, ...]
    chains: list[tuple[Effect, ...]]
    session: DrawnSession
    seeds: list[np.random.SeedSequence]


def simulate_machines(world: World, numbers: Sequence[int]) -> list[dict[str, NDArray[Any]]]:
    """Simulate machines and summarise their rigs; each machine depends on the world and its number only.

    Returns the columns of the rigs of each machine (:class:`cyclofeat.gap.world.Rigs`), the number of the rig
    first.
    """
    drawn = []
    for number in numbers:
        random = np.random.default_rng(_world_seed(world, _MACHINE, number))
        # Few recordings more often than many: other machines teach more than further recordings of one.
        fewest = min(FEWEST_RECORDINGS, world.n_recordings)
        n = fewest + int((world.n_recordings - fewest + 1) * random.random() ** 2)
        session = draw_session(world, n, random)
        effects = world.prior.in_machine(random)
        chains = [
            world.prior.on_torque(len(effects), np.random.default_rng(_world_seed(world, _RIG, rig)))
            for rig in _rig_numbers(world, number).tolist()
        ]
        seeds = [_world_seed(world, _RECORDING, number, i) for i in range(n)]
        drawn.append(DrawnMachine(effects, chains, session, seeds))
    machines = []
    for number, columns in zip(numbers, simulate_drawn(world, drawn), strict=True):
        # Up to the largest number of recordings: the first one's conditions again, NaN, and counts of 0.
        missing = world.n_recordings - columns["counts"].shape[1]
        for name, end in {"values": np.nan, "speeds": np.nan, "counts": 0}.items():
            of_name = columns[name]
            padding = np.full((len(of_name), missing, *of_name.shape[2:]), end)
            columns[name] = np.concatenate([of_name, padding], axis=1).astype(of_name.dtype)
        first = np.repeat(columns["conditions"][:, :1], missing, axis=1)
        columns["conditions"] = np.concatenate([columns["conditions"], first], axis=1)
        machines.append({"numbers": _rig_numbers(world, number)} | columns)
    return machines


def simulate_drawn(world: World, machines: Sequence[DrawnMachine]) -> list[dict[str, NDArray[Any]]]:
    """Simulate drawn machines, and return the columns of the rigs of each, without their numbers."""
    samples = []
    for machine in machines:
        session, seeds = machine.session, machine.seeds
        rig = with_noise_and_drift(world.rig, world.may_differ, session.tolerance)
        rig = rig.with_added(*machine.effects)
        first_of = {number: seeds[i] for i, number in reversed([*enumerate(session.assemblies.tolist())])}
        for i, seed in enumerate(seeds):
            speed, assembly = float(session.speeds_rpm[i]), first_of[int(session.assemblies[i])]
            n_samples = turn_samples(Kinematics(world.sampling_rate, speed / 60, world.n_lobes))
            at = rig.at(speed, float(session.loads_nm[i]))
            population = Population(at, n_samples, world.sampling_rate, world.wheels, quantity=world.quantity)
            # Slow converters and lost samples need a longer run.
            samples.append(population.sample(int(session.counts[i]), seed, assembly, chains=machine.chains))
    runs = iter(sample_runs(samples, kernel=KERNEL))
    return [_rig_columns(world, machine, [next(runs) for _ in machine.seeds]) for machine in machines]


def _world_seed(world: World, *key: int) -> np.random.SeedSequence:
    return np.random.SeedSequence(world.random_state, spawn_key=key)


def _rig_numbers(world: World, number: int) -> NDArray[np.int64]:
    """Return the numbers of the rigs of a machine."""
    return number * world.n_rigs_per_machine + np.arange(world.n_rigs_per_machine)


def _rig_columns(
    world: World, machine: DrawnMachine, runs: list[MachineRun | SimulationFailed | ValueError]
) -> dict[str, NDArray[Any]]:
    """Return the columns of the rigs of a machine; NaN for recordings that could not be made."""
    session, chains = machine.session, machine.chains
    shape = len(chains), len(machine.seeds)
    values = np.full((*shape, len(world.cells)), np.nan, dtype=np.float32)
    speeds = np.full(shape, np.nan)
    for speed in np.unique(session.speeds_rpm):
        conditions = Kinematics(world.sampling_rate, float(speed) / 60, world.n_lobes)
        places, torques = [], []
        for i in np.flatnonzero(session.speeds_rpm == speed):
            for j, chain in enumerate(chains):
                run = runs[i]
                if not isinstance(run, MachineRun):
                    continue
                try:
                    recording = record(run, chain, int(session.directions[i]))
                except NO_SUCH_RIG:
                    continue
                if np.all(np.isfinite(recording.torque)) and recording.torque.size == turn_samples(
                    conditions
                ):
                    places.append((j, i))
                    torques.append(recording.torque)
                    speeds[j, i] = recording.speed * 60
        if places:
            values[tuple(np.array(places).T)] = recording_cells(np.array(torques), conditions)[0]
    every = [(*machine.effects, *chain) for chain in chains]
    at = np.column_stack([session.speeds_rpm, session.loads_nm, session.directions])
    return {
        "values": values,
        "conditions": np.broadcast_to(at, (len(chains), *at.shape)),
        "counts": np.broadcast_to(session.counts, shape),
        "speeds": speeds,
        "sizes": np.array([world.sizes_of(effects) for effects in every]),
    }


_MACHINES_PER_SHARD = 8  # their runs fill the lanes of some batches
_FORMAT = "cyclofeat world 1"
_SIMULATED_BY = ("signal", "gap/summaries", "gap/simulations", "gap/world")


def describe_world(world: World) -> dict[str, Any]:
    """Return what the rigs of a world depend on: its settings, and the versions of code and libraries."""
    return {
        "format": _FORMAT, "made_with": versions(*_SIMULATED_BY), "world": world.to_dict(),
        "names": world.names, "size_names": world.size_names, "logarithmic": world.logarithmic,
        "cells": world.cells,
    }  # fmt: skip


def prepare_world(
    world: World,
    folder: str | os.PathLike[str],
    n_machines: int,
    *,
    n_jobs: int = 1,
    progress: Callable[[int, int], object] | None = None,
) -> Rigs:
    """Simulate machines of a world into a folder, and return their rigs.

    Shards of eight machines appear whole or not at all: an interrupted preparation goes on where it stopped,
    and a larger ``n_machines`` adds to what is there.

    Parameters
    ----------
    world : World
    folder : path
        Made if it does not exist.
    n_machines : int
        Rounded up to whole shards.
    n_jobs : int, default=1
        Number of worker processes.
    progress : callable, optional
        Called after each shard with the number done and their total.

    Returns
    -------
    Rigs
        ``n_machines`` times ``world.n_rigs_per_machine``, less those with fewer than four recordings.

    Raises
    ------
    ValueError
        If the folder holds another world, or one made by other code.
    """
    n_shards = -(-whole("n_machines", n_machines, 1) // _MACHINES_PER_SHARD)
    checked_jobs(n_jobs)
    store = ShardStore(folder, "world.json")
    content = describe_world(world)
    store.begin_work(content)
    stated, wanted = store.read_json(store.description), json.loads(json.dumps(content))
    if stated != wanted:
        if stated.get("made_with") != wanted["made_with"]:
            different = ["versions of code and libraries"]
        else:
            old, new = stated.get("world", {}), wanted["world"]
            different = [name for name in new if old.get(name) != new[name]] or ["summaries"]
        raise ValueError(
            f"folder must be empty or hold the same world, got {store.folder}, which was made with other "
            f"{', '.join(different)}: name another folder, or remove this one"
        )
    shards = [f"shard-{shard:05d}.npz" for shard in range(n_shards)]
    missing = store.missing_names(shards)

    def simulate_shard(name: str) -> None:
        first = shards.index(name) * _MACHINES_PER_SHARD
        machines = simulate_machines(world, range(first, first + _MACHINES_PER_SHARD))
        columns: dict[str, Any] = {
            name: np.concatenate([machine[name] for machine in machines]) for name in machines[0]
        }
        store.write_file(name, lambda stream: np.savez(stream, **columns))

    calls = (joblib.delayed(simulate_shard)(name) for name in missing)
    results = joblib.Parallel(n_jobs=n_jobs, return_as="generator_unordered")(calls)
    with stopped_quietly(results):
        for done, _ in enumerate(results, start=n_shards - len(missing) + 1):
            if progress is not None:
                progress(done, n_shards)
    parts = []
    for shard in shards:
        with np.load(store.path_of(shard)) as columns_of_shard:
            parts.append(dict(columns_of_shard))
    columns: dict[str, Any] = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    simulated = np.isfinite(columns["values"][:, :, 0])
    rigs = Rigs(
        names=tuple(stated["names"]),
        size_names=tuple(stated["size_names"]),
        logarithmic=tuple(stated["logarithmic"]),
        cells=tuple(stated["cells"]),
        world=stated["world"],
        machines=columns["numbers"] // stated["world"]["n_rigs_per_machine"],
        **columns,
    )
    return rigs.of(simulated.sum(axis=1) >= min(FEWEST_RECORDINGS, simulated.shape[1]))
