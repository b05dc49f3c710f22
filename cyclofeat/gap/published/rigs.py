"""Simulated rigs with sets of effects, and their statistics."""

from __future__ import annotations

import dataclasses
import itertools
import os
import warnings
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import joblib
import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc
from sklearn.exceptions import ConvergenceWarning
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

from cyclofeat._base import checks
from cyclofeat._base.files import write_whole
from cyclofeat.gap.comparison import Comparison
from cyclofeat.gap.published.scores import to_statistics
from cyclofeat.gap.simulations import NO_SUCH_RIG, Population
from cyclofeat.signal.density import shannon_entropy
from cyclofeat.signal.welch import welch_psd
from cyclofeat.simulators import Effect, Rig, known_effects

Float = NDArray[np.float64]
Set = tuple[str, ...]

SET_POINT = "load_scale"
_REPLICATES = 2


@dataclass(frozen=True)
class PublishedSettings:
    """Settings of :func:`find_published_gap`.

    Attributes
    ----------
    library : sequence of str or None
        Effects that are considered, of ``known_effects(proposed=True)``
        (:func:`cyclofeat.simulators.known_effects`) and ``"load_scale"``. None: all but ``"clock_error"``,
        which does not change these statistics.
    max_effects : int
    duration : float
        Length of the records in s. *Assumption* where the source does not state it.
    n_draws : int
        Simulated rigs per effect of one parameter; with p parameters p^2 times as many.
    alpha : float
        One-sided sign-flip p over discs left out up to which an effect is added.
    table : path or None
        File of simulated statistics that :meth:`PublishedGap.save_table` wrote for the same comparison and
        settings. Sets of effects that it does not hold are simulated.
    """

    library: Sequence[str] | None = None
    max_effects: int = 3
    duration: float = 1.8
    n_draws: int = 6
    alpha: float = 0.05
    table: str | os.PathLike[str] | None = None

    def __post_init__(self) -> None:
        checks.whole("max_effects", self.max_effects, 1)
        checks.positive("duration", self.duration, "a number of s")
        checks.whole("n_draws", self.n_draws, 1)
        if not 0 < checks.number("alpha", self.alpha) < 1:
            raise ValueError(f"alpha must be between 0 and 1, got {self.alpha!r}")


@dataclass(frozen=True)
class RigTable:
    """Statistics of simulated rigs: each row of theta is one rig, recorded ``_REPLICATES`` times per disc.

    ``theta`` (n, n_parameters); ``values`` (n, replicates, n_counts, 4) as :func:`to_statistics` gives them.
    """

    theta: Float
    values: Float


