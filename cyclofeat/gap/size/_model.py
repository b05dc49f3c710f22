"""Mean summaries of simulated recordings as a function of the effects' parameters."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import joblib
import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from cyclofeat.gap.comparison import Comparison
from cyclofeat.gap.simulations import NO_SUCH_RIG, SPARE, Population, Record, record
from cyclofeat.gap.summaries import class_means, less_class_means, summarise
from cyclofeat.simulators import Effect, EffectParameter, MachineRun, SimulationFailed

Float = NDArray[np.float64]
# Arguments of Population.run_machine in a worker: the population, the count and the seed.
_Task = tuple[Population, int, np.random.SeedSequence]

AT_OPTIMUM = 32  # recordings at the optimum, for its correction and the weights of the cells
PER_STEP = 4  # simulated recordings per evaluation
_BEYOND_PRIOR = 1.0  # search range beyond the ends of the prior, in widths of the prior
AT_BOUND = 0.01  # distance to a bound that counts as at the bound, as a share of the searched range


class FitModel:
    """Mean summaries of simulated recordings as a function of the effects' parameters.

    ``n_calls`` recordings were simulated, ``n_asked`` were requested by the search, ``n_failed`` failed.
    """

    def __init__(
        self, comparison: Comparison, effects: tuple[Effect, ...], counts: NDArray[np.int64] | None
    ) -> None:
        self.comparison, self.population, self.space = comparison, comparison.population, FitSpace(effects)
        self.by_count = counts is not None
        self.known = np.array(comparison.defect_counts) if counts is None else counts
        self.counts = matched_counts(self.known, AT_OPTIMUM)
        self.n_calls = self.n_asked = self.n_failed = 0
        self._runs: dict[bytes, list[MachineRun | None]] = {}

    def mean(self, place: Float) -> Float:
        """Mean summary of the PER_STEP recordings at a place; NaN if none could be simulated."""
        self.n_asked += PER_STEP
        values = self._values(place, PER_STEP)
        return np.asarray(values.mean(axis=0)) if len(values) else np.full(1, np.nan)

    def summaries(self, place: Float, n: int) -> Float:
        """Summaries of n recordings, (n, n_cells)."""
        values = self._values(place, n)
        if len(values) < n / 2:
            raise SimulationFailed("the simulations at the optimum fail: the effect's size cannot be stated")
        return values

    def centred(self, values: Float) -> Float:
        """Values less the mean of each count, or of all where counts are not known."""
        counts = self.counts[: len(values)]
        return less_own_means(values, counts if self.by_count else 0 * counts)

    def _values(self, place: Float, n: int) -> Float:
        in_machine, on_torque = self._parted(place)
        runs = [run for run in self._machines(in_machine, n) if run is not None]
        if not runs:
            return np.empty((0, 0))
        try:
            return self._summarised([record(run, on_torque) for run in runs])
        except NO_SUCH_RIG:
            self.n_failed += len(runs)
            return np.empty((0, 0))

    def scattered(self, places: Float, first: int) -> tuple[Float, NDArray[np.bool_], NDArray[np.int64]]:
        """Simulate one recording at each place, numbered from ``first``.

        Returns summaries (n_done, n_cells), the places that succeeded as a mask, and the counts of worn lobes
        (n_done,).
        """
        counts = matched_counts(self.known, len(places))
        parted = [self._parted(place) for place in places]
        records = joblib.Parallel(n_jobs=self.comparison.n_jobs)(
            joblib.delayed(_recorded)(
                on_torque, *self._task(self.population.with_added(*in_machine), first + k, int(counts[k]))
            )
            for k, (in_machine, on_torque) in enumerate(parted)
        )
        done = np.array([record is not None for record in records])
        self.n_calls += len(places)
        self.n_failed += int(np.sum(~done))
        if np.sum(done) < len(places) / 2:
            raise SimulationFailed("the simulations at the optimum fail: the effect's size cannot be stated")
        return self._summarised([record for record in records if record is not None]), done, counts[done]

    def _parted(self, place: Float) -> tuple[tuple[Effect, ...], tuple[Effect, ...]]:
        """Return the effects in the machine, and those on the torque signal only."""
        effects = self.space.effects(place)
        return (
            tuple(effect for effect in effects if effect.needs_simulation()),
            tuple(effect for effect in effects if not effect.needs_simulation()),
        )

    def _summarised(self, records: list[Record]) -> Float:
        X = np.array([record.torque for record in records])
        speeds = np.array([record.speed for record in records]) if self.comparison.tachometer else None
        return summarise(X, self.comparison.conditions, speeds)[0]

    def _machines(self, effects: tuple[Effect, ...], n: int) -> list[MachineRun | None]:
        """Return the first n runs of the machine with these effects; each is simulated once."""
        key = repr([effect.to_dict() for effect in effects]).encode()
        if effects:
            # The search does not return to earlier parameters: one set of runs is enough.
            self._runs = {key: self._runs[key]} if key in self._runs else {}
        runs = self._runs.setdefault(key, [])
        population, missing = self.population.with_added(*effects), range(len(runs), n)
        made = joblib.Parallel(n_jobs=self.comparison.n_jobs)(
            joblib.delayed(_machine_run)(*self._task(population, i, int(self.counts[i % len(self.counts)])))
            for i in missing
        )
        self.n_calls += len(missing)
        self.n_failed += sum(run is None for run in made)
        runs += made
        return runs[:n]

    def _task(self, population: Population, i: int, count: int) -> _Task:
        return population, count, np.random.SeedSequence([self.comparison.random_state, 1], spawn_key=(i,))


# Functions, not methods: a method would be sent to a worker with all runs that the model stores.


def _machine_run(population: Population, count: int, seed: np.random.SeedSequence) -> MachineRun | None:
    """Run of the machine, or None where it cannot be simulated."""
    try:
        return population.run_machine(count, seed, spare=SPARE)
    except NO_SUCH_RIG:
        return None


def _recorded(on_torque: tuple[Effect, ...], *task: *_Task) -> Record | None:
    """Recording of a new run, or None where it cannot be simulated."""
    run = _machine_run(*task)
    try:
        return None if run is None else record(run, on_torque)
    except NO_SUCH_RIG:
        return None


class FitSpace:
    """Fitted parameters of several effects as one vector, within bounds."""

    def __init__(self, effects: Sequence[Effect]) -> None:
        self._effects = tuple(effects)
        self.names = [f"{e.effect_id}.{name}" for e in effects for name in e.vector_names()]
        if len(set(self.names)) < len(self.names):
            raise ValueError(f"effect must name each effect once, got {', '.join(self.names)}")
        self._parameters: list[EffectParameter] = [
            e.parameters[name] for e in effects for name in e.vector_names()
        ]
        self.units = [parameter.unit for parameter in self._parameters]
        ends = np.array([_prior_ends(parameter) for parameter in self._parameters])
        self.widths = ends[:, 1] - ends[:, 0]
        bounds = [e.vector_bounds() for e in effects]
        lowest, highest = (np.concatenate([bound[k] for bound in bounds]) for k in range(2))
        beyond = _BEYOND_PRIOR * self.widths
        self.low = np.maximum(ends[:, 0] - beyond, lowest)
        self.high = np.minimum(ends[:, 1] + beyond, highest)

    @property
    def given(self) -> Float:
        """Parameters of the effects as given, moved off the bounds."""
        values = []
        for effect in self._effects:
            try:
                values.append(effect.to_vector())
            except ValueError:  # the logarithm of a neutral value: take the middle instead
                values.append(np.full(len(effect.vector_names()), np.nan))
        middle = (self.low + self.high) / 2
        given = np.concatenate(values)
        return self.inside(np.where(np.isfinite(given), given, middle))

    def from_prior(self, random: np.random.Generator) -> Float:
        """Parameters drawn from the priors."""
        drawn = [effect.draw_parameters(random).to_vector() for effect in self._effects]
        return self.inside(np.concatenate(drawn))

    def inside(self, place: Float) -> Float:
        """Return parameters moved off the bounds by about a hundredth of the range, to start a search."""
        margin = 1.1 * AT_BOUND * (self.high - self.low)
        return np.clip(place, self.low + margin, self.high - margin)

    def clipped(self, place: Float) -> Float:
        return np.clip(place, self.low, self.high)

    def effects(self, place: Float) -> tuple[Effect, ...]:
        sizes = [len(effect.vector_names()) for effect in self._effects]
        parts = np.split(place, np.cumsum(sizes)[:-1])
        return tuple(effect.from_vector(part) for effect, part in zip(self._effects, parts, strict=True))

    def natural(self, place: Float) -> Float:
        """The parameters in their units."""
        return np.array(
            [getattr(e, name) for e in self.effects(place) for name in e.vector_names()], dtype=float
        )


def less_own_means(values: Float, counts: NDArray[Any]) -> Float:
    """Return values less the mean of their count, scaled to the variance about the true mean."""
    sizes = np.array([np.sum(counts == count) for count in counts])
    around = less_class_means(values, counts, class_means(values, counts))
    return np.asarray(around * np.sqrt(sizes / np.maximum(sizes - 1, 1))[:, None])


def matched_counts(known: NDArray[np.int64], n: int) -> NDArray[np.int64]:
    """Return counts for n simulated recordings, in about the shares of the known ones from the first on."""
    # Shifted so that the first four values are the middles of the quarters.
    shares = (qmc.Halton(1, scramble=False).random(n)[:, 0] + 0.5 / PER_STEP) % 1
    return np.asarray(np.sort(known)[(shares * len(known)).astype(int)])


def _prior_ends(parameter: EffectParameter) -> tuple[float, float]:
    """Return the ends of nearly all of a prior, on the scale of the fit."""
    prior = parameter.prior
    assert prior is not None
    low, high = (float(end) for end in prior.support())
    if not (math.isfinite(low) and math.isfinite(high)):
        low, high = (float(prior.ppf(share)) for share in (0.01, 0.99))
    return (math.log(low), math.log(high)) if parameter.log else (low, high)
