"""The four stages in one: where, what, how large, how much better."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from sklearn.utils.validation import check_array

from cyclofeat.gap._doubts import doubts_about
from cyclofeat.gap._result import EffectProbability, GapResult
from cyclofeat.gap._settings import GapSettings, Windows, checked
from cyclofeat.gap._where import where_of
from cyclofeat.gap.comparison import Comparison
from cyclofeat.gap.proof import Proof, check_held_out, prove
from cyclofeat.gap.size import FittedEffects, fit_effects
from cyclofeat.gap.summaries import mixed
from cyclofeat.gap.what import EffectRanker, Ranking, learn_effects
from cyclofeat.gap.where import LocatedGap, locate
from cyclofeat.simulators import Effect, Rig, SimulationFailed

Progress = Callable[[str], None]
Starts = list[tuple[Effect, ...]]

_FEW_HELD_OUT = 10  # recordings below which the range of the gap reduction ratio is itself uncertain
_SURE = 0.98  # probability from which no further candidate is fitted
_LIKELY = 0.7  # probability from which further candidates are fitted only if this one fits badly
_NEGLIGIBLE = 0.03  # probability below which a candidate is not fitted
_EVIDENCE = 4.0  # odds are multiplied by exp(-_EVIDENCE * loss of the fit)
_PLACEBO_SIMS = 100
_STARTS = 3  # places from which a fit is searched
_EXPLAINED = 0.75  # a second effect must reduce the loss to this share
# Loss above which the disagreement counts as unexplained, and the lower limit that applies if the ranker
# calls the disagreement unknown.
_UNEXPLAINED, _DOUBTFUL = 2.5, 1.6


@dataclass(frozen=True)
class Candidate:
    """Fitted explanation and its probability among all candidates."""

    names: tuple[str, ...]
    probability: float
    fitted: FittedEffects


@dataclass(frozen=True)
class _Proposal:
    """Explanation to be fitted: its probability, and the starts of the search."""

    probability: float
    starts: Starts

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(effect.effect_id for effect in self.starts[0])


def find_gap(
    comparison: Comparison,
    measured: Windows | ArrayLike,
    held_out: Windows | ArrayLike | None = None,
    *,
    settings: GapSettings | None = None,
    ranker: EffectRanker | None = None,
    progress: Progress | None = None,
) -> GapResult:
    """Compare a model with recordings, name what is missing, fit it, add it, and judge the corrected model.

    Parameters
    ----------
    comparison : Comparison
        The model, what may differ anyway, and how simulations are made.
    measured : Windows or array-like, shape (n_windows, n_samples)
        Recordings to compare and to fit.
    held_out : Windows or array-like, optional
        Other recordings, on which the corrected model is judged. Their values are read in the last stage
        only.
    settings : GapSettings, optional
    ranker : EffectRanker, optional
        For the same comparison (:func:`prepare_ranker`), shared by several sets of recordings. Default: one
        is made for ``settings.library``.
    progress : callable, optional
        Called with the name of each step.

    Returns
    -------
    GapResult

    Raises
    ------
    ValueError
        If recordings, settings or what is held out do not fit together.

    Notes
    -----
    The probability of an explanation is the ranker's, weighted by exp(-c loss) with the loss of its fit; it
    is conditional on the library.

    Examples
    --------
    >>> from cyclofeat.simulators import Hum
    >>> comparison = Comparison(sampling_rate=25_600.0)
    >>> truth = comparison.replace(rig=Rig(effects=[Hum(0.3)]))
    >>> fit, hold = (truth.bank(4, [0, 3], random_state=state) for state in (5, 6))
    >>> result = find_gap(
    ...     comparison, Windows(fit.X, fit.counts), Windows(hold.X, hold.counts),
    ...     settings=GapSettings(library=["hum", "offset"], baselines=("nothing",), with_placebo=False),
    ... )  # doctest: +SKIP
    >>> result.effects[0].effect_id  # some minutes later  # doctest: +SKIP
    'hum'
    """
    began = time.monotonic()
    settings = GapSettings() if settings is None else settings
    measured = measured if isinstance(measured, Windows) else Windows(measured)
    held_out = held_out if held_out is None or isinstance(held_out, Windows) else Windows(held_out)
    X = check_array(measured.X, dtype=[np.float64, np.float32], input_name="X")
    measured = Windows(X, **measured.data)
    if held_out is not None:
        check_held_out(comparison.conditions, held_out.X, **held_out.data, with_counts=measured.y is not None)
    search = _Search(comparison, settings, measured, progress or (lambda _: None))
    search.compare()
    if search.before.verdict == "disagree" and settings.max_effects:
        search.name(ranker)
    proof = search.judge(held_out) if search.chosen is not None and held_out is not None else None
    return search.result(proof, time.monotonic() - began)


def prepare_ranker(
    comparison: Comparison, counts: Sequence[int] | None, settings: GapSettings | None = None
) -> EffectRanker:
    """Simulate everything that does not depend on the recordings, and store it in the cache.

    Parameters
    ----------
    comparison : Comparison
    counts : sequence of int or None
        Counts of worn lobes of the recordings to come; None if they are not known.
    settings : GapSettings, optional

    Returns
    -------
    EffectRanker
        For :func:`find_gap`.
    """
    settings = GapSettings() if settings is None else settings
    comparison.bank(
        comparison.n_bank, None if counts is None else mixed(np.asarray(counts), comparison.n_bank)
    )
    return learn_effects(
        comparison, library=settings.library, n_draws=settings.n_draws, n_null=settings.n_null
    )


class _Search:
    """The four stages for one set of recordings, and what they share."""

    before: LocatedGap
    ranker: EffectRanker
    ranking: Ranking

    def __init__(
        self, comparison: Comparison, settings: GapSettings, windows: Windows, say: Progress
    ) -> None:
        self.comparison, self.measured = checked(comparison, windows)
        self.windows, self.settings, self.say = windows, settings, say
        self.warnings = doubts_about(np.asarray(windows.X), **windows.data)
        self.candidates: list[Candidate] = []
        self.after: LocatedGap | None = None
        self.unknown = False

    @property
    def chosen(self) -> FittedEffects | None:
        return self.candidates[0].fitted if self.candidates else None

    @property
    def corrected(self) -> Rig:
        rig: Rig = self.comparison.rig if self.chosen is None else self.chosen.rig
        return rig

    def compare(self) -> None:
        """Compare the recordings with the model as it was."""
        self.say("comparing measurement and model")
        self.before = self._located(self.comparison)
        if self.before.not_compared:
            self.warnings.append(
                f"not compared, because this rate or gearbox does not allow it: "
                f"{'; '.join(self.before.not_compared)}"
            )
        if self.before.bank.n_failed:
            self.warnings.append(f"{self.before.bank.n_failed} simulations of the model itself failed")

    def name(self, ranker: EffectRanker | None) -> None:
        """Name and fit the missing effects."""
        self.say("naming what is missing")
        self.ranker = ranker or learn_effects(
            self.comparison, library=self.settings.library, n_draws=self.settings.n_draws,
            n_null=self.settings.n_null,
        )  # fmt: skip
        self.warnings += not_considered(self.ranker.in_model, self.ranker.unavailable)
        if self.ranker.table.n_failed:
            self.warnings.append(
                f"{self.ranker.table.n_failed} simulations of the table of effects failed and are left out"
            )
        self.ranking = self.ranker.rank(self.before)
        self.candidates = self._fitted(self._singles())
        if not self.candidates:
            self.unknown = True
            self.warnings.append("no candidate could be fitted: its simulations fail")
            return
        first = self.candidates[0]
        self._compare_after()
        assert self.after is not None
        unexplained = self.after.verdict == "disagree" or first.fitted.loss > _UNEXPLAINED
        if self.settings.max_effects > 1 and len(self.ranker.names) > 1 and unexplained:
            self.say("looking for a second effect")
            pair = chosen_pair(first, self._fitted(self._pairs(first)))
            if pair is not None:
                self.candidates = [pair, *self.candidates]
                self._compare_after()
        self.unknown = is_unknown(self.candidates[0], self.ranking.unknown)

    def judge(self, held_out: Windows) -> Proof:
        """Compare the corrected model with alternatives on recordings held out."""
        self.say("judging on recordings held out")
        others = {"placebo": self._placebo() if self.settings.with_placebo else None,
                  "oracle": self.settings.oracle}  # fmt: skip
        proof = prove(
            self.comparison,
            self.corrected,
            self.windows,
            held_out,
            settings=self.settings,
            others={name: simulator for name, simulator in others.items() if simulator is not None},
        )
        self.warnings += few_held_out(proof.n_recordings)
        return proof

    def result(self, proof: Proof | None, seconds: float) -> GapResult:
        """Frozen result of all stages."""
        common: dict[str, Any] = {
            "where": where_of(self.before, pictures=self.settings.pictures),
            "rig": self.corrected,
            "unknown": self.unknown,
            "warnings": tuple(self.warnings),
            "seconds": seconds,
        }
        if not hasattr(self, "ranker"):
            return GapResult(**common)
        fitted, ranking = self.chosen, self.ranking.rows
        probability = {row.effect_id: row.probability for row in ranking}
        for candidate in self.candidates[::-1]:
            probability |= dict.fromkeys(candidate.names, candidate.probability)
        left = np.log(fitted.loss) if fitted is not None else np.log(1e3)
        effects = () if fitted is None else fitted.effects
        first = next((row for row in ranking if effects and row.effect_id == effects[0].effect_id), None)
        return GapResult(
            **common,
            where_after=None if self.after is None else where_of(self.after, pictures=False),
            ranking=tuple(
                EffectProbability(name, share)
                for name, share in sorted(probability.items(), key=lambda item: -item[1])
            ),
            effects=effects,
            parameters=() if fitted is None else fitted.parameters,
            tie_group=(first.effect_id, *first.look_alikes)
            if first is not None and first.look_alikes
            else (),
            unknown_score=float(left - 0.5 * np.log(max(self.ranking.conformal_p.values()))),
            next_measurement="" if first is None else first.next_measurement,
            loss=None if fitted is None else fitted.loss,
            proof=proof,
        )

    def _located(self, comparison: Comparison, shared_variance: Any = None) -> LocatedGap:
        return locate(
            comparison, self.measured, alpha=self.settings.alpha,
            n_permutations=self.settings.n_permutations, shared_variance=shared_variance,
        )  # fmt: skip

    def _compare_after(self) -> None:
        self.say("comparing measurement and corrected model")
        corrected = self.comparison.replace(rig=self.corrected, n_bank=self.settings.n_after)
        self.after = self._located(corrected, self.before.shared_variance)

    def _singles(self) -> list[_Proposal]:
        """Most probable effects, one of each group of look-alikes."""
        proposals: list[_Proposal] = []
        seen: set[str] = set()
        for row in self.ranking.rows:
            if row.effect_id in seen:
                continue
            if proposals and (len(proposals) >= self.settings.n_candidates or row.probability < _NEGLIGIBLE):
                break
            seen |= {row.effect_id, *row.look_alikes}
            starts = self.ranker.nearest(row.effect_id, self.before, _STARTS)
            proposals.append(_Proposal(row.probability, [(start,) for start in starts]))
            if row.probability >= _SURE:
                break
        return proposals

    def _pairs(self, first: Candidate) -> list[_Proposal]:
        """Pairs to fit: the nearest to the disagreement, and the first effect with the best for the rest."""
        assert self.after is not None
        ranked = self.ranker.nearest_pairs(self.before)
        starts = {frozenset(pair.names): [pair.effects] for pair in ranked[: self.settings.n_candidates]}
        rest = self.ranker.rank(self.after, without=first.names).rows[0]
        names = frozenset({*first.names, rest.effect_id})
        if names not in starts:
            seconds = self.ranker.nearest(rest.effect_id, self.after, _STARTS)
            starts[names] = [(*first.fitted.effects, second) for second in seconds]
        # The distances only select the pairs to fit; the losses of the fits then decide.
        chosen = [pair for pair in ranked if frozenset(pair.names) in starts]
        total = sum(pair.probability for pair in chosen)
        return [_Proposal(pair.probability / total, starts[frozenset(pair.names)]) for pair in chosen]

    def _fitted(self, proposals: list[_Proposal]) -> list[Candidate]:
        """Fit the proposals; most probable first, by the odds and the loss of the fit."""
        fits = []
        for proposal in proposals:
            names = " and ".join(proposal.names)
            self.say(f"fitting {names}")
            try:
                fitted = self._fit(proposal.starts, self.settings.n_sims, self.settings.n_interval)
            except SimulationFailed as failure:
                self.warnings.append(f"{names} could not be fitted: {failure}")
                continue
            fits.append((proposal, fitted))
            # If a likely proposal fits well, the others are not needed.
            if proposal.probability >= _LIKELY and fitted.loss < _DOUBTFUL:
                break
        if not fits:
            return []
        losses = np.array([fitted.loss for _, fitted in fits])
        odds = np.array([proposal.probability for proposal, _ in fits])
        weights = odds * np.exp(-_EVIDENCE * (losses - losses.min()))
        # Effects that were not fitted keep their probability.
        weights = weights / weights.sum() * odds.sum()
        return [Candidate(fits[k][0].names, float(weights[k]), fits[k][1]) for k in np.argsort(-weights)]

    def _fit(self, starts: Starts, n_sims: int, n_interval: int) -> FittedEffects:
        return fit_effects(
            self.comparison, self.measured, starts[0], starts=starts[1:], n_sims=n_sims,
            n_interval=n_interval,
        )  # fmt: skip

    def _placebo(self) -> Rig | None:
        """Fitted rig of the most probable single effect that is wrong; None if there is none."""
        named = set(self.candidates[0].names)
        ranking = self.ranking.rows
        excluded = named | {other for row in ranking if row.effect_id in named for other in row.look_alikes}
        for candidate in self.candidates[1:]:
            if not excluded & set(candidate.names):
                return candidate.fitted.rig
        for row in ranking:
            if row.effect_id not in excluded:
                self.say(f"fitting {row.effect_id} as a placebo")
                starts = self.ranker.nearest(row.effect_id, self.before, _STARTS)
                try:
                    return self._fit([(start,) for start in starts], _PLACEBO_SIMS, 0).rig
                except SimulationFailed:
                    continue
        return None


def chosen_pair(single: Candidate, pairs: Sequence[Candidate]) -> Candidate | None:
    """Return the best pair whose second effect is justified, or None.

    Both effects must have an identifiable parameter, unless the pair fits and the single effect does not. The
    loss of the pair must be clearly smaller than that of the single effect.
    """
    alone = single.fitted.loss
    worth = [
        pair
        for pair in pairs
        if _fixes_both(pair.fitted) or (alone > _UNEXPLAINED and pair.fitted.loss < _DOUBTFUL)
    ]
    return worth[0] if worth and worth[0].fitted.loss < _EXPLAINED * alone else None


def is_unknown(chosen: Candidate, outside_library: bool) -> bool:
    """Return True if the loss is too large; the limit is lower if the ranker calls the case unknown."""
    loss = chosen.fitted.loss
    return bool(loss > _UNEXPLAINED or (outside_library and loss > _DOUBTFUL))


def not_considered(in_model: Sequence[str], unavailable: Sequence[str]) -> list[str]:
    """Warnings of effects that cannot be named as missing."""
    warnings = []
    if in_model:
        warnings.append(f"{', '.join(in_model)} cannot be named as missing: the model already has it")
    if unavailable:
        warnings.append(f"this model cannot have {', '.join(unavailable)} at this rate: not considered")
    return warnings


def few_held_out(n: int) -> list[str]:
    """Warning if so few recordings are held out that the reduction of the gap is uncertain."""
    if n >= _FEW_HELD_OUT:
        return []
    return [
        f"only {n} recording{'' if n == 1 else 's'} held out: the share of the gap that closed is "
        f"uncertain, and with fewer than {_FEW_HELD_OUT} its range may be too narrow"
    ]


def _fixes_both(fitted: FittedEffects) -> bool:
    """Return True if every effect has an identifiable parameter."""
    fixed = {row.effect for row in fitted.parameters if row.identifiable}
    return all(effect.effect_id in fixed for effect in fitted.effects)
