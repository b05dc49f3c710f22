"""The gap from published statistics alone: no recording, one row of numbers per disc."""

from __future__ import annotations

import dataclasses
import itertools
import os
import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from numbers import Integral, Real
from pathlib import Path
from typing import Any, ClassVar, Self

import joblib
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats
from scipy.stats import qmc
from sklearn.base import BaseEstimator
from sklearn.exceptions import ConvergenceWarning
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel
from sklearn.utils.validation import check_is_fitted

from cyclofeat._density import shannon_entropy
from cyclofeat._files import write_whole
from cyclofeat._sklearn import Interval, fit_context
from cyclofeat._welch import welch_psd
from cyclofeat.gap._null import NuisancePrior, cache_key, record
from cyclofeat.simulators import (
    CompositeSimulator,
    CycloidalGearbox,
    Effect,
    Place,
    Rig,
    SimulationFailed,
    effect_library,
)
from cyclofeat.simulators.effects import EffectParameter, Normal

Float = NDArray[np.float64]
Set = tuple[str, ...]

# A clock that is off by parts in a thousand changes no minimum, maximum, mean or deviation.
_UNSEEN = ("clock_error",)
STATISTICS = ("mean", "std", "up", "down")
SET_POINT = "brake_set_point"
_REPLICATES = 2
_TOLERANCE = 0.5  # spreads over the discs by which the score grows when a rig's weight falls to 1/e
_SAMPLES = 400
_DENSE = 512  # rigs between the simulated ones, a power of two
_NEAR = 4  # simulated rigs whose noise one of them takes

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


@dataclass(frozen=True)
class _Table:
    """Statistics of simulated rigs: each row of theta is one rig, recorded ``_REPLICATES`` times per disc.

    ``theta`` (n, n_parameters); ``values`` (n, replicates, n_counts, 4) as :func:`to_statistics` gives them.
    """

    theta: Float
    values: Float


@dataclass(frozen=True)
class _Dense:
    """Many rigs between the simulated ones.

    ``theta`` (n, n_parameters); ``middle`` (n, n_counts, 4) expected; ``noise`` (n, m, 4) how records
    of rigs nearby lie around theirs; ``nearest`` (n, k) those rigs; ``log_weight`` (n, n_discs).
    """

    theta: Float
    middle: Float
    noise: Float
    nearest: NDArray[np.intp]
    log_weight: Float


def sign_flip_p(differences: ArrayLike, alternative: str = "two-sided") -> float:
    """Exact p of a mean of zero, all signs of the differences being equally likely.

    Parameters
    ----------
    differences : array-like, shape (n,)
        One number per independent unit; at most 20 of them.
    alternative : {"two-sided", "greater"}

    Returns
    -------
    float
        Share of the 2^n sign patterns whose mean is at least as extreme, the observed one among them.

    Raises
    ------
    ValueError
        If there are no differences or more than 20, some are not finite, or the alternative is unknown.

    Examples
    --------
    >>> sign_flip_p([0.4, 0.9, 0.1, 0.7, 0.5, 0.6, 0.3, 0.8])
    0.0078125
    """
    values = np.asarray(differences, dtype=np.float64)
    if values.ndim != 1 or not 1 <= values.size <= 20 or not np.isfinite(values).all():
        raise ValueError(f"differences must be 1 to 20 finite numbers, got {differences!r}")
    if alternative not in ("two-sided", "greater"):
        raise ValueError(f"alternative must be 'two-sided' or 'greater', got {alternative!r}")
    signs = 1 - 2 * ((np.arange(2**values.size)[:, None] >> np.arange(values.size)) & 1)
    sums = signs @ values
    observed = values.sum()
    if alternative == "two-sided":
        sums, observed = np.abs(sums), abs(observed)
    return float(np.mean(sums >= observed - 1e-12 * np.abs(values).sum()))


def to_statistics(
    minimum: ArrayLike, maximum: ArrayLike, mean: ArrayLike, std: ArrayLike, set_point: float
) -> Float:
    """The four numbers that discs are compared by, shape (..., 4).

    Mean minus set-point in Nm, and the natural logarithms of standard deviation, largest excursion upward
    (maximum minus mean) and downward (mean minus minimum), each in Nm.
    """
    low, high, middle, spread = (np.asarray(x, dtype=np.float64) for x in (minimum, maximum, mean, std))
    sizes = [np.log(np.maximum(x, 1e-9)) for x in (spread, high - middle, middle - low)]
    return np.stack([middle - set_point, *sizes], axis=-1)


