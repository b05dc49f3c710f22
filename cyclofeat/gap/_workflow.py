"""The four stages in one: where, what, how large, how much better."""

from __future__ import annotations

import copy
import os
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from numbers import Integral, Real
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.base import BaseEstimator, clone
from sklearn.utils.validation import check_array, check_is_fitted

from cyclofeat._sklearn import Interval, fit_context
from cyclofeat.gap._cached_fit import cached_fit
from cyclofeat.gap._doubts import doubts_about
from cyclofeat.gap._fitter import EffectFitter
from cyclofeat.gap._held_out import check_held_out
from cyclofeat.gap._locator import GapLocator
from cyclofeat.gap._null import NuisancePrior, as_composite, make_bank
from cyclofeat.gap._ranker import EffectRanker, Ranked
from cyclofeat.gap._recordings import mixed
from cyclofeat.gap._report import GapReport
from cyclofeat.gap._result import result_of
from cyclofeat.simulators import CompositeSimulator, CycloidalGearbox, Effect, Rig, SimulationFailed

Float = NDArray[np.float64]
Progress = Callable[[str], None]

_FEW_HELD_OUT = 10  # below which the range of the gap reduction ratio is itself uncertain
_SURE = 0.98  # probability from which no other candidate is fitted
_LIKELY = 0.7  # probability from which others are fitted only if it fits badly
_NEGLIGIBLE = 0.03  # probability below which a candidate is not fitted
# How much a unit of the fit's mean square counts against the ranker's odds.
_EVIDENCE = 4.0
_PLACEBO_SIMS = 100
_STARTS = 3  # places from which a fit is searched
_EXPLAINED = 0.75  # share of the loss to which a second effect has to bring it
# Loss from which even the best effects leave too much to be the whole truth, and from which they do so
# where the ranker has not seen such a case either.
_UNEXPLAINED, _DOUBTFUL = 2.5, 1.6


@dataclass(frozen=True)
class Candidate:
    """An explanation that was fitted.

    Attributes
    ----------
    names : tuple of str
        Its effects.
    probability : float
        Among the candidates.
    fitter : EffectFitter
    """

    names: tuple[str, ...]
    probability: float
    fitter: EffectFitter


@dataclass(frozen=True)
class _Proposal:
    """An explanation before it is fitted: its probability, and places to search from."""

    probability: float
    starts: list[tuple[Effect, ...]]

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(effect.effect_id for effect in self.starts[0])


