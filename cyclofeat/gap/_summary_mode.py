"""The gap from published statistics alone: no recording, one row of numbers per disc."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from numbers import Integral, Real
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats
from sklearn.base import BaseEstimator
from sklearn.utils.validation import check_is_fitted

from cyclofeat._sklearn import Interval, fit_context
from cyclofeat.gap._names import different_names
from cyclofeat.gap._null import NuisancePrior
from cyclofeat.gap._summary_between import DenseRigs, interpolated
from cyclofeat.gap._summary_rigs import SET_POINT, Set, SimulatedRigs, kind_of, simulated_ones
from cyclofeat.gap._summary_scores import (
    STATISTICS,
    crps,
    fewest_units,
    sign_flip_p,
    student_samples,
    to_statistics,
)
from cyclofeat.simulators import CompositeSimulator, CycloidalGearbox, Effect, Rig, effect_library

Float = NDArray[np.float64]

# A clock that is off by parts in a thousand changes no minimum, maximum, mean or deviation.
_UNSEEN = ("clock_error",)
_TOLERANCE = 0.5  # spreads over the discs by which the score grows when a rig's weight falls to 1/e
_SAMPLES = 400

# Within a group the torque is the same to these statistics: the search goes on with the first member.
_SAME_TORQUE = (("sensor_drift", "load_drift"), ("offset", "gain", SET_POINT))


@dataclass(frozen=True)
class Discrepancy:
    """One statistic, measured against what the simulator alone gives.

    Attributes
    ----------
    statistic : str
    unit : str
    difference : float
        Mean over the discs of measured minus simulated; for sizes of the natural logarithm of their ratio.
    low, high : float
        95 % interval of that mean by Student's t over the discs.
    same_sign : int
        Discs whose difference has the sign of the mean.
    p : float
        Exact two-sided sign-flip p over the discs, never below 2 / 2^n.
    p_adjusted : float
        The same after Holm over the statistics.
    """

    statistic: str
    unit: str
    difference: float
    low: float
    high: float
    same_sign: int
    p: float
    p_adjusted: float


@dataclass(frozen=True)
class Step:
    """One effect that was named.

    Attributes
    ----------
    effect_id : str
    score_before, score_after : float
        Mean CRPS of discs left out, in spreads over the discs, without and with it.
    p : float
        One-sided sign-flip p over the discs of that improvement, of this candidate alone.
    look_alikes : tuple of str
        Candidates that would have done as well, as far as these discs can tell, after those whose torque is
        the same to these statistics by what they are (a drift of sensor or load; an offset, gain or
        set-point).
    next_measurement : str
        What would tell it from them.
    """

    effect_id: str
    score_before: float
    score_after: float
    p: float
    look_alikes: tuple[str, ...]
    next_measurement: str


@dataclass(frozen=True)
class HeldOut:
    """Prediction of one statistic of a disc that neither naming nor fitting has seen.

    Attributes
    ----------
    disc : int
        Count of worn lobes.
    effects : tuple of str
        Named without this disc.
    statistic : str
        One of ``STATISTICS``, ``"range"`` or ``"entropy"``.
    measured, predicted, low, high : float
        In Nm or bits; median and 80 % interval of the prediction.
    nothing : float
        The simulator alone.
    constant : float
        Mean of the other discs.
    """

    disc: int
    effects: Set
    statistic: str
    measured: float
    predicted: float
    low: float
    high: float
    nothing: float
    constant: float


class SummaryGap(BaseEstimator):
    """Where and why published statistics of torque differ from the simulator's: no recordings needed.

    Takes one row per disc: its count of worn lobes and minimum, maximum, mean and standard deviation of one
    record. It says which statistics disagree, names up to ``max_effects`` effects of the library, adds them
    to the simulator, and predicts discs that had no part in naming and fitting.

    Parameters
    ----------
    sampling_rate : float, default=25_600
        Of the records, in Hz.
    simulator : CompositeSimulator, Rig or CycloidalGearbox, optional
        The model. Default: paper B's gearbox.
    nuisance : NuisancePrior, optional
        What differs between discs without being a missing effect.
    library : sequence of str, optional
        Effects that are considered, of :func:`cyclofeat.simulators.effect_library`, and
        ``"brake_set_point"``. Default: all but ``"clock_error"``, which leaves these statistics as they are.
    max_effects : int, default=3
    max_simulated : int, default=1
        How many of them may be effects that the gearbox answers: each set of those needs simulations of its
        own, while effects of the meter go on top of records that are there.
    duration_s : float, default=1.8
        Length of the records. *Assumption* where the source does not state it.
    n_draws : int, default=6
        Simulated rigs per effect of one parameter; with p parameters p^2 times as many.
    alpha : float, default=0.05
        One-sided sign-flip p over discs left out up to which an effect is added.
    random_state : int, default=0
    n_jobs : int, default=1
        Worker processes of the simulations.
    table : path, optional
        File of simulated statistics that :meth:`save_table` wrote, with the same parameters. Sets of effects
        that it does not hold are simulated.
    cache : path, optional
        Folder in which simulated records are kept (some 20 to 100 MB per set of effects).

    Attributes
    ----------
    discrepancies_ : list of Discrepancy
        Where.
    ranking_ : list of (str, float)
        Single effects and the mean score of discs left out with each, best first; ``"nothing"`` and
        ``"constant"`` (mean of the other discs) among them.
    steps_ : list of Step
        The effects named, in the order in which they were added, with their look-alikes.
    rejected_ : list of (str, float, float)
        What the search would have added next: effect, score with it, and one-sided p of the improvement.
    dropped_ : tuple of str
        Effects that were added and taken out again.
    effects_ : tuple of Effect
        With the parameters of the rig that the discs speak most for.
    theta_, theta_ci_ : dict from "effect.parameter" to float and to (low, high)
        The same, and the weighted 5 % and 95 % quantiles over all rigs.
    simulator_ : CompositeSimulator
        The model with the effects.
    held_out_ : list of HeldOut
        Each disc predicted without it, the naming repeated without it.
    warnings_ : list of str
        That discs are too few to name an effect, or to do so without one of them.
    n_simulated_, n_failed_ : int
        Records simulated in this call of ``fit``, and those that could not be.

    Notes
    -----
    A simulated rig has one set of parameters for all its discs; assemblies, first worn lobe, wheel, start
    and noise differ between discs, with the same random numbers for all effects. Rigs of a set are a Latin
    hypercube over the priors; between them a Gaussian process gives the statistics that are expected of 512
    more, and the rigs nearby their noise. A rig's weight is exp(-sum over the discs fitted of the mean CRPS
    of the four statistics / half the measured spread over the discs): a generalised posterior (Bissiri et al.
    2016), in which a statistic that no effect reaches does not decide alone as it would in a likelihood. A
    disc left out is scored by the CRPS of the weighted prediction, each statistic divided by its measured
    spread over the discs.

    The p over n discs is never below 2^-n: at the default ``alpha``, of fewer than 5 discs no effect can be
    named, and ``held_out_`` takes one more (``warnings_``).

    The p of a step is that of the best of all candidates, hence optimistic; ``held_out_`` repeats the whole
    search without each disc and is not.

    Examples
    --------
    >>> from cyclofeat.datasets import load_published_tables
    >>> published = load_published_tables().signal_statistics
    >>> gap = SummaryGap(library=["offset"], n_draws=1, duration_s=0.1, max_effects=1)
    >>> gap = gap.fit(published)
    >>> [row.statistic for row in gap.discrepancies_ if row.same_sign == 8]
    ['mean', 'std', 'up', 'down', 'range']
    """

    _parameter_constraints: ClassVar[dict[str, list[Any]]] = {
        "sampling_rate": [Interval(Real, 0, None, closed="neither")],
        "simulator": [CompositeSimulator, Rig, CycloidalGearbox, None],
        "nuisance": [NuisancePrior, None],
        "library": [list, tuple, None],
        "max_effects": [Interval(Integral, 1, None, closed="left")],
        "max_simulated": [Interval(Integral, 0, None, closed="left")],
        "duration_s": [Interval(Real, 0, None, closed="neither")],
        "n_draws": [Interval(Integral, 1, None, closed="left")],
        "alpha": [Interval(Real, 0, 1, closed="neither")],
        "random_state": [Interval(Integral, 0, None, closed="left")],
        "n_jobs": [Integral],
        "table": [str, os.PathLike, None],
        "cache": [str, os.PathLike, None],
    }

    def __init__(
        self,
        sampling_rate: float = 25_600,
        simulator: CompositeSimulator | Rig | CycloidalGearbox | None = None,
        nuisance: NuisancePrior | None = None,
        library: Sequence[str] | None = None,
        max_effects: int = 3,
        max_simulated: int = 1,
        duration_s: float = 1.8,
        n_draws: int = 6,
        alpha: float = 0.05,
        random_state: int = 0,
        n_jobs: int = 1,
        table: str | os.PathLike[str] | None = None,
        cache: str | os.PathLike[str] | None = None,
    ) -> None:
        self.sampling_rate = sampling_rate
        self.simulator = simulator
        self.nuisance = nuisance
        self.library = library
        self.max_effects = max_effects
        self.max_simulated = max_simulated
        self.duration_s = duration_s
        self.n_draws = n_draws
        self.alpha = alpha
        self.random_state = random_state
        self.n_jobs = n_jobs
        self.table = table
        self.cache = cache

    @fit_context(prefer_skip_nested_validation=True)
    def fit(self, X: Any, y: Any = None, entropy: ArrayLike | None = None) -> Self:
        """Locate, name, add, and predict the discs left out.

        Parameters
        ----------
        X : structured array, mapping or data frame
            Columns ``defect_count``, ``min_nm``, ``max_nm``, ``mean_nm`` and ``std_nm``, one row per disc, 3
            to 20 of them; a ``range_nm`` is checked against ``max_nm`` minus ``min_nm``.
        y : ignored
        entropy : array-like, shape (n_discs,), optional
            Published Shannon entropies in bits (MATLAB's ``pwelch`` defaults). Only predicted and compared:
            never used in naming or fitting.

        Returns
        -------
        self

        Raises
        ------
        ValueError
            If columns are missing or contradict each other, discs are too few or twice there, the library
            names an unknown effect, or the table was made with other parameters.
        """
        counts, minimum, maximum, mean, std = _columns(X)
        n = len(counts)
        entropies = None if entropy is None else np.asarray(entropy, dtype=np.float64)
        if entropies is not None and (entropies.shape != (n,) or not np.isfinite(entropies).all()):
            raise ValueError(f"entropy must hold {n} finite numbers, one per disc, got {entropy!r}")
        self.warnings_ = _too_few(n, self.alpha)
        self.library_ = _names(self.library)
        self._rigs = SimulatedRigs(
            counts,
            simulator=self.simulator,
            nuisance=NuisancePrior() if self.nuisance is None else self.nuisance,
            duration_s=self.duration_s,
            sampling_rate=self.sampling_rate,
            n_draws=self.n_draws,
            table=self.table,
            random_state=self.random_state,
            n_jobs=self.n_jobs,
            cache=self.cache,
        )
        self.measured_ = to_statistics(minimum, maximum, mean, std, self._rigs.set_point)
        self.scales_ = self.measured_.std(axis=0, ddof=1)
        if (self.scales_ <= 0).any():
            raise ValueError("X must hold discs that differ in every statistic: their spread is the scale")
        self._scores: dict[tuple[Set, Set | tuple[int, ...]], Float] = {}
        self._fits: dict[Set, DenseRigs] = {}
        discs = tuple(range(n))
        self.discrepancies_ = self._locate()
        singles = {(name,): name for name in self.library_}
        ranked = {name: self._score(key, discs).mean() for key, name in singles.items()}
        ranked |= {"nothing": self._score((), discs).mean(), "constant": self._constant_score(discs).mean()}
        self.ranking_ = sorted(((k, float(v)) for k, v in ranked.items()), key=lambda row: row[1])
        named, self.steps_, self.dropped_ = self._name(discs)
        self.rejected_ = self._rejected(named, discs)
        self._add(named)
        self.held_out_ = self._hold_out(entropies)
        self.n_simulated_, self.n_failed_ = self._rigs.n_simulated, self._rigs.n_failed
        return self

    def predictive(self, disc: int, n: int = _SAMPLES) -> Float:
        """Statistics of a disc as ``simulator_`` with the weights of all discs predicts them.

        Parameters
        ----------
        disc : int
            Row of the table given to ``fit``.
        n : int
            Number of samples.

        Returns
        -------
        ndarray, shape (n, 4)
            As :func:`to_statistics`.
        """
        check_is_fitted(self)
        others = tuple(range(len(self.measured_)))
        return self._sample(self._key_of(self.effects_), others, disc, n)[0]

    def save_table(self, path: str | os.PathLike[str]) -> None:
        """Write the statistics of all rigs that were simulated, for ``table``.

        Parameters
        ----------
        path : path
            File to write (compressed, half precision: 0.1 % of a size).
        """
        check_is_fitted(self)
        self._rigs.save(Path(path))

    def __sklearn_is_fitted__(self) -> bool:
        return hasattr(self, "held_out_")

    # Where.

    def _locate(self) -> list[Discrepancy]:
        expected = self._rigs.table(()).values.mean(axis=(0, 1))  # of each disc's count
        differences = {name: self.measured_[:, k] - expected[:, k] for k, name in enumerate(STATISTICS)}
        differences["range"] = np.log(np.exp(self.measured_[:, 2:]).sum(axis=1)) - np.log(
            np.exp(expected[:, 2:]).sum(axis=1)
        )
        skew = self.measured_[:, 2] - self.measured_[:, 3]
        differences["up over down"] = skew - (expected[:, 2] - expected[:, 3])
        p = {name: sign_flip_p(d) for name, d in differences.items()}
        adjusted, worst = {}, 0.0
        for rank, name in enumerate(sorted(p, key=lambda name: p[name])):
            worst = max(worst, min(1.0, (len(p) - rank) * p[name]))
            adjusted[name] = worst
        found = []
        for name, d in differences.items():
            half = stats.t.ppf(0.975, d.size - 1) * d.std(ddof=1) / np.sqrt(d.size)
            found.append(
                Discrepancy(
                    statistic=name,
                    unit="Nm" if name == "mean" else "ln ratio",
                    difference=float(d.mean()),
                    low=float(d.mean() - half),
                    high=float(d.mean() + half),
                    same_sign=int(np.sum(np.sign(d) == np.sign(d.mean()))),
                    p=p[name],
                    p_adjusted=adjusted[name],
                )
            )
        return found

    # What.

    def _name(self, discs: tuple[int, ...]) -> tuple[Set, list[Step], tuple[str, ...]]:
        """Greedy search with backward deletion, by discs left out of ``discs``."""
        named: Set = ()
        steps: list[Step] = []
        dropped: list[str] = []
        while len(named) < self.max_effects:
            before = self._score(named, discs)
            tried = [
                name
                for name in self.library_
                if name not in named and name not in dropped and not self._excluded(named, name)
            ]
            scores = {name: self._score(self._ordered((*named, name)), discs) for name in tried}
            if not scores:
                break
            best = min(scores, key=lambda name: float(scores[name].mean()))
            p = sign_flip_p(before - scores[best], "greater")
            if p > self.alpha or scores[best].mean() >= before.mean():
                break
            alike = [
                name
                for name in sorted(tried, key=lambda name: float(scores[name].mean()))
                if name != best
                and sign_flip_p(before - scores[name], "greater") <= self.alpha
                and sign_flip_p(scores[name] - scores[best]) > self.alpha
            ]
            alone = next((g for g in _SAME_TORQUE if best in g and g[0] in alike), None)
            going_on = best if alone is None else alone[0]
            # Physics says these are the same here, even where few rigs were simulated of one of them.
            same = [name for group in _SAME_TORQUE if going_on in group for name in group]
            same = [name for name in same if name in self.library_]
            others = tuple(dict.fromkeys(n for n in (best, *same, *alike) if n != going_on))
            steps.append(
                Step(
                    effect_id=going_on,
                    score_before=float(before.mean()),
                    score_after=float(scores[going_on].mean()),
                    p=sign_flip_p(before - scores[going_on], "greater"),
                    look_alikes=others,
                    next_measurement=kind_of(going_on).separated_by,
                )
            )
            named = self._ordered((*named, going_on))
            for name in [other for other in named if other != going_on]:
                less = tuple(other for other in named if other != name)
                if sign_flip_p(self._score(less, discs) - self._score(named, discs), "greater") > self.alpha:
                    named = less
                    dropped.append(name)
        kept = [step for step in steps if step.effect_id in named]
        return named, kept, tuple(dropped)

    def _rejected(self, named: Set, discs: tuple[int, ...]) -> list[tuple[str, float, float]]:
        if len(named) >= self.max_effects:
            return []
        before, found = self._score(named, discs), []
        for name in self.library_:
            if name not in named and not self._excluded(named, name):
                score = self._score(self._ordered((*named, name)), discs)
                found.append((name, float(score.mean()), sign_flip_p(before - score, "greater")))
        return sorted(found, key=lambda row: row[1])

    def _excluded(self, named: Set, name: str) -> bool:
        """Too many to simulate, or a second member of a group that these statistics cannot tell apart."""
        if simulated_ones((name,)) and len(simulated_ones((*named, name))) > self.max_simulated:
            return True
        return any(name in group and any(other in group for other in named) for group in _SAME_TORQUE)

    def _ordered(self, names: Iterable[str]) -> Set:
        chosen = set(names)
        return tuple(name for name in self.library_ if name in chosen)

    def _score(self, key: Set, discs: tuple[int, ...]) -> Float:
        """CRPS over spread of each of the discs, predicted from the others of them, shape (n_discs,)."""
        if (key, discs) not in self._scores:
            found = []
            for disc in discs:
                others = tuple(other for other in discs if other != disc)
                sample, _ = self._sample(key, others, disc)
                found.append(self._scored(sample, disc))
            self._scores[key, discs] = np.array(found)
        return self._scores[key, discs]

    def _constant_score(self, discs: tuple[int, ...]) -> Float:
        return np.array(
            [
                self._scored(student_samples(self.measured_[[d for d in discs if d != disc]], _SAMPLES), disc)
                for disc in discs
            ]
        )

    def _scored(self, sample: Float, disc: int) -> float:
        return float(np.mean(crps(sample.T, self.measured_[disc]) / self.scales_))

    def _fitted(self, key: Set) -> DenseRigs:
        if key not in self._fits:
            dense = interpolated(self._rigs.table(key), self._rigs.bounds(key), self.random_state)
            samples = dense.middle[:, :, np.newaxis] + dense.noise[:, np.newaxis]
            loss = crps(np.moveaxis(samples, 2, -1), self.measured_) / self.scales_
            self._fits[key] = dataclasses.replace(dense, log_weight=-loss.mean(axis=-1) / _TOLERANCE)
        return self._fits[key]

    def _weights(self, key: Set, discs: Sequence[int]) -> Float:
        total = self._fitted(key).log_weight[:, list(discs)].sum(axis=1)
        weights = np.exp(total - total.max())
        return np.asarray(weights / weights.sum())

    def _sample(
        self, key: Set, discs: Sequence[int], disc: int, n: int = _SAMPLES
    ) -> tuple[Float, NDArray[np.intp]]:
        """Predictions of one disc by the rigs weighted with others, (n, 4), and the rig of each."""
        dense = self._fitted(key)
        random = np.random.default_rng([self.random_state, disc])
        # Systematic: each rig as often as its weight says, but for rounding.
        at = (np.arange(n) + random.random()) / n
        rigs = np.searchsorted(np.cumsum(self._weights(key, discs)), at).clip(max=len(dense.middle) - 1)
        error = dense.noise[rigs, random.integers(dense.noise.shape[1], size=n)]
        return dense.middle[rigs, disc] + error, rigs

    # Add and show.

    def _add(self, named: Set) -> None:
        theta = self._fitted(named).theta
        weights = self._weights(named, range(len(self.measured_)))
        best = int(np.argmax(weights))
        self.theta_, self.theta_ci_ = {}, {}
        for k, name in enumerate(self._rigs.parameter_names(named)):
            order = np.argsort(theta[:, k])
            reached = np.cumsum(weights[order])
            at = [min(int(np.searchsorted(reached, q)), len(order) - 1) for q in (0.05, 0.95)]
            self.theta_[name] = float(theta[best, k])
            self.theta_ci_[name] = (float(theta[order[at[0]], k]), float(theta[order[at[1]], k]))
        self.weights_ = weights
        self.effects_ = self._rigs.effects(named, theta[best])
        self.simulator_ = self._rigs.composite(self.effects_)

    def _key_of(self, effects: Iterable[Effect]) -> Set:
        return self._ordered(effect.effect_id for effect in effects)

    def _hold_out(self, entropies: Float | None) -> list[HeldOut]:
        n = len(self.measured_)
        rows = []
        for disc in range(n):
            others = tuple(other for other in range(n) if other != disc)
            named, _, _ = self._name(others)
            sample, rigs = self._sample(named, others, disc)
            nothing, _ = self._sample((), others, disc)
            for name in (*STATISTICS, "range"):
                rows.append(
                    self._row(
                        disc,
                        named,
                        name,
                        self._natural(self.measured_[[disc]], name)[0],
                        self._natural(sample, name),
                        self._natural(nothing, name),
                        self._natural(self.measured_[list(others)], name),
                    )
                )
            if entropies is not None:
                near = self._fitted(named).nearest[rigs]
                simulated = self._rigs.entropies(named)[near, :, disc].ravel()
                alone = self._rigs.entropies(())[:, :, disc].ravel()
                rows.append(
                    self._row(
                        disc, named, "entropy", entropies[disc], simulated, alone, entropies[list(others)]
                    )
                )
        return rows

    def _natural(self, values: Float, name: str) -> Float:
        if name == "mean":
            return np.asarray(values[:, 0] + self._rigs.set_point)
        if name == "range":
            return np.asarray(np.exp(values[:, 2:]).sum(axis=1))
        return np.asarray(np.exp(values[:, STATISTICS.index(name)]))

    def _row(
        self, disc: int, named: Set, name: str, measured: float, sample: Float, nothing: Float, others: Float
    ) -> HeldOut:
        low, middle, high = np.quantile(sample, (0.1, 0.5, 0.9))
        return HeldOut(
            disc=int(self._rigs.counts[disc]),
            effects=named,
            statistic=name,
            measured=float(measured),
            predicted=float(middle),
            low=float(low),
            high=float(high),
            nothing=float(np.median(nothing)),
            constant=float(np.mean(others)),
        )


def _too_few(n: int, alpha: float) -> list[str]:
    """That n discs can name nothing, or n - 1 of them."""
    fewest = fewest_units(alpha)
    if n < fewest:
        return [
            f"{n} discs: no effect can be named, as p over them is never below {2.0**-n:.2g} and alpha is "
            f"{alpha:g}; it takes at least {fewest}, and {fewest + 1} to predict one by the others"
        ]
    if n == fewest:
        return [
            f"{n} discs: no effect can be named without one of them, so held_out_ is the simulator alone; it "
            f"takes at least {fewest + 1} at alpha={alpha:g}"
        ]
    return []


def _names(library: Sequence[str] | None) -> Set:
    known = (*effect_library(), SET_POINT)
    if library is None:
        return tuple(name for name in known if name not in _UNSEEN)
    chosen = different_names(library, known, "library")
    return tuple(name for name in known if name in chosen)


def _columns(X: Any) -> tuple[NDArray[np.int64], Float, Float, Float, Float]:
    """Counts, minimum, maximum, mean and standard deviation of a table, checked."""
    wanted = ("defect_count", "min_nm", "max_nm", "mean_nm", "std_nm")
    try:
        counts, minimum, maximum, mean, std = (np.asarray(X[name], dtype=np.float64) for name in wanted)
    except (KeyError, IndexError, TypeError, ValueError) as error:
        raise ValueError(f"X must be a table with the columns {', '.join(wanted)}: {error}") from None
    if counts.ndim != 1 or not 3 <= counts.size <= 20:
        raise ValueError(f"X must have 3 to 20 rows, one per disc, got {np.shape(counts)}")
    values = np.array([counts, minimum, maximum, mean, std])
    if not np.isfinite(values).all():
        raise ValueError("X must hold finite numbers, got NaN or infinity")
    if (counts != counts.round()).any() or counts.min() < 0:
        raise ValueError(f"defect_count must hold whole numbers from 0, got {counts.tolist()}")
    if not ((minimum < mean) & (mean < maximum) & (std > 0)).all():
        raise ValueError("X must have min_nm < mean_nm < max_nm and std_nm above 0 in every row")
    try:
        stated = np.asarray(X["range_nm"], dtype=np.float64)
    except (KeyError, IndexError, ValueError):
        stated = maximum - minimum
    # Printed numbers are rounded on their own: to the last of four digits.
    if (np.abs(stated - (maximum - minimum)) > 0.02).any():
        raise ValueError("range_nm must be max_nm minus min_nm")
    return counts.astype(np.int64), minimum, maximum, mean, std