def crps(samples: ArrayLike, observed: ArrayLike) -> Float:
    """Continuous ranked probability score of equally likely samples, E|X - y| - E|X - X'| / 2.

    Smaller is better; in the samples' unit (Gneiting and Raftery 2007, eq. 21).

    Parameters
    ----------
    samples : array-like, shape (..., n)
    observed : array-like
        Of a shape that goes with ``samples`` without its last axis.

    Returns
    -------
    ndarray

    Examples
    --------
    >>> float(crps([1.0, 1.0], 3.0))
    2.0
    """
    ordered = np.sort(np.asarray(samples, dtype=np.float64), axis=-1)
    n = ordered.shape[-1]
    gaps = 2 * np.arange(1, n + 1) - n - 1
    distance = np.abs(ordered - np.asarray(observed)[..., np.newaxis]).mean(axis=-1)
    return np.asarray(distance - ordered @ gaps / n**2)


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
        self.library_ = _names(self.library)
        self._bench = _Bench(self, counts)
        self.measured_ = to_statistics(minimum, maximum, mean, std, self._bench.set_point)
        self.scales_ = self.measured_.std(axis=0, ddof=1)
        if (self.scales_ <= 0).any():
            raise ValueError("X must hold discs that differ in every statistic: their spread is the scale")
        self._scores: dict[tuple[Set, Set | tuple[int, ...]], Float] = {}
        self._fits: dict[Set, _Dense] = {}
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
        self.n_simulated_, self.n_failed_ = self._bench.n_simulated, self._bench.n_failed
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
        self._bench.save(Path(path))

    def __sklearn_is_fitted__(self) -> bool:
        return hasattr(self, "held_out_")

    # Where.

    def _locate(self) -> list[Discrepancy]:
        expected = self._bench.table(()).values.mean(axis=(0, 1))  # of each disc's count
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
                    next_measurement=_separated_by(going_on),
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
        if _gear((name,)) and len(_gear((*named, name))) > self.max_simulated:
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
            [self._scored(_constant(self.measured_[[d for d in discs if d != disc]]), disc) for disc in discs]
        )

    def _scored(self, sample: Float, disc: int) -> float:
        return float(np.mean(crps(sample.T, self.measured_[disc]) / self.scales_))

    def _fitted(self, key: Set) -> _Dense:
        if key not in self._fits:
            dense = _interpolated(self._bench.table(key), self._bench.bounds(key), self.random_state)
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
        for k, name in enumerate(self._bench.parameter_names(named)):
            order = np.argsort(theta[:, k])
            reached = np.cumsum(weights[order])
            at = [min(int(np.searchsorted(reached, q)), len(order) - 1) for q in (0.05, 0.95)]
            self.theta_[name] = float(theta[best, k])
            self.theta_ci_[name] = (float(theta[order[at[0]], k]), float(theta[order[at[1]], k]))
        self.weights_ = weights
        self.effects_ = self._bench.effects(named, theta[best])
        self.simulator_ = self._bench.composite(self.effects_)

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
                simulated = self._bench.entropies(named)[near, :, disc].ravel()
                alone = self._bench.entropies(())[:, :, disc].ravel()
                rows.append(
                    self._row(
                        disc, named, "entropy", entropies[disc], simulated, alone, entropies[list(others)]
                    )
                )
        return rows

    def _natural(self, values: Float, name: str) -> Float:
        if name == "mean":
            return np.asarray(values[:, 0] + self._bench.set_point)
        if name == "range":
            return np.asarray(np.exp(values[:, 2:]).sum(axis=1))
        return np.asarray(np.exp(values[:, STATISTICS.index(name)]))

    def _row(
        self, disc: int, named: Set, name: str, measured: float, sample: Float, nothing: Float, others: Float
    ) -> HeldOut:
        low, middle, high = np.quantile(sample, (0.1, 0.5, 0.9))
        return HeldOut(
            disc=int(self._bench.counts[disc]),
            effects=named,
            statistic=name,
            measured=float(measured),
            predicted=float(middle),
            low=float(low),
            high=float(high),
            nothing=float(np.median(nothing)),
            constant=float(np.mean(others)),
        )


