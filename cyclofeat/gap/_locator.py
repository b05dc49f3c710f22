"""Where measured and simulated torque disagree: tests with the recording as the unit of replication."""

from __future__ import annotations

import dataclasses
import math
import os
from dataclasses import dataclass
from numbers import Integral, Real
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.base import BaseEstimator
from sklearn.utils.validation import check_is_fitted, validate_data

from cyclofeat._sklearn import Interval, fit_context
from cyclofeat.gap._global_tests import classifier_p, energy_p
from cyclofeat.gap._nuisance import SpeedAndLoad, alikeness, widening
from cyclofeat.gap._null import Bank, NuisancePrior, summarised_bank
from cyclofeat.gap._permutation import (
    SPREADS,
    TOGETHER,
    Permuted,
    family_p,
    holm,
    smallest_spreads,
    statistics_by_family,
)
from cyclofeat.gap._phase import PhaseMap, phase_maps
from cyclofeat.gap._recordings import mean_speeds, mixed, per_recording, recordings_of, registered
from cyclofeat.gap._summaries import FAMILIES, Cell, left_out, summarise_all
from cyclofeat.simulators import CompositeSimulator, CycloidalGearbox, Rig

Float = NDArray[np.float64]

_EQUIVALENT_DB = 1.5
_EQUIVALENT_SPREADS = 0.5  # of one recording's replicate noise, for cells that are no levels
# Permutations in which the classifier is refitted; its p is no smaller than one over this.
_REFITS = 99
# Simulated to learn how alike recordings of one assembly are.
_ASSEMBLIES, _PER_ASSEMBLY = 32, 4
_N_FAMILIES = len(FAMILIES) + 2  # and spreads, and all together
_POWER_Z = 0.8416  # standard normal quantile of a power of 0.8


@dataclass(frozen=True)
class Row:
    """One cell of the comparison.

    Attributes
    ----------
    cell : Cell
    of : {"mean", "spread"}
        What is compared: the means over recordings, or how far recordings spread.
    effect : float
        Measured minus simulated, in the cell's unit; of spreads their ratio in dB.
    low, high : float
        Its interval, simultaneous within the family, at 1 - alpha.
    p : float
        Adjusted within the family (Westfall-Young, step-down) and across families (Holm).
    detectable : float
        Smallest effect that would have been found with a chance of 0.8.
    spread : float
        Standard deviation of one recording, in the cell's unit; of spreads that of the ratio in dB.
    """

    cell: Cell
    of: str
    effect: float
    low: float
    high: float
    p: float
    detectable: float
    spread: float