class SimulatedRigs:
    """Rigs with sets of effects; each set is simulated once, for discs with given counts of worn lobes."""

    def __init__(
        self, comparison: Comparison, counts: NDArray[np.int64], settings: PublishedSettings
    ) -> None:
        self.comparison, self.counts, self.n_draws = comparison, counts, settings.n_draws
        n_samples = round(settings.duration * comparison.sampling_rate)
        self.population: Population = dataclasses.replace(comparison.population, n_samples=n_samples)
        self.random_state = comparison.random_state
        self.set_point = float(self.population.rig.gearbox.load_torque)
        self.n_simulated = self.n_failed = 0
        self.tables: dict[Set, RigTable] = {}
        self.entropy: dict[Set, Float] = {}
        self.stated = repr(
            (counts.tolist(), n_samples, comparison.sampling_rate, self.n_draws, self.random_state)
        )
        if settings.table is not None:
            self._read_rigs(Path(settings.table))

    def table(self, key: Set) -> RigTable:
        if key not in self.tables:
            values = self._each_torque(key, _statistics_of)
            self.tables[key] = RigTable(self.thetas(key), to_statistics(values, self.set_point))
        return self.tables[key]

    def entropies(self, key: Set) -> Float:
        """Shannon entropies in bits, (n_rigs, replicates, n_counts)."""
        if key not in self.entropy:
            rate = self.comparison.sampling_rate

            def shannon_bits(torque: Float) -> Float:
                frequencies, psd = welch_psd(torque[np.newaxis], rate, "matlab_pwelch")
                return np.asarray(shannon_entropy(psd, frequencies))

            self.entropy[key] = self._each_torque(key, shannon_bits)[..., 0]
        return self.entropy[key]

    def parameter_names(self, key: Set) -> list[tuple[str, str]]:
        """Effect and name of each parameter of a set."""
        return [(name, parameter) for name in key for parameter in _parameter_names(name)]

    def bounds(self, key: Set) -> list[tuple[float, float, bool]]:
        """Return the smallest and largest value of each parameter in the table, and True for a log scale."""
        theta = self.table(key).theta
        kinds = [kind_of(name).parameters[p] for name in key for p in _parameter_names(name)]
        return [
            (float(column.min()), float(column.max()), kind.log)
            for column, kind in zip(theta.T, kinds, strict=True)
        ]

    def effects(self, key: Set, theta: Float) -> tuple[Effect, ...]:
        """Effects of a set with one row of parameters."""
        effects, at = [], 0
        for name in key:
            names = _parameter_names(name)
            values = dict(zip(names, theta[at : at + len(names)].tolist(), strict=True))
            effects.append(kind_of(name).with_parameters(**values))
            at += len(names)
        return tuple(effects)

    def rig(self, effects: Iterable[Effect]) -> Rig:
        """The model with effects."""
        return self.population.rig.with_added(*effects)

    def n_rigs(self, key: Set) -> int:
        """Number of rigs of a set; larger for effects on the torque, which need no simulation."""
        if simulated_ones(key) == key:
            return self._n_gear(key)
        n_parameters = sum(len(_parameter_names(name)) for name in key)
        return max(self._n_gear(simulated_ones(key)), min(16 * self.n_draws, 5 * self.n_draws * n_parameters))

    def thetas(self, key: Set) -> Float:
        """Latin hypercube over the priors of each effect, shape (n_rigs, n_parameters)."""
        n = self.n_rigs(key)
        columns: list[Float] = []
        for name in key:
            if not kind_of(name).needs_simulation():
                columns += self._latin_hypercube(name, n)
                continue
            gear = simulated_ones(key)
            _, rows = self._gear_records(gear)
            columns += [
                np.resize(column[rows], n) for column in self._latin_hypercube(name, self._n_gear(gear))
            ]
        return np.column_stack(columns) if columns else np.zeros((n, 0))

    def _latin_hypercube(self, name: str, n: int) -> list[Float]:
        kind, names = kind_of(name), _parameter_names(name)
        if not names:
            return []
        seed = np.random.default_rng([self.random_state, *name.encode(), n])
        shares = qmc.LatinHypercube(len(names), seed=seed).random(n)
        columns = []
        for k, parameter in enumerate(names):
            what = kind.parameters[parameter]
            assert what.prior is not None
            columns.append(np.array([what.draw(what.prior, float(share)) for share in shares[:, k]]))
        return columns

    def _n_gear(self, gear: Set) -> int:
        """Return the number of rigs whose gearbox is simulated."""
        n_parameters = sum(len(_parameter_names(name)) for name in gear)
        if len(gear) > 1:
            return 3 * self.n_draws
        return self.n_draws * (max(n_parameters, 1) ** 2 if gear else 3)

    def _each_torque(self, key: Set, work: Callable[[Float], Float]) -> Float:
        """Result of ``work`` on each record, shape (n_rigs, replicates, n_counts, ...)."""
        records, _ = self._gear_records(simulated_ones(key))
        theta = self.thetas(key)
        chain = [name for name in key if not kind_of(name).needs_simulation()]
        results = []
        for rig in range(len(theta)):
            effects = [e for e in self.effects(key, theta[rig]) if e.effect_id in chain]
            effects.sort(key=lambda effect: effect.place)
            for replicate, k in itertools.product(range(_REPLICATES), range(len(self.counts))):
                torque = records[rig % len(records), replicate, k].astype(np.float64)
                for effect in effects:
                    seed = np.random.SeedSequence(
                        [self.random_state, *effect.effect_id.encode()], spawn_key=(rig, replicate, k)
                    )
                    random = np.random.default_rng(seed)
                    torque = effect.change_torque(torque, self.comparison.sampling_rate, random)
                results.append(work(torque))
        return np.array(results).reshape(len(theta), _REPLICATES, len(self.counts), -1)

    def _gear_records(self, gear: Set) -> tuple[NDArray[np.float32], NDArray[np.intp]]:
        """Return the torque of rigs, (n_gear, replicates, n_counts, n_samples), and their indices.

        A rig with a record that cannot be simulated is replaced; such records are counted.
        """
        return self.comparison.remember(
            lambda: self._simulate_gear(gear), "published records", self.population.text, self.stated, gear
        )

    def _simulate_gear(self, gear: Set) -> tuple[NDArray[np.float32], NDArray[np.intp]]:
        n = self._n_gear(gear)
        columns = [column for name in gear for column in self._latin_hypercube(name, n)]
        theta = np.column_stack(columns) if columns else np.zeros((n, 0))
        jobs = list(itertools.product(range(n), range(_REPLICATES), range(len(self.counts))))
        populations = [
            dataclasses.replace(self.population, rig=self.rig(self.effects(gear, row))) for row in theta
        ]
        torques = joblib.Parallel(n_jobs=self.comparison.n_jobs)(
            joblib.delayed(_simulate_torque)(
                populations[job[0]],
                int(self.counts[job[2]]),
                np.random.SeedSequence(self.random_state, spawn_key=job),
            )
            for job in jobs
        )
        shape = (n, _REPLICATES, len(self.counts), self.population.n_samples)
        failed = np.array([torque is None for torque in torques]).reshape(shape[:3])
        self.n_simulated += len(torques)
        self.n_failed += int(failed.sum())
        good = np.flatnonzero(~failed.any(axis=(1, 2)))
        if good.size == 0:
            raise ValueError(f"library must hold effects that can be simulated: {' + '.join(gear)} cannot")
        rows = good[np.searchsorted(good, np.arange(n)).clip(max=good.size - 1)]
        nothing = np.zeros(shape[-1], np.float32)
        records = np.array([nothing if torque is None else torque for torque in torques]).reshape(shape)
        return (records if good.size == n else records[rows]), rows

    def save(self, path: Path) -> None:
        """Write all statistics simulated so far."""
        arrays: dict[str, Any] = {"stated": np.array(self.stated)}
        for key, table in self.tables.items():
            arrays["values:" + "+".join(key)] = table.values.astype(np.float16)
            arrays["theta:" + "+".join(key)] = table.theta.astype(np.float32)
        for key, entropy in self.entropy.items():
            arrays["entropy:" + "+".join(key)] = entropy.astype(np.float16)
        write_whole(path, lambda stream: np.savez_compressed(stream, **arrays))

    def _read_rigs(self, path: Path) -> None:
        with np.load(path) as stored:
            # The first record of the model alone is simulated again.
            seed = np.random.SeedSequence(self.random_state, spawn_key=(0, 0, 0))
            torque, same = _simulate_torque(self.population, int(self.counts[0]), seed), False
            if torque is not None and str(stored["stated"]) == self.stated:
                first = to_statistics(_statistics_of(torque.astype(np.float64)), self.set_point)
                same = np.allclose(first, stored["values:"][0, 0, 0].astype(np.float64), rtol=2e-3, atol=1e-3)
            if not same:
                raise ValueError(
                    f"table {path} was made with another comparison, discs, duration or n_draws: leave it "
                    "out, or give the same"
                )
            for name in stored.files:
                kind, _, joined = name.partition(":")
                key = tuple(joined.split("+")) if joined else ()
                n = self.n_rigs(key)
                if kind == "values":
                    theta = stored["theta:" + joined][:n].astype(np.float64)
                    self.tables[key] = RigTable(theta, stored[name][:n].astype(np.float64))
                elif kind == "entropy":
                    self.entropy[key] = stored[name][:n].astype(np.float64)