class _Bench:
    """Simulated rigs with sets of effects, and what they would have published."""

    def __init__(self, gap: SummaryGap, counts: NDArray[np.int64]) -> None:
        nuisance = NuisancePrior() if gap.nuisance is None else gap.nuisance
        self.gap, self.counts, self.nuisance = gap, counts, nuisance
        self.simulator = nuisance.simulator(gap.simulator)
        assert isinstance(self.simulator.base, Rig)
        self.set_point = float(self.simulator.base.gearbox.load_torque)
        self.n_samples = round(gap.duration_s * gap.sampling_rate)
        self.n_simulated = self.n_failed = 0
        self.tables: dict[Set, _Table] = {}
        self.entropy: dict[Set, Float] = {}
        self.records: dict[Set, NDArray[np.float32]] = {}
        self.kept: dict[Set, NDArray[np.intp]] = {}  # rigs in the place of those that failed
        # What the numbers depend on, without the version of the code: a table may be shipped.
        self.stated = repr(
            (
                self.simulator.to_rig().to_text(), nuisance, counts.tolist(), self.n_samples,
                float(gap.sampling_rate), int(gap.n_draws), int(gap.random_state),
            )
        )  # fmt: skip
        if gap.table is not None:
            self._load(Path(gap.table))

    def table(self, key: Set) -> _Table:
        if key not in self.tables:
            values = self._each_torque(key, _statistics_of)
            low, high, mean, std = np.moveaxis(values, -1, 0)
            found = to_statistics(low, high, mean, std, self.set_point)
            # After the records: a rig that failed has taken another's parameters.
            self.tables[key] = _Table(self.thetas(key), found)
        return self.tables[key]

    def entropies(self, key: Set) -> Float:
        """Shannon entropies in bits, (n_rigs, replicates, n_counts)."""
        if key not in self.entropy:
            self.entropy[key] = self._each_torque(key, self._entropy_of)[..., 0]
        return self.entropy[key]

    def parameter_names(self, key: Set) -> list[str]:
        return [f"{name}.{parameter}" for name in key for parameter in _parameters(name)]

    def bounds(self, key: Set) -> list[tuple[float, float, bool]]:
        """Smallest and largest value of each parameter in the table, and whether it counts in logarithms."""
        theta = self.table(key).theta
        kinds = [_kind(name).parameters[p] for name in key for p in _parameters(name)]
        return [
            (float(column.min()), float(column.max()), kind.log)
            for column, kind in zip(theta.T, kinds, strict=True)
        ]

    def effects(self, key: Set, theta: Float) -> tuple[Effect, ...]:
        found, at = [], 0
        for name in key:
            names = _parameters(name)
            values = dict(zip(names, theta[at : at + len(names)].tolist(), strict=True))
            found.append(_kind(name)().with_parameters(**values))
            at += len(names)
        return tuple(found)

    def composite(self, effects: Iterable[Effect]) -> CompositeSimulator:
        """A set-point is the load of the gearbox: what is left are effects that files know."""
        base, left = self.simulator.base, []
        assert isinstance(base, Rig)
        for effect in effects:
            if isinstance(effect, BrakeSetPoint):
                base = base.replace(gearbox=effect.change_gearbox(base.gearbox, np.random.default_rng(0)))
            else:
                left.append(effect)
        return CompositeSimulator(base, (*self.simulator.effects, *left))

    def n_rigs(self, key: Set) -> int:
        n_parameters = sum(len(_parameters(name)) for name in key)
        return max(self._n_gear(_gear(key)), min(16 * self.gap.n_draws, 5 * self.gap.n_draws * n_parameters))

    def thetas(self, key: Set) -> Float:
        """A Latin hypercube over the priors of each effect: of the gearbox's as many as are simulated."""
        n = self.n_rigs(key)
        columns: list[Float] = []
        for name in key:
            if not _kind(name).needs_simulation():
                columns += self._hypercube(name, n)
                continue
            n_gear = self._n_gear(_gear(key))
            kept = self.kept.get(_gear(key), np.arange(n_gear))
            columns += [np.resize(column[kept], n) for column in self._hypercube(name, n_gear)]
        return np.column_stack(columns) if columns else np.zeros((n, 0))

    def _hypercube(self, name: str, n: int) -> list[Float]:
        kind, names = _kind(name), _parameters(name)
        if not names:
            return []
        seed = np.random.default_rng([self.gap.random_state, *name.encode(), n])
        shares = qmc.LatinHypercube(len(names), seed=seed).random(n)
        columns = []
        for k, parameter in enumerate(names):
            what = kind.parameters[parameter]
            assert what.prior is not None
            values = np.array([what.prior.quantile(float(share)) for share in shares[:, k]])
            columns.append(np.clip(values, what.low, what.high))
        return columns

    def _n_gear(self, gear: Set) -> int:
        """Rigs whose gearbox is simulated."""
        n_parameters = sum(len(_parameters(name)) for name in gear)
        if len(gear) > 1:
            return 3 * self.gap.n_draws
        return self.gap.n_draws * (max(n_parameters, 1) ** 2 if gear else 3)

    def _each_torque(self, key: Set, work: Any) -> Float:
        """What ``work`` makes of each record, shape (n_rigs, replicates, n_counts, ...)."""
        records = self._records(_gear(key))
        theta = self.thetas(key)
        chain = [name for name in key if not _kind(name).needs_simulation()]
        found = []
        for rig in range(len(theta)):
            effects = [e for e in self.effects(key, theta[rig]) if e.effect_id in chain]
            effects.sort(key=lambda effect: effect.place)
            for replicate, k in itertools.product(range(_REPLICATES), range(len(self.counts))):
                torque = records[rig % len(records), replicate, k].astype(np.float64)
                for effect in effects:
                    seed = np.random.SeedSequence(
                        [self.gap.random_state, *effect.effect_id.encode()], spawn_key=(rig, replicate, k)
                    )
                    random = np.random.default_rng(seed)
                    torque = effect.change_torque(torque, self.gap.sampling_rate, random)
                found.append(work(torque))
        return np.array(found).reshape(len(theta), _REPLICATES, len(self.counts), -1)

    def _entropy_of(self, torque: Float) -> Float:
        frequencies, psd = welch_psd(torque[np.newaxis], self.gap.sampling_rate, "matlab_pwelch")
        return np.asarray(shannon_entropy(psd, frequencies))

    def _records(self, gear: Set) -> NDArray[np.float32]:
        """Torque after the effects in the gearbox, (n_gear, replicates, n_counts, n_samples).

        Another rig takes the place of one of which a record cannot be simulated; those records are counted.
        """
        if gear in self.records:
            return self.records[gear]
        n = self._n_gear(gear)
        file = None
        if self.gap.cache is not None:
            name = cache_key(self.simulator, self.nuisance, self.stated, gear, n)
            file = Path(self.gap.cache) / f"records-{'-'.join(gear) or 'nothing'}-{name}.npy"
            if file.exists():
                self.records[gear] = np.load(file, mmap_mode="r")
                return self.records[gear]
        columns = [column for name in gear for column in self._hypercube(name, n)]
        theta = np.column_stack(columns) if columns else np.zeros((n, 0))
        jobs = list(itertools.product(range(n), range(_REPLICATES), range(len(self.counts))))
        composites = [self.composite(self.effects(gear, row)) for row in theta]
        seeds = [np.random.SeedSequence(self.gap.random_state, spawn_key=job) for job in jobs]
        made = joblib.Parallel(n_jobs=self.gap.n_jobs)(
            joblib.delayed(_record)(
                composites[rig], self.nuisance, int(self.counts[k]), self.n_samples,
                float(self.gap.sampling_rate), seed,
            )
            for (rig, _, k), seed in zip(jobs, seeds, strict=True)
        )  # fmt: skip
        self.n_simulated += len(made)
        shape = (n, _REPLICATES, len(self.counts), self.n_samples)
        failed = np.array([torque is None for torque in made]).reshape(shape[:3])
        self.n_failed += int(failed.sum())
        good = np.flatnonzero(~failed.any(axis=(1, 2)))
        if good.size == 0:
            raise ValueError(f"library must hold effects that can be simulated: {' + '.join(gear)} cannot")
        filled = [np.zeros(self.n_samples, np.float32) if torque is None else torque for torque in made]
        records = np.array(filled).reshape(shape)
        if good.size < n:
            self.kept[gear] = good[np.searchsorted(good, np.arange(n)).clip(max=good.size - 1)]
            records = records[self.kept[gear]]
        self.records[gear] = records
        # What failed would be found anew with the file there, without the rigs that took its place.
        if file is not None and good.size == n:
            file.parent.mkdir(parents=True, exist_ok=True)
            write_whole(file, lambda stream: np.save(stream, records))
        return records

    def save(self, path: Path) -> None:
        arrays: dict[str, Any] = {"stated": np.array(self.stated)}
        for key, table in self.tables.items():
            arrays["values:" + "+".join(key)] = table.values.astype(np.float16)
            arrays["theta:" + "+".join(key)] = table.theta.astype(np.float32)
        for key, entropy in self.entropy.items():
            arrays["entropy:" + "+".join(key)] = entropy.astype(np.float16)
        write_whole(path, lambda stream: np.savez_compressed(stream, **arrays))

    def _load(self, path: Path) -> None:
        with np.load(path) as stored:
            if str(stored["stated"]) != self.stated:
                raise ValueError(
                    f"table {path} was made with another simulator, prior, discs, duration_s, sampling_rate, "
                    "n_draws or random_state: leave it out, or give the same"
                )
            for name in stored.files:
                kind, _, joined = name.partition(":")
                key = tuple(joined.split("+")) if joined else ()
                if kind == "values":
                    self.tables[key] = _Table(
                        stored["theta:" + joined].astype(np.float64), stored[name].astype(np.float64)
                    )
                elif kind == "entropy":
                    self.entropy[key] = stored[name].astype(np.float64)


