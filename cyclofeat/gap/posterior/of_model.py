"""The posterior for a model: the packaged one where it fits, else one that is learned once and kept."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np

from cyclofeat._base.quantities import in_words
from cyclofeat._base.training import import_jax
from cyclofeat.gap.posterior.effect_posterior import EffectPosterior, check_start, load_posterior
from cyclofeat.gap.posterior.inputs import BEYOND
from cyclofeat.gap.world.prepare import describe_world, prepare_world
from cyclofeat.gap.world.world import AROUND, World
from cyclofeat.simulators import Rig

# Eight rigs each: some ten minutes of two cores.
_MACHINES = 480


def is_of_model(posterior: EffectPosterior, model: Rig) -> bool:
    """Return True if a posterior was learned for a model; speed, load and names are no difference."""
    learned = posterior.world.rig
    set_points = {name: getattr(learned.gearbox, name) for name in ("input_speed", "load_torque")}
    same = {name: getattr(learned, name) for name in ("name", "speeds_rpm", "loads_nm")}
    return model.replace(gearbox=model.gearbox.replace(**set_points), **same) == learned


def covers_world(posterior: EffectPosterior, world: World) -> bool:
    """Return True if a posterior was learned for the model, quantity and conditions of a world."""
    learned = posterior.world
    lowest, highest = zip(learned.speeds_rpm, learned.loads_nm, strict=True)
    low, high = zip(world.speeds_rpm, world.loads_nm, strict=True)
    # A world reaches further than its recordings, which the posterior has to cover.
    inside = np.all(np.array(low) / (1 - AROUND) >= np.array(lowest) * (1 - BEYOND)) and np.all(
        np.array(high) / (1 + AROUND) <= np.array(highest) * (1 + BEYOND)
    )
    return bool(
        inside
        and is_of_model(posterior, world.rig)
        and (learned.quantity, learned.sampling_rate) == (world.quantity, world.sampling_rate)
        and set(world.defect_counts) <= set(learned.defect_counts)
    )


def posterior_of_world(
    world: World,
    *,
    cache: str | os.PathLike[str] | None = None,
    n_jobs: int = 1,
    progress: Callable[[str], object] = lambda _: None,
) -> EffectPosterior:
    """Return the packaged posterior if it covers a world, or one learned from few of its rigs.

    It goes on from the packaged networks where the summaries allow it, and is kept in ``cache``, by default
    the user's cache folder. An interrupted preparation goes on. Raises ImportError, before anything is
    simulated, if JAX or Optax is not installed.
    """
    packaged = load_posterior()
    if covers_world(packaged, world):
        return packaged
    folder = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache"), "cyclofeat")
    folder = folder if cache is None else Path(cache)
    description = json.dumps([describe_world(world), _MACHINES], sort_keys=True)
    key = hashlib.sha256(description.encode()).hexdigest()[:16]
    path, rigs_folder = folder / f"posterior-{key}.npz", folder / f"world-{key}"
    if path.exists():
        return load_posterior(path)
    try:
        import_jax()
    except ImportError as error:
        known = packaged.world
        speeds, loads = (
            " to ".join(f"{end:g}" for end in ends) for ends in (known.speeds_rpm, known.loads_nm)
        )
        raise ImportError(
            f"the packaged posterior is for paper B's gearbox, {in_words(known.quantity)}, "
            f"{known.sampling_rate:g} Hz, {speeds} RPM and {loads} Nm; to learn another one, {error}"
        ) from error
    progress("simulating rigs of this model to learn from, once: some ten minutes of two cores")
    count: Callable[[int, int], object] | None = getattr(progress, "count", None)
    rigs = prepare_world(world, rigs_folder, _MACHINES, n_jobs=n_jobs, progress=count)
    progress("learning from them")
    start = None
    with contextlib.suppress(ValueError):
        check_start(packaged, world.cells, world.defect_counts)
        start = packaged
    posterior = EffectPosterior(random_state=world.random_state)
    posterior.fit(rigs, start=start, progress=count).save(path)
    shutil.rmtree(rigs_folder)
    return posterior
