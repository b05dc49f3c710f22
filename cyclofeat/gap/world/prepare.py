"""Simulation of a world into shards on disk, and their reading."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from typing import Any

import joblib
import numpy as np

from cyclofeat._base.checks import n_jobs as checked_jobs
from cyclofeat._base.checks import whole
from cyclofeat._base.progress import stopped_quietly
from cyclofeat._base.shards import ShardStore
from cyclofeat.gap.simulations import versions
from cyclofeat.gap.world.machine import FEWEST_RECORDINGS, simulate_machines
from cyclofeat.gap.world.rigs import Rigs
from cyclofeat.gap.world.world import World

_MACHINES_PER_SHARD = 8  # their runs fill the lanes of some batches
_FORMAT = "cyclofeat world 1"
_SIMULATED_BY = ("signal", "gap/summaries", "gap/simulations", "gap/world")


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
    content = {
        "format": _FORMAT, "made_with": versions(*_SIMULATED_BY), "world": world.to_dict(),
        "names": world.names, "size_names": world.size_names, "logarithmic": world.logarithmic,
        "cells": world.cells,
    }  # fmt: skip
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
    calls = (joblib.delayed(_simulate_shard)(world, store, shards.index(name), name) for name in missing)
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


def _simulate_shard(world: World, store: ShardStore, shard: int, name: str) -> None:
    first = shard * _MACHINES_PER_SHARD
    machines = simulate_machines(world, range(first, first + _MACHINES_PER_SHARD))
    columns: dict[str, Any] = {
        name: np.concatenate([machine[name] for machine in machines]) for name in machines[0]
    }
    store.write_file(name, lambda stream: np.savez(stream, **columns))
