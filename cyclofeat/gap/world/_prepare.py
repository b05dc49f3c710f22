"""Simulation of a world into shards on disk, and their reading."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import joblib
import numpy as np

from cyclofeat._base.checks import n_jobs as checked_jobs
from cyclofeat._base.checks import whole
from cyclofeat._base.files import write_whole
from cyclofeat._base.parallel import stopped_quietly
from cyclofeat.gap.simulations import versions
from cyclofeat.gap.world._machine import FEWEST_RECORDINGS, simulate_machines
from cyclofeat.gap.world._rigs import Rigs
from cyclofeat.gap.world._world import World

_MACHINES_PER_SHARD = 8  # their runs fill the lanes of some batches
_SETTINGS = "world.json"
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
    place = Path(folder)
    place.mkdir(parents=True, exist_ok=True)
    _state(world, place)
    for part in place.glob(".*.part"):
        part.unlink()
    missing = [shard for shard in range(n_shards) if not _shard(place, shard).exists()]
    calls = (joblib.delayed(_simulate_shard)(world, place, shard) for shard in missing)
    made = joblib.Parallel(n_jobs=n_jobs, return_as="generator_unordered")(calls)
    with stopped_quietly(made):
        for done, _ in enumerate(made, start=n_shards - len(missing) + 1):
            if progress is not None:
                progress(done, n_shards)
    return _read(place, [_shard(place, shard) for shard in range(n_shards)])


def _shard(folder: Path, shard: int) -> Path:
    return folder / f"shard-{shard:05d}.npz"


def _state(world: World, folder: Path) -> None:
    """Write the settings of a world, or check that the folder has the same."""
    content = {
        "format": _FORMAT, "made_with": versions(*_SIMULATED_BY), "world": world.to_dict(),
        "names": world.names, "size_names": world.size_names, "logarithmic": world.logarithmic,
        "cells": world.cells,
    }  # fmt: skip
    text = json.dumps(content, indent=1)
    file = folder / _SETTINGS
    if not file.exists():
        write_whole(file, lambda stream: stream.write(text.encode()), durable=True)
        return
    before, now = json.loads(file.read_text(encoding="utf-8")), json.loads(text)
    if before == now:
        return
    if before.get("made_with") != now["made_with"]:
        different = ["versions of code and libraries"]
    else:
        old, new = before.get("world", {}), now["world"]
        different = [name for name in new if old.get(name) != new[name]] or ["summaries"]
    raise ValueError(
        f"folder must be empty or hold the same world, got {folder}, which was made with other "
        f"{', '.join(different)}: name another folder, or remove this one"
    )


def _simulate_shard(world: World, folder: Path, shard: int) -> None:
    first = shard * _MACHINES_PER_SHARD
    machines = simulate_machines(world, range(first, first + _MACHINES_PER_SHARD))
    columns: dict[str, Any] = {
        name: np.concatenate([machine[name] for machine in machines]) for name in machines[0]
    }
    write_whole(_shard(folder, shard), lambda stream: np.savez(stream, **columns), durable=True)


def _read(folder: Path, files: list[Path]) -> Rigs:
    stated = json.loads((folder / _SETTINGS).read_text(encoding="utf-8"))
    parts = []
    for file in files:
        with np.load(file) as shard:
            parts.append(dict(shard))
    columns: dict[str, Any] = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    made = np.isfinite(columns["values"][:, :, 0])
    rigs = Rigs(
        names=tuple(stated["names"]),
        size_names=tuple(stated["size_names"]),
        logarithmic=tuple(stated["logarithmic"]),
        cells=tuple(stated["cells"]),
        world=stated["world"],
        machines=columns["numbers"] // stated["world"]["n_rigs_per_machine"],
        **columns,
    )
    return rigs.of(made.sum(axis=1) >= min(FEWEST_RECORDINGS, made.shape[1]))