class GapLocator(BaseEstimator):
    """Where do measured recordings differ from what the simulator alone would have recorded?

    Each recording is summarised by some 180 numbers in nine families (:mod:`cyclofeat.gap`), and so are
    ``n_bank`` simulated ones under the prior of what may differ anyway. Compared are the means over
    recordings, and how far recordings spread. Labels are then permuted among
    recordings, never among windows of one: windows of a recording are no replicates (as replicates they
    raise false alarms in 99.8 % of cases without a difference).

    The measured recordings may share a speed or a load that the prior allows. What follows a recording's own
    speed and mean torque is therefore taken out on both sides, as far as simulated recordings go.

    Parameters
    ----------
    sampling_rate : float
        Samples per second in Hz.
    simulator : CompositeSimulator, Rig or CycloidalGearbox, optional
        The model. Default: paper B's gearbox.
    nuisance : NuisancePrior, optional
        What may differ without being a missing effect.
    input_speed_hz : float, default=500 / 60
        Nominal input speed.
    alpha : float, default=0.05
        Chance of a false "disagree" over all families together.
    n_bank : int, default=200
        Simulated recordings.
    one_assembly : bool, default=False
        Whether the measured recordings are all of one assembly: the same gearbox, not taken apart between
        them. They then have its errors in common, and count as fewer: by how many, 128 more simulated
        recordings tell, four of each assembly. Default: each is of an assembly of its own.
    alike : array-like, shape (n_cells,), optional
        How alike recordings of one assembly are, where another locator has learned it (``alike_``).
    n_permutations : int, default=999
        Relabellings. A p is at least 11 / (n_permutations + 1), as 11 families are adjusted for: fewer than
        219 can never "disagree" at 0.05, and are refused.
    random_state : int, default=0
    n_jobs : int, default=1
        Worker processes of the simulations.
    cache : path, optional
        Folder in which simulated recordings are kept.

    Attributes
    ----------
    table_ : list of Row
        All cells: means in the order of the families, then spreads, then all means together. Spreads and
        all together are tested one-sidedly: of their intervals the lower end alone holds at 1 - alpha, the
        upper one lies as far above the effect and bounds nothing.
    verdict_ : {"disagree", "equivalent", "unresolved"}
        ``"disagree"``: some adjusted p is at most alpha. ``"equivalent"``: all intervals of means lie within
        1.5 dB or half a recording's spread. ``"unresolved"``: neither; more recordings would tell.
    family_p_ : dict from str to float
        Smallest p of each family, adjusted within and across families; ``"spreads"`` and ``"together"`` are
        families of their own.
    p_global_ : dict from str to float
        Energy distance of all cells, and a classifier that tries to tell measured from simulated (folds by
        recording, refitted under each permutation); not part of the verdict.
    phase_ : dict from str to PhaseMap
        Torque folded over the input's turn and over the passage of the lobes, for a picture.
    bank_ : Bank
    alike_ : ndarray, shape (n_cells,)
        Share of each cell's variance that recordings of one assembly have in common.
    cells_ : list of Cell
    left_out_ : list of str
        Lines and bands that are not compared: the rate does not hold them, or nothing lies between them.
    measured_, simulated_ : ndarray, shape (n_recordings, n_cells) and (n_bank, n_cells)
        Summaries, one row per recording.
    n_features_in_ : int

    Notes
    -----
    The statistic of a cell is the difference of means over its standard error with the pooled variance, as
    exchangeability has it under the hypothesis; that of spreads the logarithm of the ratio of variances over
    its standard deviation under permuted labels; the family "together" has one statistic, the root mean
    square of all differences after a shrunk, label-free decorrelation. p = (b + 1) / (m + 1), never 0. A
    cell's spread is taken as at least 0.1 dB, 0.01 Nm, 0.02 % or 0.02 (assumptions), below which a difference
    has no consequence.

    Examples
    --------
    >>> from cyclofeat.datasets import make_rig_recordings
    >>> records = make_rig_recordings(2, [0, 3], rig="R0", random_state=1)
    >>> X = [record.torque for record in records]
    >>> locator = GapLocator(25_600, n_bank=24, n_permutations=499).fit(X, y=[0, 3, 0, 3])
    >>> locator.verdict_
    'disagree'
    """

    _parameter_constraints: ClassVar[dict[str, list[Any]]] = {
        "sampling_rate": [Interval(Real, 0, None, closed="neither")],
        "simulator": [CompositeSimulator, Rig, CycloidalGearbox, None],
        "nuisance": [NuisancePrior, None],
        "input_speed_hz": [Interval(Real, 0, None, closed="neither")],
        "alpha": [Interval(Real, 0, 1, closed="neither")],
        "n_bank": [Interval(Integral, 10, None, closed="left")],
        "one_assembly": ["boolean"],
        "alike": ["array-like", None],
        "n_permutations": [Interval(Integral, 19, None, closed="left")],
        "random_state": [Interval(Integral, 0, None, closed="left")],
        "n_jobs": [Integral],
        "cache": [str, os.PathLike, None],
    }

    # Made when they are first asked for.
    _phase: dict[str, PhaseMap] | None
    _p_global: dict[str, float] | None

    def __init__(
        self,
        sampling_rate: float,
        simulator: CompositeSimulator | Rig | CycloidalGearbox | None = None,
        nuisance: NuisancePrior | None = None,
        input_speed_hz: float = 500 / 60,
        alpha: float = 0.05,
        n_bank: int = 200,
        one_assembly: bool = False,
        alike: ArrayLike | None = None,
        n_permutations: int = 999,
        random_state: int = 0,
        n_jobs: int = 1,
        cache: str | os.PathLike[str] | None = None,
    ) -> None:
        self.sampling_rate = sampling_rate
        self.simulator = simulator
        self.nuisance = nuisance
        self.input_speed_hz = input_speed_hz
        self.alpha = alpha
        self.n_bank = n_bank
        self.one_assembly = one_assembly
        self.alike = alike
        self.n_permutations = n_permutations
        self.random_state = random_state
        self.n_jobs = n_jobs
        self.cache = cache

    @fit_context(prefer_skip_nested_validation=True)
    def fit(
        self,
        X: ArrayLike,
        y: ArrayLike | None = None,
        groups: ArrayLike | None = None,
        angle: ArrayLike | None = None,
    ) -> Self:
        """Compare measured windows with the simulator.

        Parameters
        ----------
        X : array-like, shape (n_windows, n_samples)
            Measured torque in Nm, at least one output turn per window.
        y : array-like of int, shape (n_windows,), optional
            Known counts of worn lobes; the simulated recordings then have the same ones, and the mean of
            each count is taken out before the comparison.
        groups : array-like, shape (n_windows,), optional
            Recording of each window. Default: each window is a recording of its own.
        angle : array-like, shape (n_windows, n_samples), optional
            Angle of the input shaft in rad, by a tachometer. Orders are then of its speed, and the speed that
            the mesh lines show is compared with it. Default: the mesh lines alone.

        Returns
        -------
        self

        Raises
        ------
        ValueError
            If there are fewer than two recordings, windows are too short, ``y`` has a count that the wheel
            cannot have, a recording has two counts, ``angle`` does not belong to ``X``, or ``n_permutations``
            is too small for ``alpha``.
        """
        windows = validate_data(self, X, dtype=[np.float64, np.float32])
        fewest = math.ceil(_N_FAMILIES / self.alpha) - 1
        if self.n_permutations < fewest:
            raise ValueError(
                f"n_permutations must be at least {fewest} for alpha={self.alpha:g}: with fewer nothing can "
                f"disagree, got {self.n_permutations}"
            )
        nuisance = NuisancePrior() if self.nuisance is None else self.nuisance
        n_lobes = nuisance.n_lobes(self.simulator, self.input_speed_hz)
        speeds = None if angle is None else mean_speeds(angle, windows.shape, self.sampling_rate)
        # In the precision of the bank, or the share of distinct values would tell them apart.
        windows = windows.astype(np.float32)
        windows = registered(windows, self.sampling_rate, self.input_speed_hz, n_lobes)
        of_window, counts = recordings_of(len(windows), y, groups)
        if counts is not None and counts.max() > n_lobes:
            raise ValueError(f"y must hold counts from 0 to the {n_lobes} lobes, got {counts.max()}")
        n_recordings = int(of_window.max()) + 1
        if n_recordings < 2:
            raise ValueError(
                "groups must hold at least 2 recordings: one recording has no spread to compare with, got 1"
            )
        with_tachometer = angle is not None
        wanted = None if counts is None else mixed(counts, self.n_bank)
        self.bank_, self.simulated_ = self._simulated(
            nuisance, wanted, self.n_bank, windows.shape[1], with_tachometer
        )
        values, self.cells_ = summarise_all(windows, self.sampling_rate, self.input_speed_hz, n_lobes, speeds)
        self.left_out_ = left_out(self.cells_, self.sampling_rate, n_lobes)
        self.measured_ = per_recording(values, of_window)
        self.counts_ = counts
        simulated = self.centred(self.simulated_, self.bank_.counts)
        trend = SpeedAndLoad(simulated, self.cells_, smallest_spreads(self.cells_))
        self.alike_ = self._alikeness(nuisance, trend, windows.shape[1], with_tachometer)
        simulated = trend.without(simulated)
        measured = trend.without(self.centred(self.measured_, counts))
        self._compare(measured, simulated)
        self._folded = (windows, n_lobes, speeds)
        self._phase = None
        return self

    @property
    def p_global_(self) -> dict[str, float]:
        """Two tests of all cells at once, made when they are first asked for."""
        check_is_fitted(self)
        if self._p_global is None:
            random = np.random.default_rng([self.random_state, 2])
            self._p_global = {
                "energy distance": energy_p(*self._compared, self.n_permutations, random),
                "classifier": classifier_p(*self._compared, min(self.n_permutations, _REFITS), random),
            }
        return self._p_global

    @property
    def phase_(self) -> dict[str, PhaseMap]:
        """Torque folded over the turn, made when it is first asked for."""
        check_is_fitted(self)
        if self._phase is None:
            windows, n_lobes, speeds = self._folded
            tachometer = None if speeds is None else (speeds, self.bank_.speeds * self.sampling_rate)
            self._phase = phase_maps(
                windows,
                self.bank_.X,
                self.sampling_rate,
                self.input_speed_hz,
                n_lobes,
                self.alpha,
                tachometer,
            )
        return self._phase

    def centred(self, values: Float, counts: NDArray[Any] | None) -> Float:
        """Summaries less the simulated mean of their count; as they are where counts are not known."""
        if self.counts_ is None or counts is None:
            return values
        means = {
            c: self.simulated_[self.bank_.counts == c].mean(axis=0) for c in np.unique(self.bank_.counts)
        }
        return np.asarray(values - np.array([means[count] for count in counts]))

    def calibrate_null(self, n_trials: int = 200) -> float:
        """Share of false "disagree" when simulated recordings take the place of the measured ones.

        Each trial takes as many recordings out of the bank as were measured and compares them with the rest.

        Parameters
        ----------
        n_trials : int

        Returns
        -------
        float
            Also kept as ``null_rate_``.

        Raises
        ------
        ValueError
            If ``n_trials`` is no whole number from 1, or the bank leaves too few recordings to compare with.
        """
        check_is_fitted(self)
        given: Any = n_trials
        if isinstance(given, bool) or not isinstance(given, Integral) or given < 1:
            raise ValueError(f"n_trials must be a whole number from 1, got {given!r}")
        random = np.random.default_rng([self.random_state, 1])
        _, values = self._compared
        n = len(self.measured_)
        if len(values) < n + 2:
            raise ValueError(
                f"n_bank must be at least {n + 2} to take {n} recordings out and compare them with the rest, "
                f"got {len(values)}"
            )
        alarms = 0
        for _ in range(n_trials):
            order = random.permutation(len(values))
            p = family_p(values[order[:n]], values[order[n:]], self.cells_, self.n_permutations, random)
            alarms += min(p.values()) <= self.alpha
        self.null_rate_ = alarms / n_trials
        return self.null_rate_

    def _alikeness(
        self, nuisance: NuisancePrior, trend: SpeedAndLoad, n_samples: int, with_tachometer: bool
    ) -> Float:
        """How alike recordings of one assembly are, cell by cell."""
        n_cells = len(self.cells_)
        if not self.one_assembly:
            return np.zeros(n_cells)
        if self.alike is not None:
            given = np.asarray(self.alike, dtype=float)
            if given.shape != (n_cells,):
                raise ValueError(f"alike must hold a share per cell: shape ({n_cells},), got {given.shape}")
            return given
        counts = sorted(set(self.bank_.counts.tolist()))
        n = _ASSEMBLIES * _PER_ASSEMBLY
        bank, values = self._simulated(nuisance, counts, n, n_samples, with_tachometer, _ASSEMBLIES)
        return alikeness(trend.without(self.centred(values, bank.counts)), bank.assemblies)

    def _simulated(
        self,
        nuisance: NuisancePrior,
        counts: list[int] | None,
        n: int,
        n_samples: int,
        with_tachometer: bool,
        n_assemblies: int | None = None,
    ) -> tuple[Bank, Float]:
        """Simulated recordings and their summaries."""
        return summarised_bank(
            self.simulator,
            nuisance,
            counts,
            sampling_rate=self.sampling_rate,
            input_speed_hz=self.input_speed_hz,
            with_tachometer=with_tachometer,
            cache=self.cache,
            n=n,
            n_samples=n_samples,
            n_assemblies=n_assemblies,
            random_state=self.random_state,
            n_jobs=self.n_jobs,
        )

    def _compare(self, measured: Float, simulated: Float) -> None:
        random = np.random.default_rng([self.random_state, 0])
        smallest = smallest_spreads(self.cells_)
        wider = widening(self.alike_, len(measured))
        statistics = Permuted(measured, simulated, self.n_permutations, random, smallest, wider)
        n_cells = len(self.cells_)
        rows: list[tuple[str, Row]] = []
        raw: dict[str, float] = {}
        for family, at in statistics_by_family(self.cells_).items():
            adjusted = statistics.step_down(at)
            raw[family] = float(adjusted.min())
            reach = statistics.largest_quantile(at, 1 - self.alpha)
            for k, p in zip(at, adjusted, strict=True):
                error = statistics.errors[k]
                row = Row(
                    cell=TOGETHER if family == TOGETHER.family else self.cells_[k % n_cells],
                    of="spread" if family == SPREADS else "mean",
                    effect=float(statistics.effects[k]),
                    low=float(statistics.effects[k] - reach * error),
                    high=float(statistics.effects[k] + reach * error),
                    p=float(p),
                    detectable=float((reach + _POWER_Z) * error),
                    spread=float(statistics.spreads[k]),
                )
                rows.append((family, row))
        self.family_p_ = holm(raw)
        across = {family: self.family_p_[family] / raw[family] for family in raw}
        self.table_ = [dataclasses.replace(row, p=min(row.p * across[family], 1.0)) for family, row in rows]
        self.verdict_ = self._verdict()
        self._compared = (measured, simulated)
        self._p_global = None

    def _verdict(self) -> str:
        if min(self.family_p_.values()) <= self.alpha:
            return "disagree"
        within = all(
            max(-row.low, row.high)
            <= (_EQUIVALENT_DB if row.cell.unit == "dB" else _EQUIVALENT_SPREADS * row.spread)
            for row in self.table_
            if row.of == "mean" and row.cell is not TOGETHER
        )
        return "equivalent" if within else "unresolved"