class BrakeSetPoint(Effect):
    """Another set-point of the brake: a constant more or less of load.

    Not in the library of files: as a simulator it is the gearbox's own ``load_torque``.

    Parameters
    ----------
    shift_nm : float, default=0.5
        In Nm, added to the load.
    """

    effect_id: ClassVar[str] = SET_POINT
    place: ClassVar[Place] = Place.LOAD_AND_SPEED
    parameters: ClassVar[Mapping[str, EffectParameter]] = {
        "shift_nm": EffectParameter("Nm", -1e3, 1e3, 0.0, Normal(0.0, 0.5)),
    }
    separated_by: ClassVar[str] = "a dead-weight calibration, and the brake's own reading"

    def __init__(self, shift_nm: Any = 0.5) -> None:
        self.shift_nm = shift_nm

    def change_gearbox(self, gearbox: CycloidalGearbox, random: np.random.Generator) -> CycloidalGearbox:
        return gearbox.replace(load_torque=gearbox.load_torque + self.shift_nm)


def _kind(name: str) -> type[Effect]:
    return BrakeSetPoint if name == SET_POINT else effect_library()[name]


def _parameters(name: str) -> list[str]:
    return _kind(name).vector_names()


def _gear(key: Iterable[str]) -> Set:
    """The effects that the gearbox answers: they have to be simulated."""
    return tuple(name for name in key if _kind(name).needs_simulation())


