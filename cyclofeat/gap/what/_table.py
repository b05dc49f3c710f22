"""Table of what each effect of the library does to the summaries."""

from __future__ import annotations

import contextlib
import dataclasses
import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field

import joblib
import numpy as np
from numpy.typing import NDArray

from cyclofeat.gap.comparison import SIMULATED_BY, Comparison
from cyclofeat.gap.simulations import KERNEL, NO_SUCH_RIG, SPARE, Population, in_batches, record
from cyclofeat.gap.summaries import Conditions, class_means, less_class_means, summarise
from cyclofeat.simulators import Effect, MachineRun, PlannedRun, SimulationFailed, effect_library
from cyclofeat.simulators.many import attempt_planned

Float = NDArray[np.float64]
Chain = tuple[Effect, ...]  # effects that change the recorded torque only
# Number of the recording, effect in the machine, and the chains that record its run.
Job = tuple[int, Effect | None, list[Chain]]


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
        Row in ``null`` of the same recording without the effect.
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
        """Table of some of the effects."""
        vectors, values = ({name: part[name] for name in names} for part in (self.vectors, self.values))
        return dataclasses.replace(self, names=tuple(names), vectors=vectors, values=values)

    def null_deviations(self) -> Float:
        """Summaries without effect less the mean of their count, shape (n_null, n_cells)."""
        return less_class_means(self.null, self.counts, class_means(self.null, self.counts))

    def deviations(self, name: str) -> Float:
        """Summaries with an effect less the mean of their count without it, shape as ``values``."""
        values, means = self.values[name], class_means(self.null, self.counts)
        rows = values.reshape(-1, values.shape[-1])
        return less_class_means(rows, self.counts[self.used].ravel(), means).reshape(values.shape)

    def shifts(self, name: str) -> Float:
        """Mean change by each draw of an effect, recording against recording, shape (n_draws, n_cells)."""
        return np.asarray(np.mean(self.values[name] - self.null[self.used], axis=1))

    def simulated(self, name: str) -> NDArray[np.intp]:
        """Indices of the draws of an effect without a failed simulation."""
        return np.flatnonzero(np.all(np.isfinite(self.shifts(name)), axis=1))


def make_table(
    comparison: Comparison, names: Sequence[str], *, n_draws: int, n_recordings: int, n_null: int
) -> EffectTable:
    """Simulate ``n_draws`` of each effect from its prior, or return the table from the cache.

    Each of the ``n_recordings`` of a draw is also simulated without the effect, from the same random numbers.
    Effects on the torque alone are applied to the runs of the machine without effect. Raises SimulationFailed
    if a simulation without effect fails.
    """
    classes, state = comparison.defect_counts, comparison.random_state
    counts = np.resize(np.array(classes), n_null)
    used = _used(n_draws, n_recordings, n_null, len(classes))
    drawn = {name: _draws(name, n_draws, state) for name in names}
    stated = {name: [effect.to_dict() for effect in effects] for name, effects in drawn.items()}
    null, values = comparison.remember(
        lambda: _simulated(comparison, drawn, used, counts),
        "table", comparison.population.text, stated, used, counts, state,
        code=(*SIMULATED_BY, "gap/what"),
    )  # fmt: skip
    vectors = {name: np.array([effect.to_vector() for effect in effects]) for name, effects in drawn.items()}
    return EffectTable(tuple(names), vectors, values, used, null, counts)


def _simulated(
    comparison: Comparison, drawn: dict[str, list[Effect]], used: NDArray[np.intp], counts: NDArray[np.int64]
) -> tuple[Float, dict[str, Float]]:
    """Summaries without effect and with each draw of each effect."""
    on_torque = [name for name in drawn if not effect_library()[name].needs_simulation()]
    in_machine = [name for name in drawn if name not in on_torque]
    n_null = len(counts)
    chains = [[(name, j, k) for name in on_torque for j, k in np.argwhere(used == i)] for i in range(n_null)]
    jobs: list[Job] = [
        (i, None, [(), *((drawn[name][j],) for name, j, _ in chain)]) for i, chain in enumerate(chains)
    ]
    places = [(name, j, k) for name in in_machine for j, k in np.ndindex(used.shape)]
    jobs += [(int(used[j, k]), drawn[name][j], [()]) for name, j, k in places]
    population, conditions, state = comparison.population, comparison.conditions, comparison.random_state
    parts = joblib.Parallel(n_jobs=comparison.n_jobs)(
        joblib.delayed(_summaries)(population, conditions, counts, state, part) for part in in_batches(jobs)
    )
    made = list(itertools.chain.from_iterable(parts))
    plain = [rows for rows in made[:n_null] if rows is not None]
    if len(plain) < n_null:
        raise SimulationFailed("the simulator fails without any effect: there is nothing to compare with")
    null = np.array([rows[0] for rows in plain])
    values = {name: np.full((*used.shape, null.shape[1]), np.nan) for name in drawn}
    for chain, rows in zip(chains, plain, strict=True):
        for (name, j, k), row in zip(chain, rows[1:], strict=True):
            values[name][j, k] = row
    for (name, j, k), rows in zip(places, made[n_null:], strict=True):
        if rows is not None:
            values[name][j, k] = rows[0]
    return null, values


def _summaries(
    population: Population,
    conditions: Conditions,
    counts: NDArray[np.int64],
    random_state: int,
    jobs: Sequence[Job],
) -> list[Float | None]:
    """Return the summaries of each run for each of its chains; None for a run that fails."""
    plans = [_planned(population, counts, random_state, job) for job in jobs]
    runs = attempt_planned(plans, KERNEL)
    return [
        _recorded(run, chains, population.n_samples, conditions) if isinstance(run, MachineRun) else None
        for (*_, chains), run in zip(jobs, runs, strict=True)
    ]


def _planned(
    population: Population, counts: NDArray[np.int64], random_state: int, job: Job
) -> PlannedRun | ValueError:
    number, effect, _ = job
    changed = population if effect is None else population.with_added(effect)
    seed = np.random.SeedSequence(random_state, spawn_key=(number,))
    try:
        return changed.plan_run(int(counts[number]), seed, spare=SPARE if effect is None else 0.0)
    except ValueError as error:
        return error


def _recorded(
    run: MachineRun, chains: Sequence[Chain], n_samples: int, conditions: Conditions
) -> Float | None:
    """Return the summaries of a run for each chain; NaN for an impossible chain, None if the first is one."""
    torque = np.full((len(chains), n_samples), np.nan, dtype=np.float32)
    for row, chain in zip(torque, chains, strict=True):
        with contextlib.suppress(*NO_SUCH_RIG):
            row[:] = record(run, chain).torque
    made = np.asarray(np.isfinite(torque).all(axis=1))
    if not made[0]:
        return None
    values = summarise(torque[made], conditions)[0]
    rows = np.full((len(torque), values.shape[1]), np.nan)
    rows[made] = values
    return rows


def _used(n_draws: int, n_recordings: int, n_null: int, n_classes: int) -> NDArray[np.intp]:
    """Choose the recordings for each draw: as many different counts as possible, each used equally often."""
    stride = max(n_classes // n_recordings, 1)
    first = np.arange(n_draws)
    start = first % stride + (first // stride) * n_classes
    return (start[:, None] + stride * np.arange(n_recordings)) % n_null


def _draws(name: str, n: int, random_state: int) -> list[Effect]:
    """Independent draws from the prior."""
    kind = effect_library()[name]
    random = np.random.default_rng([random_state, *name.encode()])
    return [kind().draw_parameters(random) for _ in range(n)]
