"""The gap in published statistics: one row of numbers per disc, without recordings."""

from __future__ import annotations

import dataclasses
import functools
import itertools
import os
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
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
from cyclofeat.gap.engine.problem import Effect, Parameter, Rig, Session
from cyclofeat.gap.engine.search import Explanation, explain
from cyclofeat.gap.simulations import NO_SUCH_RIG, Population, remember
from cyclofeat.simulators import Effect as SimulatedEffect
from cyclofeat.simulators import EffectParameter, known_effects
from cyclofeat.simulators.effects.library import look_alikes

Float = NDArray[np.float64]
Names = tuple[str, ...]

SET_POINT = "load_scale"
# Effects that show as an error of the time axis do not change minimum, maximum, mean or deviation.
_UNSEEN = "time axis"
_REPLICATES = 2


class PublishedTable:
    """Statistics of discs on simulated rigs with sets of effects, interpolated between the rigs of each set.

    The cells are :func:`to_statistics`; differences matter from their measured spread over the discs, (4,). A
    condition is the position of a disc in `counts`. Effects with the same statistics are one, named after all
    of them; one effect at most changes the gearbox's motion, because each set of those needs simulations.
    """

    blocks = np.arange(4)

    def __init__(
        self,
        comparison: Comparison,
        counts: NDArray[np.int64],
        floors: Float,
        *,
        duration: float = 1.8,
        n_draws: int = 6,
    ) -> None:
        self.comparison, self.counts, self.floors, self.n_draws = comparison, counts, floors, n_draws
        n_samples = round(duration * comparison.sampling_rate)
        self.population: Population = dataclasses.replace(comparison.population, n_samples=n_samples)
        self.set_point = float(self.population.rig.gearbox.load_torque)
        self.effects: Mapping[str, Effect] = published_effects()
        self.tables: dict[Names, tuple[Float, Float]] = {}
        self.stated = repr(
            (counts.tolist(), n_samples, comparison.sampling_rate, n_draws, comparison.random_state)
        )
        self._records: dict[Names, tuple[Float, NDArray[np.float32]]] = {}

    def simulate(self, conditions: Sequence[int], rigs: Sequence[Rig]) -> Float:
        """Return the expected statistics of the discs of each rig, (n_rigs, n_discs, 4)."""
        sets = [tuple(name for name in self.effects if name in rig) for rig in rigs]
        results = np.zeros((len(rigs), len(conditions), 4))
        for names in set(sets):
            at = [k for k, other in enumerate(sets) if other == names]
            theta = np.array([[x for name in names for x in rigs[k][name].values()] for k in at])
            key = tuple(name.split(" ")[0] for name in names)
            results[at] = self.interpolate(key)(theta)[:, list(conditions)]
        return results

    def table(self, key: Names) -> tuple[Float, Float]:
        """Return the parameters of simulated rigs, (n, n_parameters), and their statistics.

        The rigs are a Latin hypercube over the priors of each effect. Statistics have the shape
        (n, replicates, n_discs, 4): assemblies, first worn lobe, wheel, start and noise differ between discs.
        """
        if key not in self.tables:
            gear = tuple(name for name in key if known_effects()[name].needs_simulation())
            if gear not in self._records:
                self._records[gear] = remember(
                    self.comparison.cache, lambda: self._simulate_gear(gear),
                    "published records", self.population.text, self.stated, gear,
                )  # fmt: skip
            drawn, records = self._records[gear]
            # More rigs for effects on the torque, which need no simulation.
            n_parameters = sum(len(parameters_of(name)) for name in key)
            n = len(drawn)
            if gear != key:
                n = max(n, min(16 * self.n_draws, 5 * self.n_draws * n_parameters))
            columns = [
                np.resize(drawn, (n, drawn.shape[1])) if name in gear else self._latin_hypercube(name, n)
                for name in key
            ]
            values = np.zeros((n, *records.shape[1:3], 4))
            for rig in range(n):
                effects = [
                    make_effect(name, column[rig])
                    for name, column in zip(key, columns, strict=True)
                    if name not in gear
                ]
                effects.sort(key=lambda effect: effect.place)
                for place in np.ndindex(values.shape[1:3]):
                    torque = records[(rig % len(records), *place)].astype(np.float64)
                    for effect in effects:
                        seed = [self.comparison.random_state, *effect.effect_id.encode()]
                        random = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(rig, *place)))
                        torque = effect.change_torque(torque, self.comparison.sampling_rate, random)
                    values[(rig, *place)] = self._statistics_of(torque)
            self.tables[key] = np.concatenate([np.zeros((n, 0)), *columns], axis=1), values
        return self.tables[key]

    def _statistics_of(self, torque: NDArray[Any]) -> Float:
        values = torque.astype(np.float64)
        extremes = np.array([values.min(), values.max(), values.mean(), values.std()])
        return to_statistics(extremes, self.set_point)

    def _latin_hypercube(self, name: str, n: int) -> Float:
        """Return parameters of n rigs with an effect, (n, n_parameters)."""
        priors = list(parameters_of(name).values())
        seed = np.random.default_rng([self.comparison.random_state, *name.encode(), n])
        shares = qmc.LatinHypercube(len(priors), seed=seed).random(n)
        drawn = [[p.draw(p.prior, float(x)) for p, x in zip(priors, row, strict=True)] for row in shares]
        return np.array(drawn)

    def _simulate_gear(self, gear: Names) -> tuple[Float, NDArray[np.float32]]:
        """Return parameters of rigs that can be simulated, and torque (n, replicates, n_discs, n_samples)."""
        drawn = np.zeros((3 * self.n_draws, 0))
        for name in gear:
            drawn = self._latin_hypercube(name, self.n_draws * len(parameters_of(name)) ** 2)
        rig = self.population.rig
        populations = [
            dataclasses.replace(
                self.population, rig=rig.with_added(*(make_effect(name, row) for name in gear))
            )
            for row in drawn
        ]
        jobs = list(itertools.product(range(len(drawn)), range(_REPLICATES), range(len(self.counts))))
        torques = joblib.Parallel(n_jobs=self.comparison.n_jobs)(
            joblib.delayed(_simulate_torque)(
                populations[job[0]],
                int(self.counts[job[2]]),
                np.random.SeedSequence(self.comparison.random_state, spawn_key=job),
            )
            for job in jobs
        )
        failed = {job[0] for job, torque in zip(jobs, torques, strict=True) if torque is None}
        good = np.array([k for k in range(len(drawn)) if k not in failed], dtype=np.int64)
        if good.size == 0:
            raise ValueError(f"comparison must be of a rig that can be simulated with {' + '.join(gear)}")
        rows = good[np.searchsorted(good, np.arange(len(drawn))).clip(max=good.size - 1)]
        size = _REPLICATES * len(self.counts)
        records = [torques[row * size : (row + 1) * size] for row in rows]
        shape = len(drawn), _REPLICATES, len(self.counts), self.population.n_samples
        return drawn[rows], np.array(records, dtype=np.float32).reshape(shape)

    @functools.cache  # noqa: B019  (a table lives as long as its answer)
    def interpolate(self, key: Names) -> Callable[[Float], Float]:
        """Return a function from parameters of rigs, (n, n_parameters), to statistics, (n, n_discs, 4).

        A Gaussian process over the parameters is fitted to the means over the replicates of each statistic;
        the discs share its length scales and its noise. Nothing is extrapolated.
        """
        theta, values = self.table(key)
        means = values.mean(axis=1)
        middle, spread = means.mean(axis=0), np.maximum(means.std(axis=0), 1e-9)
        logarithm = [parameter.log for name in key for parameter in parameters_of(name).values()]
        low, high = theta.min(axis=0), theta.max(axis=0)

        def places(rigs: Float) -> Float:
            ends = np.clip(rigs, low, high), low, high
            point, first, last = (np.where(logarithm, np.log(np.where(logarithm, x, 1)), x) for x in ends)
            return np.asarray((point - first) / (last - first))

        processes = []
        for scaled in np.moveaxis((means - middle) / spread, -1, 0) if key else ():
            kernel = ConstantKernel(1.0, (0.1, 100.0)) * RBF(np.full(theta.shape[1], 0.5), (0.05, 20.0))
            processes.append(GaussianProcessRegressor(kernel + WhiteKernel(0.1, (1e-4, 2.0))))
            with warnings.catch_warnings():
                # A length scale at its upper bound belongs to a parameter without influence.
                warnings.simplefilter("ignore", ConvergenceWarning)
                processes[-1].fit(places(theta), scaled)

        def expected_statistics(rigs: Float) -> Float:
            if not key:
                return np.broadcast_to(middle, (len(rigs), *middle.shape))
            scaled = [process.predict(places(rigs)) for process in processes]
            return np.asarray(np.stack(scaled, axis=-1).reshape(-1, *middle.shape) * spread + middle)

        return expected_statistics

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the simulated statistics, in half precision, as `table` of :func:`find_published_gap`."""
        arrays: dict[str, Any] = {"stated": np.array(self.stated)}
        for key, (theta, values) in self.tables.items():
            arrays["theta:" + "+".join(key)] = theta.astype(np.float32)
            arrays["values:" + "+".join(key)] = values.astype(np.float16)
        write_whole(Path(path), lambda stream: np.savez_compressed(stream, **arrays))

    def read(self, path: str | os.PathLike[str]) -> None:
        """Read statistics that :meth:`save` wrote for the same comparison, discs and settings."""
        with np.load(path) as stored:
            # The first record of the model alone is simulated again.
            seed = np.random.SeedSequence(self.comparison.random_state, spawn_key=(0, 0, 0))
            torque, same = _simulate_torque(self.population, int(self.counts[0]), seed), False
            if torque is not None and str(stored["stated"]) == self.stated:
                first = stored["values:"][0, 0, 0].astype(np.float64)
                same = np.allclose(self._statistics_of(torque), first, rtol=2e-3, atol=1e-3)
            if not same:
                raise ValueError(
                    f"table {path} was made with another comparison, discs, duration or n_draws: leave it "
                    "out, or give the same"
                )
            for name in stored.files:
                kind, _, joined = name.partition(":")
                if kind == "values":
                    theta, values = (
                        stored[part + joined].astype(np.float64) for part in ("theta:", "values:")
                    )
                    self.tables[tuple(joined.split("+")) if joined else ()] = theta, values


def parameters_of(name: str) -> dict[str, EffectParameter]:
    """Return the fitted parameters of an effect."""
    kind = known_effects()[name]
    return {key: kind.parameters[key] for key in kind.vector_names()}


def make_effect(name: str, values: Iterable[float]) -> SimulatedEffect:
    """Return an effect with fitted parameters."""
    return known_effects()[name].with_parameters(
        **dict(zip(parameters_of(name), map(float, values), strict=True))
    )


def published_effects() -> dict[str, Effect]:
    """Return the effects that change the statistics, with priors from their 1 % to their 99 % quantiles."""
    proposed = [name for name, kind in known_effects(proposed=True).items() if kind.shows_as != _UNSEEN]
    groups = {}
    for name in proposed:
        alike = next((set(group) for group in look_alikes() if name in group), {name})
        same = [other for other in proposed if other in alike]
        if name == same[-1]:  # the one that needs no simulation
            groups[name] = " or ".join([name, *same[:-1], *({SET_POINT} & alike)])
    gear = {groups[name] for name in groups if known_effects()[name].needs_simulation()}
    effects = {}
    for name, title in groups.items():
        priors = {}
        for key, parameter in parameters_of(name).items():
            assert parameter.prior is not None
            low, high = (float(parameter.prior.ppf(share)) for share in (0.01, 0.99))
            priors[key] = Parameter(parameter.unit, low, high, parameter.log)
        effects[title] = Effect(priors, excludes=tuple(gear - {title}) if title in gear else ())
    return effects


def _simulate_torque(
    population: Population, count: int, seed: np.random.SeedSequence
) -> NDArray[np.float32] | None:
    """Torque of one record, or None if it cannot be simulated."""
    try:
        return population.record(count, seed).torque
    except NO_SUCH_RIG:
        return None


def to_statistics(values: Float, set_point: float) -> Float:
    """Return the four statistics by which discs are compared, from minimum, maximum, mean and std, (..., 4).

    Mean minus set-point in Nm, and the natural logarithms of std, maximum minus mean, and mean minus minimum.
    """
    low, high, middle, spread = np.moveaxis(values, -1, 0)
    sizes = [np.log(np.maximum(x, 1e-9)) for x in (spread, high - middle, middle - low)]
    return np.stack([middle - set_point, *sizes], axis=-1)


def published_session(
    comparison: Comparison,
    statistics: Any,
    *,
    duration: float = 1.8,
    n_draws: int = 6,
    table: str | os.PathLike[str] | None = None,
) -> Session:
    """Return the discs of a checked table; see :func:`find_published_gap` for the arguments."""
    checks.positive("duration", duration, "a number of s")
    checks.whole("n_draws", n_draws, 1)
    wanted = ("defect_count", "min_nm", "max_nm", "mean_nm", "std_nm")
    try:
        values = np.array([np.asarray(statistics[name], dtype=np.float64) for name in wanted])
    except (KeyError, IndexError, TypeError, ValueError) as error:
        raise ValueError(
            f"statistics must be a table with the columns {', '.join(wanted)}: {error}"
        ) from None
    if values.ndim != 2 or values.shape[1] < 3:
        raise ValueError(f"statistics must have at least 3 rows, one per disc, got {values.shape[1:]}")
    counts, minimum, maximum, mean, std = values
    if not np.isfinite(values).all():
        raise ValueError("statistics must hold finite numbers, got NaN or infinity")
    if (counts != counts.round()).any() or counts.min() < 0:
        raise ValueError(f"defect_count must hold whole numbers from 0, got {counts.tolist()}")
    if not ((minimum < mean) & (mean < maximum) & (std > 0)).all():
        raise ValueError("statistics must have min_nm < mean_nm < max_nm and std_nm above 0 in every row")
    try:
        stated = np.asarray(statistics["range_nm"], dtype=np.float64)
    except (KeyError, IndexError, ValueError):
        stated = maximum - minimum
    # Printed numbers are rounded to four digits each.
    if (np.abs(stated - (maximum - minimum)) > 0.02).any():
        raise ValueError("range_nm must be max_nm minus min_nm")
    set_point = float(comparison.population.rig.gearbox.load_torque)
    measured = to_statistics(values[1:].T, set_point)
    floors = measured.std(axis=0, ddof=1)
    if (floors <= 0).any():
        raise ValueError("statistics must differ between discs: their spread is the scale")
    problem = PublishedTable(comparison, counts.astype(np.int64), floors, duration=duration, n_draws=n_draws)
    if table is not None:
        problem.read(table)
    return Session(problem, range(len(counts)), measured, random_state=comparison.random_state)


def find_published_gap(
    comparison: Comparison,
    statistics: Any,
    *,
    duration: float = 1.8,
    n_draws: int = 6,
    table: str | os.PathLike[str] | None = None,
) -> Explanation:
    """Find why published statistics of torque differ from the simulator's, without recordings.

    An effect is named if discs left out of the fit are predicted better with it, by Student's t of their
    gains.

    Parameters
    ----------
    comparison : Comparison
        Model, what may differ between discs, and sampling rate of the records.
    statistics : structured array, mapping or data frame
        Columns ``defect_count``, ``min_nm``, ``max_nm``, ``mean_nm`` and ``std_nm``, one row per disc, at
        least 3 of them; a ``range_nm`` is checked against ``max_nm`` minus ``min_nm``.
    duration : float, default=1.8
        Length of the records in s. *Assumption* where the source does not state it.
    n_draws : int, default=6
        Simulated rigs per effect of one parameter; with p parameters p^2 times as many.
    table : path, optional
        File of simulated statistics that :meth:`~cyclofeat.gap.cases.published_table.PublishedTable.save`
        wrote. Sets of effects that it does not hold are simulated.

    Returns
    -------
    Explanation
        Probabilities and sizes of the effects that change these statistics. Effects whose torque is the same
        to them are one, as ``"sensor_drift or load_drift"``.

    Raises
    ------
    ValueError
        If columns are missing or contradict each other, there are too few discs, or the table was made with
        other settings.

    Notes
    -----
    Compared are the mean minus the set-point, and the natural logarithms of standard deviation, largest
    excursion upward and downward, in units of their measured spread over the discs. A Gaussian process
    interpolates the expected statistics between simulated rigs, each with one set of parameters for all
    discs.

    Examples
    --------
    >>> from cyclofeat.datasets import load_published_tables
    >>> published = load_published_tables().signal_statistics
    >>> gap = find_published_gap(Comparison(sampling_rate=25_600), published)  # doctest: +SKIP
    >>> gap.state("sensor_drift or load_drift")  # doctest: +SKIP
    'missing'
    """
    return explain(published_session(comparison, statistics, duration=duration, n_draws=n_draws, table=table))
