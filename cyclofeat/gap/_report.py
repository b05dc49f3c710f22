"""How much of the gap a corrected simulator closes on recordings not used so far, against alternatives."""

from __future__ import annotations

import os
from collections.abc import Sequence
from numbers import Integral, Real
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.base import BaseEstimator
from sklearn.utils.validation import check_array, check_is_fitted, validate_data

from cyclofeat._sklearn import Interval, fit_context
from cyclofeat.gap import _distance as distance
from cyclofeat.gap._baselines import BASELINES, Alternative, Banks, FitData, Simulated
from cyclofeat.gap._comparison import AFTER, BEFORE, Simulation, compare
from cyclofeat.gap._null import Bank, NuisancePrior
from cyclofeat.gap._recordings import mean_speeds, per_recording, recordings_of, registered
from cyclofeat.simulators import CompositeSimulator, CycloidalGearbox, Rig

Float = NDArray[np.float64]


class GapReport(BaseEstimator):
    """How much of the gap does a corrected simulator close on recordings that it has not seen?

    Parameters
    ----------
    before, after : CompositeSimulator, Rig, CycloidalGearbox or None
        The simulator as it was and with what was found missing. None: paper B's gearbox.
    sampling_rate : float
        Samples per second in Hz.
    nuisance : NuisancePrior, optional
        What may differ without being a missing effect.
    input_speed_hz : float, default=500 / 60
        Nominal input speed.
    baselines : sequence of str, default=("nothing", "retuned", "equaliser", "gaussian_process")
        Alternatives fitted on the fit recordings: the simulator before; with stiffness and damping of its
        contacts retuned; behind an FIR equaliser with shaped noise; behind a Gaussian process of the spectrum
        over frequency and count. ``"nothing"`` is always compared.
    placebo : CompositeSimulator, optional
        A fitted wrong effect.
    oracle : CompositeSimulator, Rig or CycloidalGearbox, optional
        The truth, where it is known.
    n_bank : int, default=64
        Simulated recordings of each alternative, with the same seeds for all of them; at least 4 of each
        count.
    random_state : int, default=0
    n_jobs : int, default=1
        Worker processes of the simulations.
    cache : path, optional
        Folder in which simulated recordings are kept.

    Attributes
    ----------
    grr_ : float
        Gap reduction ratio of ``after`` on all held-out recordings: 1 closes the gap down to what
        replication leaves, 0 leaves it, below 0 widens it. NaN where undefined.
    grr_ci_ : tuple of float
        Its interval of 90 %.
    undefined_ : str
        Why it is undefined; empty where it is not.
    n_recordings_ : int
        Held-out recordings.
    distances_ : list of DistanceRow
    comparison_ : list of ComparisonRow
        Every alternative in every condition: ``"all"`` recordings, those of counts that occur among the fit
        recordings (``"seen"``) and those of counts that do not (``"unseen"``).
    beats_ : dict from str to dict from str to float
        Per alternative and condition the share of bootstrap draws in which ``after`` is nearer to the
        measurement; ties count half.
    n_features_in_ : int

    Notes
    -----
    Each recording is described by numbers in five families: log-spectrum (slow part, third octaves, floor),
    orders (speed, lines of lobes and of the shaft), synchronous averages, amplitudes (mean, level,
    Wasserstein distance of the standardised torque) and features. In each family

    D_f^2 = sum_k w_k (a_0k^2 + a_1k^2) / s_k^2

    over cells k, where a_0 and a_1 are the constant and the linear part over the counts of the difference
    between measured recordings and the simulated mean of their count, w_k gives every part of a family the
    same weight, and s_k is the spread of one measured recording around its count. D is the mean over
    families, and

    GRR = 1 - (D_after - D_floor) / (D_before - D_floor),

    D_floor from measured half against measured half, scaled to the numbers on both sides
    (``cyclofeat/gap/_distance.py`` states how, also where counts have one recording each). The ratio is
    undefined where D_before - D_floor is less than two standard errors, or with fewer than 4 recordings.
    Errors and intervals come from random half-samples of recordings within their counts, those of counts with
    fewer than 3 recordings within their condition, the same for all alternatives. With made-up summaries of
    4 to 24 recordings, intervals of nominally 90 % held the ratio in 77 to 97 % of cases, and 0 to 4 % of
    cases without a gap got a ratio; with simulated recordings 3 to 8 % of cases without a gap (6 or 8
    recordings of 4 to 6 counts), and 20 % with 6 recordings of two counts against a bank of 5 each, whose
    own error is in the floor but not in the standard error. Whether there is a gap is the locator's question.

    Examples
    --------
    >>> from cyclofeat.gap import NuisancePrior, make_bank
    >>> from cyclofeat.simulators import CompositeSimulator, Hum, Rig
    >>> rig = Rig.r1().replace(load_drift_nm=0.0, noise_nm=0.05)
    >>> truth = CompositeSimulator(rig, [Hum(1.0)])
    >>> options = {"n": 6, "n_samples": 11_520, "sampling_rate": 6400.0}
    >>> fit, hold = (make_bank(truth, NuisancePrior(), [0, 3], random_state=s, **options) for s in (7, 8))
    >>> report = GapReport(rig, truth, 6400.0, baselines=("nothing", "equaliser"), n_bank=12)
    >>> grr = report.fit(fit.X, y=fit.counts).score(hold.X, y=hold.counts)
    >>> grr > 0.7
    True
    """

    _parameter_constraints: ClassVar[dict[str, list[Any]]] = {
        "before": [CompositeSimulator, Rig, CycloidalGearbox, None],
        "after": [CompositeSimulator, Rig, CycloidalGearbox, None],
        "sampling_rate": [Interval(Real, 0, None, closed="neither")],
        "nuisance": [NuisancePrior, None],
        "input_speed_hz": [Interval(Real, 0, None, closed="neither")],
        "baselines": [tuple, list],
        "placebo": [CompositeSimulator, Rig, CycloidalGearbox, None],
        "oracle": [CompositeSimulator, Rig, CycloidalGearbox, None],
        "n_bank": [Interval(Integral, 10, None, closed="left")],
        "random_state": [Interval(Integral, 0, None, closed="left")],
        "n_jobs": [Integral],
        "cache": [str, os.PathLike, None],
    }

    def __init__(
        self,
        before: CompositeSimulator | Rig | CycloidalGearbox | None,
        after: CompositeSimulator | Rig | CycloidalGearbox | None,
        sampling_rate: float,
        nuisance: NuisancePrior | None = None,
        input_speed_hz: float = 500 / 60,
        baselines: Sequence[str] = ("nothing", "retuned", "equaliser", "gaussian_process"),
        placebo: CompositeSimulator | Rig | CycloidalGearbox | None = None,
        oracle: CompositeSimulator | Rig | CycloidalGearbox | None = None,
        n_bank: int = 64,
        random_state: int = 0,
        n_jobs: int = 1,
        cache: str | os.PathLike[str] | None = None,
    ) -> None:
        self.before = before
        self.after = after
        self.sampling_rate = sampling_rate
        self.nuisance = nuisance
        self.input_speed_hz = input_speed_hz
        self.baselines = baselines
        self.placebo = placebo
        self.oracle = oracle
        self.n_bank = n_bank
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
        """Fit what the alternatives need, on the fit recordings.

        Parameters
        ----------
        X : array-like, shape (n_windows, n_samples)
            Measured torque in Nm, at least one output turn per window.
        y : array-like of int, shape (n_windows,), optional
            Known counts of worn lobes.
        groups : array-like, shape (n_windows,), optional
            Recording of each window. Default: each window is a recording of its own.
        angle : array-like, shape (n_windows, n_samples), optional
            Angle of the input shaft in rad.

        Returns
        -------
        self

        Raises
        ------
        ValueError
            If ``baselines`` names an unknown one, windows are too short, a recording has two counts, or
            ``y``, ``groups`` or ``angle`` do not belong to ``X``.
        """
        windows = validate_data(self, X, dtype=[np.float64, np.float32])
        unknown = [name for name in self.baselines if name not in BASELINES]
        if unknown:
            raise ValueError(f"baselines must be of {', '.join(BASELINES)}, got {unknown[0]!r}")
        data = self._registered(windows, y, groups, angle)
        banks = self._banks()
        names = [BEFORE, *(name for name in self.baselines if name != BEFORE)]
        self.alternatives_: dict[str, Alternative] = {AFTER: Simulated(self.after)}
        for name in names:
            self.alternatives_[name] = BASELINES[name](self.before).fit(data, banks, self.random_state)
        if self.placebo is not None:
            self.alternatives_["placebo"] = Simulated(self.placebo)
        if self.oracle is not None:
            self.alternatives_["oracle"] = Simulated(self.oracle)
        self.fit_counts_ = None if data.counts is None else np.unique(data.counts)
        return self

    def score(
        self,
        X: ArrayLike,
        y: ArrayLike | None = None,
        groups: ArrayLike | None = None,
        angle: ArrayLike | None = None,
    ) -> float:
        """Gap reduction ratio on held-out recordings.

        Parameters
        ----------
        X : array-like, shape (n_windows, n_samples)
            Torque in Nm of recordings not used so far; their length may be another.
        y, groups, angle
            As in :meth:`fit`.

        Returns
        -------
        float
            ``grr_``; NaN where it is undefined.

        Raises
        ------
        ValueError
            As :meth:`fit`, or if counts were known in fitting and are not here, or the other way round.
        """
        check_is_fitted(self)
        data = self._registered(check_array(X, dtype=[np.float64, np.float32]), y, groups, angle)
        if (data.counts is None) != (self.fit_counts_ is None):
            known = "fit" if data.counts is None else "score"
            raise ValueError(f"y must be given to both fit and score or to neither, got it in {known} only")
        wanted = None if data.counts is None else np.unique(data.counts).tolist()
        banks = self._banks()
        simulated: dict[str, Simulation] = {}
        speeds = None
        if data.angle is not None:
            speeds = mean_speeds(data.angle, data.windows.shape, self.sampling_rate)
        n_lobes = self._n_lobes()
        values, parts = distance.describe(
            data.windows, self.sampling_rate, self.input_speed_hz, n_lobes, speeds
        )
        measured = per_recording(values, data.of_window)
        # Other seeds than in fitting: what an alternative has learnt of single simulations is no use to it.
        seed = self.random_state + 1
        for name, alternative in self.alternatives_.items():
            bank = alternative.records(banks, wanted, data.windows.shape[1], seed)
            missing = [] if wanted is None else sorted(set(wanted) - set(bank.counts.tolist()))
            if missing:
                raise ValueError(
                    f"n_bank must be larger: of {name!r} every simulation of {missing[0]} worn lobes failed"
                )
            simulated[name] = self._simulation(bank, n_lobes, speeds is not None, data.counts is not None)
        counts, seen = np.zeros(len(measured), dtype=np.int64), None
        if data.counts is not None:
            assert self.fit_counts_ is not None
            counts, seen = data.counts, np.isin(data.counts, self.fit_counts_)
        self.n_recordings_ = len(measured)
        scored = compare(measured, counts, simulated, parts, seen, random_state=self.random_state)
        self.distances_, self.comparison_, self.beats_ = scored.distances, scored.comparison, scored.beats
        row = next(r for r in scored.comparison if (r.alternative, r.condition) == (AFTER, "all"))
        self.grr_, self.grr_ci_, self.undefined_ = row.grr, (row.low, row.high), row.undefined
        return self.grr_

    def _simulation(self, bank: Bank, n_lobes: int, with_speeds: bool, with_counts: bool) -> Simulation:
        speeds = bank.speeds * self.sampling_rate if with_speeds else None
        values, _ = distance.describe(bank.X, self.sampling_rate, self.input_speed_hz, n_lobes, speeds)
        return Simulation(values, bank.counts if with_counts else np.zeros(len(values), dtype=np.int64))

    def _registered(
        self, windows: NDArray[Any], y: ArrayLike | None, groups: ArrayLike | None, angle: ArrayLike | None
    ) -> FitData:
        of_window, counts = recordings_of(len(windows), y, groups)
        angles = None
        if angle is not None:
            mean_speeds(angle, windows.shape, self.sampling_rate)
            angles = np.asarray(angle, dtype=float)
        # In the precision of the bank.
        cut = registered(windows.astype(np.float32), self.sampling_rate, self.input_speed_hz, self._n_lobes())
        return FitData(cut, of_window, counts, None if angles is None else angles[:, : cut.shape[1]])

    def _prior(self) -> NuisancePrior:
        return NuisancePrior() if self.nuisance is None else self.nuisance

    def _n_lobes(self) -> int:
        return self._prior().n_lobes(self.before, self.input_speed_hz)

    def _banks(self) -> Banks:
        return Banks(
            self._prior(), self.sampling_rate, self.input_speed_hz, self.n_bank, self.n_jobs, self.cache
        )
