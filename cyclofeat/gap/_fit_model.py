"""The fitted model: mean summaries of simulated recordings as a function of the effects' parameters."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import joblib
import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from cyclofeat.gap._null import NO_SUCH_RIG, SPARE, NuisancePrior, machine
from cyclofeat.gap._recordings import registered
from cyclofeat.gap._summaries import summarise_all
from cyclofeat.simulators import CompositeSimulator, Effect, MachineRun, SimulationFailed
from cyclofeat.simulators.effects import EffectParameter, LogUniform, Uniform

Float = NDArray[np.float64]
# What a worker needs of a run, in the order of :func:`cyclofeat.gap._null.machine`, and what it gives back of
# a recording: torque in Nm, and the input angle in rad at both ends.
_Task = tuple[CompositeSimulator, NuisancePrior, int, int, float, np.random.SeedSequence]
_Record = tuple[NDArray[np.float32], tuple[float, float]]

PER_STEP = 4  # simulated recordings behind one evaluation
_BEYOND_PRIOR = 1.0  # how far beyond the prior's ends is searched, in its own width on a fitter's scale
AT_BOUND = 0.01  # share of the searched range


def as_effects(effect: Effect | Sequence[Effect]) -> tuple[Effect, ...]:
    """One effect or several, as several."""
    return (effect,) if isinstance(effect, Effect) else tuple(effect)


@dataclass
class FitModel:
    """Mean summaries of simulated recordings as a function of the effects' parameters."""

    composite: CompositeSimulator
    nuisance: NuisancePrior
    effects: tuple[Effect, ...]
    counts: NDArray[np.int64]
    by_count: bool
    n_samples: int
    sampling_rate: float
    input_speed_hz: float
    n_lobes: int
    by_tachometer: bool
    random_state: int
    n_jobs: int
    n_calls: int = 0
    n_asked: int = 0
    n_failed: int = 0
    _runs: dict[bytes, list[MachineRun | None]] = field(default_factory=dict, repr=False)

    def mean(self, place: Float) -> Float:
        """Mean over the recordings behind one evaluation, NaN if none could be simulated."""
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
        """Less the mean of each count, or less the mean of all where counts are not known."""
        counts = self.counts[: len(values)]
        return less_means(values, counts if self.by_count else 0 * counts)

    def _values(self, place: Float, n: int) -> Float:
        in_machine, on_torque = self._parted(place)
        runs = [run for run in self._machines(in_machine, n) if run is not None]
        if not runs:
            return np.empty((0, 0))
        try:
            return self._summarised([_as_recorded(run, on_torque) for run in runs])
        except NO_SUCH_RIG:
            self.n_failed += len(runs)
            return np.empty((0, 0))

    def scattered(
        self, places: Float, known: NDArray[np.int64] | None, first: int
    ) -> tuple[Float, NDArray[np.bool_], NDArray[np.int64]]:
        """One recording at each place: summaries of those that succeed, which these are, and their counts."""
        counts = matched_counts(known, self.nuisance, len(places))
        parted = [self._parted(place) for place in places]
        records = joblib.Parallel(n_jobs=self.n_jobs)(
            joblib.delayed(_recorded)(
                on_torque, *self._task(self._with(in_machine), first + k, int(counts[k]))
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
        """Effects that the gearbox answers, and those on the torque alone."""
        effects = FitSpace(self.effects).effects(place)
        return (
            tuple(effect for effect in effects if effect.needs_simulation()),
            tuple(effect for effect in effects if not effect.needs_simulation()),
        )

    def _with(self, effects: tuple[Effect, ...]) -> CompositeSimulator:
        return CompositeSimulator(self.composite.base, (*self.composite.effects, *effects))

    def _summarised(self, records: list[_Record]) -> Float:
        X = np.array([torque for torque, _ in records])
        angles = np.array([ends for _, ends in records])
        X = registered(X, self.sampling_rate, self.input_speed_hz, self.n_lobes)
        speeds = None
        if self.by_tachometer:
            turned = (angles[:, 1] - angles[:, 0]) / (2 * np.pi)
            speeds = turned / (self.n_samples - 1) * self.sampling_rate
        return summarise_all(X, self.sampling_rate, self.input_speed_hz, self.n_lobes, speeds)[0]

    def _machines(self, effects: tuple[Effect, ...], n: int) -> list[MachineRun | None]:
        """The first n runs of the machine with these effects, each made once."""
        key = repr([effect.to_dict() for effect in effects]).encode()
        if effects:
            # Parameters left behind are not asked for again: one set of runs is kept.
            self._runs = {key: self._runs[key]} if key in self._runs else {}
        runs = self._runs.setdefault(key, [])
        simulator, missing = self._with(effects), range(len(runs), n)
        made = joblib.Parallel(n_jobs=self.n_jobs)(
            joblib.delayed(_machine_run)(*self._task(simulator, i, int(self.counts[i % len(self.counts)])))
            for i in missing
        )
        self.n_calls += len(missing)
        self.n_failed += sum(run is None for run in made)
        runs += made
        return runs[:n]

    def _task(self, simulator: CompositeSimulator, i: int, count: int) -> _Task:
        seed = np.random.SeedSequence([self.random_state, 1], spawn_key=(i,))
        return simulator, self.nuisance, count, self.n_samples, self.sampling_rate, seed


# Functions of the module and no methods: with a method, a worker would be sent all runs that the model keeps.


def _machine_run(*task: *_Task) -> MachineRun | None:
    """A run of the machine, or None where it cannot be simulated."""
    try:
        return machine(*task, spare=SPARE)
    except NO_SUCH_RIG:
        return None


def _recorded(on_torque: tuple[Effect, ...], *task: *_Task) -> _Record | None:
    """A run and its recording at once."""
    run = _machine_run(*task)
    try:
        return None if run is None else _as_recorded(run, on_torque)
    except NO_SUCH_RIG:
        return None


def _as_recorded(run: MachineRun, on_torque: tuple[Effect, ...]) -> _Record:
    record = run.record(on_torque)
    angle = record.input_angle
    return record.torque_out.astype(np.float32), (float(angle[0]), float(angle[-1]))


class FitSpace:
    """The fitted parameters of several effects as one vector, within bounds."""

    def __init__(self, effects: Sequence[Effect]) -> None:
        self._effects = tuple(effects)
        self.names = [f"{e.effect_id}.{name}" for e in effects for name in e.vector_names()]
        if len(set(self.names)) < len(self.names):
            raise ValueError(f"effect must name each effect once, got {', '.join(self.names)}")
        self._parameters: list[EffectParameter] = [
            e.parameters[name] for e in effects for name in e.vector_names()
        ]
        ends = np.array([_prior_ends(parameter) for parameter in self._parameters])
        self.widths = ends[:, 1] - ends[:, 0]
        bounds = [e.vector_bounds() for e in effects]
        lowest, highest = (np.concatenate([bound[k] for bound in bounds]) for k in range(2))
        beyond = _BEYOND_PRIOR * self.widths
        self.low = np.maximum(ends[:, 0] - beyond, lowest)
        self.high = np.minimum(ends[:, 1] + beyond, highest)

    @property
    def given(self) -> Float:
        """The effects as they were given, moved off the bounds."""
        values = []
        for effect in self._effects:
            try:
                values.append(effect.to_vector())
            except ValueError:  # neutral in a logarithm: the middle of the prior instead
                values.append(np.full(len(effect.vector_names()), np.nan))
        middle = (self.low + self.high) / 2
        given = np.concatenate(values)
        return self.inside(np.where(np.isfinite(given), given, middle))

    def from_prior(self, random: np.random.Generator) -> Float:
        """A place drawn from the priors."""
        drawn = [effect.draw_parameters(random).to_vector() for effect in self._effects]
        return self.inside(np.concatenate(drawn))

    def inside(self, place: Float) -> Float:
        """Moved off the bounds by a hundredth of the range, as a search has to start."""
        margin = 1.1 * AT_BOUND * (self.high - self.low)
        return np.clip(place, self.low + margin, self.high - margin)

    def clipped(self, place: Float) -> Float:
        return np.clip(place, self.low, self.high)

    def effects(self, place: Float) -> tuple[Effect, ...]:
        found, start = [], 0
        for effect in self._effects:
            size = len(effect.vector_names())
            found.append(effect.from_vector(place[start : start + size]))
            start += size
        return tuple(found)

    def natural(self, place: Float) -> Float:
        """The parameters in their units."""
        return np.array(
            [getattr(e, name) for e in self.effects(place) for name in e.vector_names()], dtype=float
        )


def less_means(values: Float, counts: NDArray[Any]) -> Float:
    """Values less the mean of their count, scaled up for what the mean takes out of few of them."""
    left = np.zeros_like(values)
    for count in np.unique(counts):
        own = values[counts == count]
        left[counts == count] = (own - own.mean(axis=0)) * math.sqrt(len(own) / max(len(own) - 1, 1))
    return left


def matched_counts(counts: NDArray[np.int64] | None, nuisance: NuisancePrior, n: int) -> NDArray[np.int64]:
    """Counts of n simulated recordings, of which every beginning has those measured in about their shares."""
    known = np.sort(np.array(nuisance.defect_counts) if counts is None else counts)
    # Shifted so that the first four are the middles of the quarters.
    shares = (qmc.Halton(1, scramble=False).random(n)[:, 0] + 0.5 / PER_STEP) % 1
    return np.asarray(known[(shares * len(known)).astype(int)])


def _prior_ends(parameter: EffectParameter) -> tuple[float, float]:
    """Where nearly all of a prior lies, on a fitter's scale."""
    prior = parameter.prior
    assert prior is not None
    low, high = (prior.quantile(share) for share in (0.01, 0.99))
    if isinstance(prior, (Uniform, LogUniform)):
        low, high = prior.low, prior.high
    return (math.log(low), math.log(high)) if parameter.log else (low, high)
