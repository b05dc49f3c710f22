"""The reference table: what each effect of the library does to the summaries."""

from __future__ import annotations

import contextlib
import dataclasses
import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import joblib
import numpy as np
from numpy.typing import NDArray

from cyclofeat._files import write_whole
from cyclofeat.gap._null import NO_SUCH_RIG, SPARE, NuisancePrior, cache_key, machine
from cyclofeat.gap._recordings import registered
from cyclofeat.gap._summaries import summarise_all
from cyclofeat.simulators import (
    CompositeSimulator,
    CycloidalGearbox,
    Effect,
    Rig,
    SimulationFailed,
    effect_library,
)

Float = NDArray[np.float64]

_LAYOUT = 2  # raise it when the table's content changes for other reasons than the code that makes it


@dataclass(frozen=True)
class EffectTable:
    """Summaries of recordings with one effect each, and of the same recordings without it.

    Attributes
    ----------
    names : tuple of str
        Effects.
    vectors : dict from str to ndarray, shape (n_draws, n_parameters)
        Parameters of each draw (:meth:`Effect.to_vector`).
    values : dict from str to ndarray, shape (n_draws, n_recordings, n_cells)
        Summaries with the effect; NaN where the simulation failed.
    used : ndarray of int, shape (n_draws, n_recordings)
        Which of the recordings without effect each is the same as, but for the effect.
    null : ndarray, shape (n_null, n_cells)
        Summaries of the recordings without effect.
    counts : ndarray of int, shape (n_null,)
        Their counts of worn lobes.
    """

    names: tuple[str, ...]
    vectors: dict[str, Float] = field(repr=False)
    values: dict[str, Float] = field(repr=False)
    used: NDArray[np.intp] = field(repr=False)
    null: Float = field(repr=False)
    counts: NDArray[np.int64] = field(repr=False)

    @property
    def n_failed(self) -> int:
        """Number of simulations that failed."""
        return sum(int(np.isnan(values[..., 0]).sum()) for values in self.values.values())

    def of(self, names: Sequence[str]) -> EffectTable:
        """The table of some of the effects."""
        vectors, values = ({name: part[name] for name in names} for part in (self.vectors, self.values))
        return dataclasses.replace(self, names=tuple(names), vectors=vectors, values=values)

    def null_deviations(self) -> Float:
        """Summaries without effect less the mean of their count, shape (n_null, n_cells)."""
        return self.null - self._means()[self.counts]

    def deviations(self, name: str) -> Float:
        """Summaries with an effect less the mean of their count without it, like ``values``."""
        return self.values[name] - self._means()[self.counts[self.used]]

    def shifts(self, name: str) -> Float:
        """Mean change by each draw of an effect, recording against recording, shape (n_draws, n_cells)."""
        return np.asarray(np.mean(self.values[name] - self.null[self.used], axis=1))

    def _means(self) -> Float:
        means = np.full((int(self.counts.max()) + 1, self.null.shape[1]), np.nan)
        for count in np.unique(self.counts):
            means[count] = self.null[self.counts == count].mean(axis=0)
        return means