def kind_of(name: str) -> Effect:
    return known_effects()[name]


def _parameter_names(name: str) -> list[str]:
    return kind_of(name).vector_names()


def simulated_ones(key: Iterable[str]) -> Set:
    """Return the effects that change the motion of the gearbox and must be simulated."""
    return tuple(name for name in key if kind_of(name).needs_simulation())


def _simulate_torque(
    population: Population, count: int, seed: np.random.SeedSequence
) -> NDArray[np.float32] | None:
    """Torque of one record, or None if it cannot be simulated."""
    try:
        return population.record(count, seed).torque
    except NO_SUCH_RIG:
        return None


def _statistics_of(torque: Float) -> Float:
    return np.array([torque.min(), torque.max(), torque.mean(), torque.std()])


_DENSE = 512  # interpolated rigs, a power of two


_NEAR = 4  # simulated rigs from which the noise of an interpolated rig is taken


@dataclass(frozen=True)
class DenseRigs:
    """Many rigs interpolated between the simulated ones.

    ``theta`` (n, n_parameters); ``middle`` (n, n_counts, 4) the expected statistics; ``noise`` (n, m, 4) the
    deviations of single records of nearby rigs; ``nearest`` (n, k) those rigs; ``log_weight`` (n, n_discs).
    """

    theta: Float
    middle: Float
    noise: Float
    nearest: NDArray[np.intp]
    log_weight: Float


