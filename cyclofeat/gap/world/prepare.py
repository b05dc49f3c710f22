"""Simulation of rigs of a world as summaries, and of a whole world into shards on disk."""

from __future__ import annotations

import contextlib
import itertools
import json
import os
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

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
from cyclofeat.gap.world.world import Rigs, Session, World, draw_session, with_noise_and_drift
from cyclofeat.simulators import Effect, SimulationFailed
from cyclofeat.simulators.machine import MachineRun
from cyclofeat.simulators.sampling import sample_runs

Float = NDArray[np.float64]

# Children of the world's seed.
_MACHINE, _RIG, _RECORDING = range(3)
FEWEST_RECORDINGS = 4  # recordings of a machine


class DrawnMachine(NamedTuple):
    """One machine before its simulation."""

    effects: tuple[Effect, ...]  # those that the gearbox answers
    chains: list[tuple[Effect, ...]]  # those on the torque signal of each rig that shares the machine
    session: Session  # conditions, counts and assemblies of the recordings
    tolerance: float  # factor on all that differs anyway
    seeds: list[np.random.SeedSequence]  # of the recordings


def simulate_machines(world: World, numbers: Sequence[int]) -> list[dict[str, NDArray[Any]]]:
    """Simulate machines, each by its number only, and return the columns of their :class:`Rigs`."""
    drawn = []
    for number in numbers:
        random = np.random.default_rng(_world_seed(world, _MACHINE, number))
        # Few recordings more often than many: other machines teach more than further recordings of one.
        fewest = min(FEWEST_RECORDINGS, world.n_recordings)
        n = fewest + int((world.n_recordings - fewest + 1) * random.random() ** 2)
        session, tolerance = draw_session(world, n, random)
        effects = world.prior.in_machine(random)
        chains = [
            world.prior.on_torque(len(effects), np.random.default_rng(_world_seed(world, _RIG, rig)))
            for rig in range(number * world.n_rigs_per_machine, (number + 1) * world.n_rigs_per_machine)
        ]
        seeds = [_world_seed(world, _RECORDING, number, i) for i in range(n)]
        drawn.append(DrawnMachine(effects, chains, session, tolerance, seeds))
    machines = simulate_drawn(world, drawn)
    for columns in machines:
        # Up to the largest number of recordings: the first one's conditions again, NaN, and counts of 0.
        missing = world.n_recordings - columns["counts"].shape[1]
        for name, end in {"values": np.nan, "speeds": np.nan, "counts": 0}.items():
            of_name = columns[name]
            padding = np.full((len(of_name), missing, *of_name.shape[2:]), end)
            columns[name] = np.concatenate([of_name, padding], axis=1).astype(of_name.dtype)
        first = np.repeat(columns["conditions"][:, :1], missing, axis=1)
        columns["conditions"] = np.concatenate([columns["conditions"], first], axis=1)
    return machines


def simulate_drawn(world: World, machines: Sequence[DrawnMachine]) -> list[dict[str, NDArray[Any]]]:
    """Simulate drawn machines, and return the columns of the rigs of each, without their numbers."""
    samples = []
    for effects, chains, session, tolerance, seeds in machines:
        rig = with_noise_and_drift(world.rig, world.may_differ, tolerance).with_added(*effects)
        counts, assemblies = (np.asarray(x).tolist() for x in (session.counts, session.assemblies))
        first_of = {number: seeds[i] for i, number in reversed([*enumerate(assemblies)])}
        for i, seed in enumerate(seeds):
            speed, load, _ = session.conditions[i].tolist()
            n_samples = turn_samples(Kinematics(world.sampling_rate, speed / 60, world.n_lobes))
            population = Population(
                rig.at(speed, load), n_samples, world.sampling_rate, world.wheels, quantity=world.quantity
            )
            # Slow converters and lost samples need a longer run.
            samples.append(population.sample(int(counts[i]), seed, first_of[assemblies[i]], chains=chains))
    runs = iter(sample_runs(samples, kernel=KERNEL))
    return [_rig_columns(world, machine, [next(runs) for _ in machine.seeds]) for machine in machines]


def _world_seed(world: World, *key: int) -> np.random.SeedSequence:
    return np.random.SeedSequence(world.random_state, spawn_key=key)


def _rig_columns(
    world: World, machine: DrawnMachine, runs: list[MachineRun | SimulationFailed | ValueError]
) -> dict[str, NDArray[Any]]:
    """Return the columns of the rigs of a machine; NaN for recordings that could not be made."""
    effects, chains, session, *_ = machine
    at, counts = session.conditions, np.asarray(session.counts)
    shape = len(chains), len(at)
    values = np.full((*shape, len(world.cells)), np.nan, dtype=np.float32)
    speeds = np.full(shape, np.nan)
    for speed in np.unique(at[:, 0]):
        turn = Kinematics(world.sampling_rate, float(speed) / 60, world.n_lobes)
        places, torques = [], []
        for i, (j, chain) in itertools.product(np.flatnonzero(at[:, 0] == speed), enumerate(chains)):
            run, torque = runs[i], np.empty(0, dtype=np.float32)
            if isinstance(run, MachineRun):
                with contextlib.suppress(*NO_SUCH_RIG):
                    torque, mean_speed = record(run, chain, int(at[i, 2]))
            if torque.size == turn_samples(turn) and np.all(np.isfinite(torque)):
                places.append((j, i))
                torques.append(torque)
                speeds[j, i] = mean_speed * 60
        if places:
            values[tuple(np.array(places).T)] = recording_cells(np.array(torques), turn)[0]
    sizes = np.full((len(chains), len(world.size_names)), np.nan)
    for row, chain in zip(sizes, chains, strict=True):
        for effect in (*effects, *chain):
            first = world.size_names.index(f"{effect.effect_id}.{effect.vector_names()[0]}")
            row[first : first + len(effect.vector_names())] = effect.to_vector()
    return {
        "values": values, "conditions": np.broadcast_to(at, (len(chains), *at.shape)),
        "counts": np.broadcast_to(counts, shape), "speeds": speeds, "sizes": sizes,
    }  # fmt: skip


def collect_rigs(
    world: World, parts: Sequence[Mapping[str, NDArray[Any]]], n_rigs: int, n_per_machine: int
) -> Rigs:
    """Return the first rigs of columns in parts, without those of which too many recordings failed."""
    columns: dict[str, Any] = {
        name: np.concatenate([part[name] for part in parts])[:n_rigs] for name in parts[0]
    }
    numbers, simulated = np.arange(n_rigs), np.isfinite(columns["values"][:, :, 0])
    rigs = Rigs(
        world.names, world.size_names, world.logarithmic, world.cells, numbers, numbers // n_per_machine,
        world=world.to_dict(), **columns,
    )  # fmt: skip
    return rigs.of(simulated.sum(axis=1) >= min(FEWEST_RECORDINGS, simulated.shape[1]))


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
    per_machine = world.n_rigs_per_machine
    return collect_rigs(world, parts, n_shards * _MACHINES_PER_SHARD * per_machine, per_machine)