def _names(library: Sequence[str] | None) -> Set:
    known = (*effect_library(), SET_POINT)
    chosen = tuple(n for n in known if n not in _UNSEEN) if library is None else tuple(library)
    unknown = [name for name in chosen if name not in known]
    if unknown or not chosen or len(set(chosen)) < len(chosen):
        raise ValueError(f"library must name different effects of {', '.join(known)}, got {library!r}")
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


def _record(
    composite: CompositeSimulator,
    nuisance: NuisancePrior,
    count: int,
    n_samples: int,
    sampling_rate: float,
    seed: np.random.SeedSequence,
) -> NDArray[np.float32] | None:
    """Torque of one record, or None where it cannot be simulated."""
    try:
        return record(composite, nuisance, count, n_samples, sampling_rate, seed)[0]
    except SimulationFailed:
        return None
    except ValueError as error:
        if "settles in" in str(error):
            return None
        raise


def _statistics_of(torque: Float) -> Float:
    return np.array([torque.min(), torque.max(), torque.mean(), torque.std()])


def _interpolated(table: _Table, bounds: Sequence[tuple[float, float, bool]], seed: int) -> _Dense:
    """Statistics between the simulated rigs, by a Gaussian process over their parameters.

    One process, its length scales shared by all statistics and counts, takes means over the replicates; noise
    is what the records of the nearest rigs leave.
    """
    values = table.values
    n, n_replicates, n_counts, n_statistics = values.shape
    none = np.zeros((0, 0))
    if table.theta.shape[1] == 0:
        middle = values.mean(axis=(0, 1))[np.newaxis]
        noise = (values - middle).reshape(1, -1, n_statistics)
        return _Dense(np.zeros((1, 0)), middle, noise, np.arange(n)[np.newaxis], none)

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
        # A length scale at its upper bound means a parameter that changes nothing.
        warnings.simplefilter("ignore", ConvergenceWarning)
        process.fit(at, scaled)

    def expected(places: Float) -> Float:
        found = np.asarray(process.predict(places)) * spread + means.mean(axis=0)
        return np.asarray(found.reshape(len(places), n_counts, n_statistics))

    left = (values - expected(at)[:, np.newaxis]).reshape(n, n_replicates * n_counts, n_statistics)
    # Between the smallest and the largest values simulated: nothing is extrapolated.
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
    return _Dense(theta, expected(places), left[nearest].reshape(_DENSE, -1, n_statistics), nearest, none)


def _constant(others: Float) -> Float:
    """Student's prediction of one more disc like the others, as equally likely samples."""
    n = len(others)
    shares = (np.arange(_SAMPLES) + 0.5) / _SAMPLES
    quantiles = stats.t.ppf(shares, n - 1)[:, np.newaxis] * np.sqrt(1 + 1 / n)
    return np.asarray(others.mean(axis=0) + quantiles * others.std(axis=0, ddof=1))


def _separated_by(name: str) -> str:
    return _kind(name).separated_by