def make_table(
    simulator: CompositeSimulator | Rig | CycloidalGearbox | None,
    nuisance: NuisancePrior,
    names: Sequence[str],
    *,
    n_draws: int,
    n_recordings: int,
    n_null: int,
    n_samples: int,
    sampling_rate: float,
    input_speed_hz: float,
    random_state: int = 0,
    n_jobs: int = 1,
    cache: str | os.PathLike[str] | None = None,
) -> EffectTable:
    """Simulate the table, or take it from the cache.

    Every recording with an effect is also simulated without it, from the same random numbers. Effects on
    the torque alone are applied to the simulations that are there anyway.
    """
    composite = nuisance.simulator(simulator)
    classes = tuple(nuisance.defect_counts)
    counts = np.array([classes[i % len(classes)] for i in range(n_null)])
    used = _used(n_draws, n_recordings, n_null, len(classes))
    drawn = {name: _draws(name, n_draws, random_state) for name in names}
    vectors = {name: np.array([effect.to_vector() for effect in effects]) for name, effects in drawn.items()}
    setup = (names, n_draws, n_recordings, n_null, n_samples, sampling_rate, input_speed_hz, random_state)
    file = None
    if cache is not None:
        file = Path(cache) / f"effects-{cache_key(composite, nuisance, *setup, _LAYOUT)}.npz"
        if file.exists():
            with np.load(file) as stored:
                values = {name: stored[f"values_{name}"] for name in names}
                return EffectTable(tuple(names), vectors, values, used, stored["null"], counts)

    n_lobes = nuisance.n_lobes(simulator, input_speed_hz)

    def summaries(i: int, effect: Effect | None, measured_by: Sequence[Sequence[Effect]]) -> Float | None:
        changed = composite
        if effect is not None:
            changed = CompositeSimulator(composite.base, (*composite.effects, effect))
        seed = np.random.SeedSequence(random_state, spawn_key=(i,))
        spare = 0.0 if effect is not None else SPARE
        try:
            run = machine(changed, nuisance, int(counts[i]), n_samples, sampling_rate, seed, spare=spare)
        except NO_SUCH_RIG:
            return None
        torque = np.full((len(measured_by), n_samples), np.nan, dtype=np.float32)
        for row, chain in zip(torque, measured_by, strict=True):
            with contextlib.suppress(*NO_SUCH_RIG):
                row[:] = run.record(chain).torque_out
        made = np.asarray(np.isfinite(torque).all(axis=1))
        if not made[0]:
            return None
        X = registered(torque[made], sampling_rate, input_speed_hz, n_lobes)
        values = summarise_all(X, sampling_rate, input_speed_hz, n_lobes)[0]
        found = np.full((len(torque), values.shape[1]), np.nan)
        found[made] = values
        return found

    on_torque = [name for name in names if not effect_library()[name].needs_simulation()]
    chains = [[(name, j, k) for name in on_torque for j, k in np.argwhere(used == i)] for i in range(n_null)]
    jobs: list[tuple[int, Effect | None, list[tuple[Effect, ...]]]] = [
        (i, None, [(), *((drawn[name][j],) for name, j, _ in chain)]) for i, chain in enumerate(chains)
    ]
    places = [(name, j, k) for name in names if name not in on_torque for j, k in np.ndindex(used.shape)]
    jobs += [(int(used[j, k]), drawn[name][j], [()]) for name, j, k in places]
    found = joblib.Parallel(n_jobs=n_jobs)(joblib.delayed(summaries)(*job) for job in jobs)
    plain = found[:n_null]
    if any(one is None for one in plain):
        raise SimulationFailed("the simulator fails without any effect: there is nothing to compare with")
    null = np.array([one[0] for one in plain])
    values = {name: np.full((*used.shape, null.shape[1]), np.nan) for name in names}
    for chain, one in zip(chains, plain, strict=True):
        for (name, j, k), row in zip(chain, one[1:], strict=True):
            values[name][j, k] = row
    for (name, j, k), one in zip(places, found[n_null:], strict=True):
        if one is not None:
            values[name][j, k] = one[0]
    if file is not None:
        file.parent.mkdir(parents=True, exist_ok=True)
        content: dict[str, Any] = {f"values_{name}": values[name] for name in names}
        write_whole(file, lambda stream: np.savez(stream, null=null, **content))
    return EffectTable(tuple(names), vectors, values, used, null, counts)


def _used(n_draws: int, n_recordings: int, n_null: int, n_classes: int) -> NDArray[np.intp]:
    """Recordings of each draw: of as many different counts as possible, far apart, all used alike."""
    stride = max(n_classes // n_recordings, 1)
    first = np.arange(n_draws)
    start = first % stride + (first // stride) * n_classes
    return (start[:, None] + stride * np.arange(n_recordings)) % n_null


def _draws(name: str, n: int, random_state: int) -> list[Effect]:
    """Independent draws from the prior."""
    kind = effect_library()[name]
    random = np.random.default_rng([random_state, *name.encode()])
    return [kind().draw_parameters(random) for _ in range(n)]