class DiscrepancyWorkflow(BaseEstimator):
    """Where do model and measurement disagree, what is missing, how large is it, and is the model better?

    Parameters
    ----------
    sampling_rate : float
        Samples per second in Hz.
    simulator : CompositeSimulator, Rig or CycloidalGearbox, optional
        The model. Default: paper B's gearbox.
    nuisance : NuisancePrior, optional
        What may differ without being a missing effect; a rig's own spread is not taken by itself:
        ``NuisancePrior(tolerances=rig.tolerances)``.
    input_speed_hz : float, default=500 / 60
        Nominal input speed.
    alpha : float, default=0.03
        Chance of a false "disagree".
    one_assembly : bool, default=False
        Whether the measured recordings are all of one assembly (:class:`GapLocator`).
    library : sequence of str, optional
        Effects that are considered. Default: all of :func:`cyclofeat.simulators.effect_library` that fit the
        model.
    ranker : EffectRanker, optional
        For the same model, prior, rate and window length; one that has been fitted is shared by several sets
        of recordings. Default: one is made for ``library``.
    max_effects : {1, 2}, default=2
    n_candidates : int, default=2
        Explanations that are fitted before one is chosen; look-alikes count as one.
    baselines : sequence of str
        What the corrected model is compared with (:class:`GapReport`).
    with_placebo : bool, default=True
        Whether the best wrong effect outside the group of look-alikes is compared too.
    oracle : CompositeSimulator, Rig or CycloidalGearbox, optional
        The truth, where it is known (in a benchmark): compared in the last stage, and never looked at before.
    n_bank : int, default=200
        Simulated recordings of a comparison.
    n_after : int, default=96
        The same for the corrected model.
    n_report : int, default=64
        Simulated recordings of each alternative on the recordings held out.
    n_draws, n_null : int, default=60 and 160
        Size of the ranker's table (:class:`EffectRanker`).
    n_sims : int, default=400
        Simulated recordings for the search of a fit (:class:`EffectFitter`).
    n_interval : int, default=144
        Simulated recordings for its intervals.
    n_permutations : int, default=999
    random_state : int, default=0
    n_jobs : int, default=1
    cache : path, optional
        Folder for banks, table and fits: an interrupted run goes on from there.
    progress : callable, optional
        Told of each step in a word.

    Attributes
    ----------
    locator_ : GapLocator
        Measurement against the model as it was.
    ranker_ : EffectRanker or None
        None where nothing was found that disagrees.
    candidates_ : list of Candidate
        Explanations that were fitted, the chosen one first.
    fitter_ : EffectFitter or None
        The chosen one.
    locator_after_ : GapLocator or None
        Measurement against the corrected model, on the same recordings.
    report_ : GapReport or None
        On the recordings held out; None where there are none, or nothing was added.
    effects_ : tuple of Effect
        What was added.
    simulator_ : CompositeSimulator
        The corrected model; the model as it was where nothing was added.
    result_ : dict
        What ``cyclofeat gap --json`` prints.
    warnings_ : list of str

    Notes
    -----
    Recordings held out are not looked at before the last stage. The probability of an explanation is the
    ranker's, weighted by exp(-c loss) with the loss of its fit; it is conditional on the library.

    Examples
    --------
    >>> from cyclofeat.gap import make_bank
    >>> from cyclofeat.simulators import Hum
    >>> truth = CompositeSimulator(effects=[Hum(0.3)])
    >>> fit, hold = (make_bank(truth, NuisancePrior(), [0, 3], n=4, random_state=s) for s in (5, 6))
    >>> workflow = DiscrepancyWorkflow(
    ...     25_600, library=["hum", "offset"], n_bank=24, n_after=24, n_draws=8, n_null=16,
    ...     n_permutations=499, baselines=("nothing",), with_placebo=False,
    ... )  # fmt: skip
    >>> workflow.fit(fit.X, hold.X, y_fit=fit.counts, y_hold=hold.counts)  # doctest: +SKIP
    >>> workflow.result_["effects"][0]["id"]  # some minutes later  # doctest: +SKIP
    'hum'
    """

    _parameter_constraints: ClassVar[dict[str, list[Any]]] = {
        "sampling_rate": [Interval(Real, 0, None, closed="neither")],
        "simulator": [CompositeSimulator, Rig, CycloidalGearbox, None],
        "nuisance": [NuisancePrior, None],
        "input_speed_hz": [Interval(Real, 0, None, closed="neither")],
        "alpha": [Interval(Real, 0, 1, closed="neither")],
        "one_assembly": ["boolean"],
        "library": [list, tuple, None],
        "ranker": [EffectRanker, None],
        "max_effects": [Interval(Integral, 1, 2, closed="both")],
        "n_candidates": [Interval(Integral, 1, None, closed="left")],
        "baselines": [list, tuple],
        "with_placebo": ["boolean"],
        "n_bank": [Interval(Integral, 10, None, closed="left")],
        "n_after": [Interval(Integral, 10, None, closed="left")],
        "n_report": [Interval(Integral, 10, None, closed="left")],
        "oracle": [CompositeSimulator, Rig, CycloidalGearbox, None],
        "n_draws": [Interval(Integral, 5, None, closed="left")],
        "n_null": [Interval(Integral, 16, None, closed="left")],
        "n_sims": [Interval(Integral, 1, None, closed="left")],
        "n_interval": [Interval(Integral, 0, None, closed="left")],
        "n_permutations": [Interval(Integral, 19, None, closed="left")],
        "random_state": [Interval(Integral, 0, None, closed="left")],
        "n_jobs": [Integral],
        "cache": [str, os.PathLike, None],
        "progress": [callable, None],
    }

    def __init__(
        self,
        sampling_rate: float,
        simulator: CompositeSimulator | Rig | CycloidalGearbox | None = None,
        nuisance: NuisancePrior | None = None,
        input_speed_hz: float = 500 / 60,
        alpha: float = 0.03,
        one_assembly: bool = False,
        library: Sequence[str] | None = None,
        ranker: EffectRanker | None = None,
        max_effects: int = 2,
        n_candidates: int = 2,
        baselines: Sequence[str] = ("nothing", "retuned", "equaliser", "gaussian_process"),
        with_placebo: bool = True,
        oracle: CompositeSimulator | Rig | CycloidalGearbox | None = None,
        n_bank: int = 200,
        n_after: int = 96,
        n_report: int = 64,
        n_draws: int = 60,
        n_null: int = 160,
        n_sims: int = 400,
        n_interval: int = 144,
        n_permutations: int = 999,
        random_state: int = 0,
        n_jobs: int = 1,
        cache: str | os.PathLike[str] | None = None,
        progress: Progress | None = None,
    ) -> None:
        self.sampling_rate = sampling_rate
        self.simulator = simulator
        self.nuisance = nuisance
        self.input_speed_hz = input_speed_hz
        self.alpha = alpha
        self.one_assembly = one_assembly
        self.library = library
        self.ranker = ranker
        self.max_effects = max_effects
        self.n_candidates = n_candidates
        self.baselines = baselines
        self.with_placebo = with_placebo
        self.oracle = oracle
        self.n_bank = n_bank
        self.n_after = n_after
        self.n_report = n_report
        self.n_draws = n_draws
        self.n_null = n_null
        self.n_sims = n_sims
        self.n_interval = n_interval
        self.n_permutations = n_permutations
        self.random_state = random_state
        self.n_jobs = n_jobs
        self.cache = cache
        self.progress = progress

    @fit_context(prefer_skip_nested_validation=True)
    def fit(
        self,
        X_fit: ArrayLike,
        X_hold: ArrayLike | None = None,
        *,
        y_fit: ArrayLike | None = None,
        y_hold: ArrayLike | None = None,
        groups_fit: ArrayLike | None = None,
        groups_hold: ArrayLike | None = None,
        angle_fit: ArrayLike | None = None,
        angle_hold: ArrayLike | None = None,
    ) -> Self:
        """Run the stages.

        Parameters
        ----------
        X_fit : array-like, shape (n_windows, n_samples)
            Measured torque in Nm, at least one output turn per window.
        X_hold : array-like, shape (n_windows, n_samples), optional
            Other recordings, on which the corrected model is judged.
        y_fit, y_hold : array-like of int, shape (n_windows,), optional
            Known counts of worn lobes.
        groups_fit, groups_hold : array-like, shape (n_windows,), optional
            Recording of each window. Default: each window is a recording of its own.
        angle_fit, angle_hold : array-like, shape (n_windows, n_samples), optional
            Angle of the input shaft in rad, by a tachometer.

        Returns
        -------
        self

        Raises
        ------
        ValueError
            As the stages raise it. The shape of ``X_hold`` and what goes with it are checked before the first
            stage; its values are read in the last one alone.
        """
        began = time.monotonic()
        data = {"y": y_fit, "groups": groups_fit, "angle": angle_fit}
        held = {"y": y_hold, "groups": groups_hold, "angle": angle_hold}
        windows = check_array(X_fit, dtype=[np.float64, np.float32], input_name="X_fit")
        self.warnings_ = doubts_about(windows, y_fit, groups_fit, angle_fit)
        if X_hold is not None:
            check_held_out(
                X_hold,
                **held,
                with_counts=y_fit is not None,
                sampling_rate=self.sampling_rate,
                input_speed_hz=self.input_speed_hz,
                n_lobes=(self.nuisance or NuisancePrior()).n_lobes(self.simulator, self.input_speed_hz),
            )
        self._begin()
        self._say("comparing measurement and model")
        self.locator_ = self._locator(self.simulator, self.n_bank).fit(windows, **data)
        if self.locator_.left_out_:
            self.warnings_.append(
                f"not compared, as this rate or gearbox leaves nothing to tell them by: "
                f"{'; '.join(self.locator_.left_out_)}"
            )
        if self.locator_.bank_.n_failed:
            self.warnings_.append(f"{self.locator_.bank_.n_failed} simulations of the model itself failed")
        if self.locator_.verdict_ == "disagree":
            self._name(windows, data)
        if self.fitter_ is not None and X_hold is not None:
            self._say("judging on recordings held out")
            self._judge(windows, data, X_hold, held)
        self.seconds_ = time.monotonic() - began
        self.result_ = result_of(self)
        return self

    def prepare(self, counts: Sequence[int] | None, n_samples: int) -> EffectRanker:
        """Simulate what does not depend on the recordings, and keep it in the cache.

        Parameters
        ----------
        counts : sequence of int or None
            Counts of worn lobes of the recordings to come; None where they are not known.
        n_samples : int
            Length of their windows.

        Returns
        -------
        EffectRanker
            Fitted; may be given to other workflows as ``ranker``.
        """
        make_bank(
            self.simulator,
            NuisancePrior() if self.nuisance is None else self.nuisance,
            None if counts is None else mixed(np.asarray(counts), self.n_bank),
            n=self.n_bank,
            n_samples=n_samples,
            sampling_rate=self.sampling_rate,
            random_state=self.random_state,
            n_jobs=self.n_jobs,
            cache=self.cache,
        )
        return self._fitted_ranker(n_samples)

    def to_html(self, path: str | os.PathLike[str], **options: Any) -> Path:
        """Write the report that a test engineer reads.

        Parameters
        ----------
        path : path
            File to write.
        **options
            Fields of :class:`cyclofeat.report.GapFindings` that the workflow does not know: ``sources``,
            ``title``, ``settings``.

        Returns
        -------
        Path
        """
        from cyclofeat.report import GapFindings, write_gap_report

        check_is_fitted(self)
        fitter = self.fitter_
        settings = {
            "sampling rate": f"{self.sampling_rate:g} Hz",
            "nominal input speed": f"{self.input_speed_hz * 60:g} RPM",
            "seed": self.random_state,
            **options.pop("settings", {}),
        }
        return write_gap_report(
            path,
            GapFindings(
                result=self.result_,
                locator=self.locator_,
                locator_after=self.locator_after_,
                report=self.report_,
                effects=self.effects_,
                theta={} if fitter is None else fitter.theta_,
                theta_ci={} if fitter is None else fitter.theta_ci_,
                identifiable={} if fitter is None else fitter.identifiable_,
                at_bound={} if fitter is None else fitter.at_bound_,
                settings=settings,
                seconds=self.seconds_,
                **options,
            ),
        )

    def _begin(self) -> None:
        """Nothing found yet."""
        self.ranker_: EffectRanker | None = None
        self.candidates_: list[Candidate] = []
        self.fitter_: EffectFitter | None = None
        self.locator_after_: GapLocator | None = None
        self.report_: GapReport | None = None
        self.effects_: tuple[Effect, ...] = ()
        self.simulator_ = as_composite(self.simulator)
        self.unknown_ = False

    def _say(self, text: str) -> None:
        if self.progress is not None:
            self.progress(text)

    def _common(self) -> dict[str, Any]:
        return {
            "nuisance": self.nuisance,
            "input_speed_hz": self.input_speed_hz,
            "random_state": self.random_state,
            "n_jobs": self.n_jobs,
            "cache": self.cache,
        }

    def _locator(self, simulator: Any, n_bank: int, alike: Float | None = None) -> GapLocator:
        return GapLocator(
            self.sampling_rate,
            simulator,
            alpha=self.alpha,
            n_bank=n_bank,
            one_assembly=self.one_assembly,
            alike=alike,
            n_permutations=self.n_permutations,
            **self._common(),
        )

    def _fitted_ranker(self, n_samples: int) -> EffectRanker:
        if self.ranker is not None:
            fitted = hasattr(self.ranker, "table_")
            return copy.copy(self.ranker) if fitted else clone(self.ranker).fit()  # its ranking is set anew
        ranker = EffectRanker(
            self.sampling_rate,
            self.simulator,
            library=self.library,
            duration_s=n_samples / self.sampling_rate,
            n_draws=self.n_draws,
            n_null=self.n_null,
            **self._common(),
        )
        ranker.fit()
        return ranker

    def _name(self, windows: NDArray[Any], data: dict[str, Any]) -> None:
        """Name, fit and add what is missing."""
        self._say("naming what is missing")
        self.ranker_ = self._fitted_ranker(windows.shape[1])
        if self.ranker_.left_out_:
            self.warnings_.append(
                f"this model cannot have {', '.join(self.ranker_.left_out_)} at this rate: not considered"
            )
        if self.ranker_.table_.n_failed:
            self.warnings_.append(
                f"{self.ranker_.table_.n_failed} simulations of the table of effects failed and are left out"
            )
        self.candidates_ = self._fitted(self._singles(self.ranker_.rank(self.locator_)), windows, data)
        if not self.candidates_:
            self.unknown_ = True
            self.warnings_.append("no candidate could be fitted: its simulations fail")
            return
        first = self.candidates_[0]
        self._take(first, windows, data)
        assert self.locator_after_ is not None
        unexplained = self.locator_after_.verdict_ == "disagree" or first.fitter.loss_ > _UNEXPLAINED
        others = len(self.ranker_.classes_) > 1
        if self.max_effects > 1 and others and unexplained:
            self._say("looking for a second effect")
            pairs = self._fitted(self._pairs(first), windows, data)
            pairs = [pair for pair in pairs if _both_told(pair.fitter) or _needed(pair.fitter, first.fitter)]
            if pairs and pairs[0].fitter.loss_ < _EXPLAINED * first.fitter.loss_:
                self._take(pairs[0], windows, data)
                self.candidates_ = [pairs[0], *self.candidates_]
        loss = self.candidates_[0].fitter.loss_
        self.unknown_ = loss > _UNEXPLAINED or (self.ranker_.unknown_ and loss > _DOUBTFUL)

    def _singles(self, ranking: list[Ranked]) -> list[_Proposal]:
        """The most probable effects, of look-alikes one."""
        assert self.ranker_ is not None
        found: list[_Proposal] = []
        seen: set[str] = set()
        for row in ranking:
            if row.effect_id in seen:
                continue
            if found and (len(found) >= self.n_candidates or row.probability < _NEGLIGIBLE):
                break
            seen |= {row.effect_id, *row.look_alikes}
            starts = self.ranker_.nearest(row.effect_id, self.locator_, _STARTS)
            found.append(_Proposal(row.probability, [(start,) for start in starts]))
            if row.probability >= _SURE:
                break
        return found

    def _pairs(self, first: Candidate) -> list[_Proposal]:
        """The first effect with what its remainder looks like, and the pairs that look like all of it."""
        assert self.ranker_ is not None
        assert self.locator_after_ is not None
        ranked = self.ranker_.nearest_pairs(self.locator_)
        found = {frozenset(pair.names): [pair.effects] for pair in ranked[: self.n_candidates]}
        rest = copy.copy(self.ranker_).rank(self.locator_after_, without=first.names)[0]
        names = frozenset({*first.names, rest.effect_id})
        if names not in found:
            starts = self.ranker_.nearest(rest.effect_id, self.locator_after_, _STARTS)
            found[names] = [(*first.fitter.effects_, start) for start in starts]
        # Distances say what is worth a fit; among those that are fitted, fits decide.
        chosen = [pair for pair in ranked if frozenset(pair.names) in found]
        total = sum(pair.probability for pair in chosen)
        return [_Proposal(pair.probability / total, found[frozenset(pair.names)]) for pair in chosen]

    def _fitted(
        self, proposals: list[_Proposal], windows: NDArray[Any], data: dict[str, Any]
    ) -> list[Candidate]:
        """Proposals with their sizes; the most probable first, by odds and fit."""
        found = []
        for proposal in proposals:
            self._say(f"fitting {' and '.join(proposal.names)}")
            try:
                fitter = self._fit_effects(proposal.starts, windows, data, self.n_sims, self.n_interval)
            except SimulationFailed as failure:
                self.warnings_.append(f"{' and '.join(proposal.names)} could not be fitted: {failure}")
                continue
            found.append((proposal, fitter))
            # One that is likely and fits leaves nothing for others to explain.
            if proposal.probability >= _LIKELY and fitter.loss_ < _DOUBTFUL:
                break
        if not found:
            return []
        losses = np.array([fitter.loss_ for _, fitter in found])
        odds = np.array([proposal.probability for proposal, _ in found])
        weights = odds * np.exp(-_EVIDENCE * (losses - losses.min()))
        # What was not fitted keeps its share.
        weights = weights / weights.sum() * odds.sum()
        return [Candidate(found[k][0].names, float(weights[k]), found[k][1]) for k in np.argsort(-weights)]

    def _fit_effects(
        self,
        starts: list[tuple[Effect, ...]],
        windows: NDArray[Any],
        data: dict[str, Any],
        n_sims: int,
        n_interval: int,
    ) -> EffectFitter:
        fitter = EffectFitter(
            starts[0],
            self.sampling_rate,
            self.simulator,
            starts=starts[1:],
            n_sims=n_sims,
            n_interval=n_interval,
            **self._common(),
        )
        return cached_fit(fitter, windows, data, self.cache)

    def _take(self, candidate: Candidate, windows: NDArray[Any], data: dict[str, Any]) -> None:
        self.fitter_ = candidate.fitter
        self.effects_ = candidate.fitter.effects_
        self.simulator_ = candidate.fitter.simulator_
        self._say("comparing measurement and corrected model")
        after = self._locator(self.simulator_, self.n_after, self.locator_.alike_)
        self.locator_after_ = after.fit(windows, **data)

    def _judge(
        self, windows: NDArray[Any], data: dict[str, Any], X_hold: ArrayLike, hold: dict[str, Any]
    ) -> None:
        placebo = self._placebo(windows, data) if self.with_placebo else None
        self.report_ = GapReport(
            self.simulator,
            self.simulator_,
            self.sampling_rate,
            baselines=tuple(self.baselines),
            placebo=placebo,
            oracle=self.oracle,
            n_bank=self.n_report,
            **self._common(),
        )
        self.report_.fit(windows, **data).score(X_hold, **hold)
        n = self.report_.n_recordings_
        if n < _FEW_HELD_OUT:
            self.warnings_.append(
                f"only {n} recording{'' if n == 1 else 's'} held out: the share of the gap that closed is "
                f"uncertain, and with fewer than {_FEW_HELD_OUT} its range may be too narrow"
            )

    def _placebo(self, windows: NDArray[Any], data: dict[str, Any]) -> CompositeSimulator | None:
        """The most probable wrong explanation by one effect, fitted."""
        assert self.ranker_ is not None
        named = {effect.effect_id for effect in self.effects_}
        alike = {
            other for row in self.ranker_.ranking_ if row.effect_id in named for other in row.look_alikes
        }
        for candidate in self.candidates_[1:]:
            if not named & set(candidate.names) and not alike & set(candidate.names):
                return candidate.fitter.simulator_
        for row in self.ranker_.ranking_:
            if row.effect_id not in named | alike:
                self._say(f"fitting {row.effect_id} as a placebo")
                starts = self.ranker_.nearest(row.effect_id, self.locator_, _STARTS)
                try:
                    return self._fit_effects(
                        [(start,) for start in starts], windows, data, _PLACEBO_SIMS, n_interval=0
                    ).simulator_
                except SimulationFailed:
                    continue
        return None


def _needed(pair: EffectFitter, single: EffectFitter) -> bool:
    """Whether two effects explain what one cannot, be the second's size ever so uncertain."""
    return single.loss_ > _UNEXPLAINED and pair.loss_ < _DOUBTFUL


def _both_told(fitter: EffectFitter) -> bool:
    """Whether the recordings tell a parameter of every effect."""
    told = {name.partition(".")[0] for name, yes in fitter.identifiable_.items() if yes}
    return all(effect.effect_id in told for effect in fitter.effects_)