def interpolate_rigs(table: RigTable, bounds: Sequence[tuple[float, float, bool]], seed: int) -> DenseRigs:
    """Statistics between the simulated rigs, by a Gaussian process over their parameters.

    The process is fitted to means over the replicates; all statistics and counts share its length scales.
    The noise is the residual of the records of the nearest rigs.
    """
    values = table.values
    n, n_replicates, n_counts, n_statistics = values.shape
    none = np.zeros((0, 0))
    if table.theta.shape[1] == 0:
        middle = values.mean(axis=(0, 1))[np.newaxis]
        noise = (values - middle).reshape(1, -1, n_statistics)
        return DenseRigs(np.zeros((1, 0)), middle, noise, np.arange(n)[np.newaxis], none)

    def place(theta: Float) -> Float:
        columns = []
        for column, (low, high, log) in zip(theta.T, bounds, strict=True):
            ends = (np.log(low), np.log(high)) if log else (low, high)
            columns.append(((np.log(column) if log else column) - ends[0]) / (ends[1] - ends[0]))
        return np.column_stack(columns)

    at = place(table.theta)
    means = values.mean(axis=1).reshape(n, -1)
    spread = np.maximum(means.std(axis=0), 1e-9)
    scaled = (means - means.mean(axis=0)) / spread
    kernel = ConstantKernel(1.0, (0.1, 100.0)) * RBF(np.full(at.shape[1], 0.5), (0.05, 20.0))
    process = GaussianProcessRegressor(kernel + WhiteKernel(0.1, (1e-4, 2.0)))
    with warnings.catch_warnings():
        # A length scale at its upper bound belongs to a parameter without influence.
        warnings.simplefilter("ignore", ConvergenceWarning)
        process.fit(at, scaled)

    def expected_values(places: Float) -> Float:
        predicted = np.asarray(process.predict(places)) * spread + means.mean(axis=0)
        return np.asarray(predicted.reshape(len(places), n_counts, n_statistics))

    left = (values - expected_values(at)[:, np.newaxis]).reshape(n, n_replicates * n_counts, n_statistics)
    # Within the simulated values: nothing is extrapolated.
    low, high = at.min(axis=0), at.max(axis=0)
    shares = qmc.Sobol(at.shape[1], seed=seed).random(_DENSE)
    places = low + (high - low) * shares
    nearest = np.argsort(((places[:, np.newaxis] - at) ** 2).sum(axis=-1), axis=1)[:, :_NEAR]
    theta = np.column_stack(
        [
            np.exp(np.log(a) + (np.log(b) - np.log(a)) * x) if log else a + (b - a) * x
            for x, (a, b, log) in zip(places.T, bounds, strict=True)
        ]
    )
    return DenseRigs(
        theta, expected_values(places), left[nearest].reshape(_DENSE, -1, n_statistics), nearest, none
    )
