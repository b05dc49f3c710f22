"""What a workflow has found as plain values that JSON can hold."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from cyclofeat.gap._fitter import EffectFitter
from cyclofeat.gap._ranker import EffectRanker
from cyclofeat.gap._report import GapReport
from cyclofeat.simulators import Effect

if TYPE_CHECKING:
    from cyclofeat.gap._workflow import DiscrepancyWorkflow

FORMAT = "cyclofeat gap 1"


def result_of(workflow: DiscrepancyWorkflow) -> dict[str, Any]:
    """What ``cyclofeat gap --json`` prints of a fitted workflow."""
    ranker, fitter, report = workflow.ranker_, workflow.fitter_, workflow.report_
    ranking = [] if ranker is None else ranker.ranking_
    probability = {row.effect_id: row.probability for row in ranking}
    for candidate in workflow.candidates_[::-1]:
        probability |= dict.fromkeys(candidate.names, candidate.probability)
    first = workflow.effects_[0].effect_id if workflow.effects_ else None
    alike = next((row.look_alikes for row in ranking if row.effect_id == first), ())
    return {
        "format": FORMAT,
        "verdict": workflow.locator_.verdict_,
        "p": min(workflow.locator_.family_p_.values()),
        "effects": [] if fitter is None else [_named(e, probability, fitter) for e in workflow.effects_],
        "ranking": [
            {"id": name, "probability": round(value, 6)}
            for name, value in sorted(probability.items(), key=lambda item: -item[1])
        ],
        "tie_group": [first, *alike] if first and alike else [],
        "unknown": bool(workflow.unknown_),
        "unknown_score": None if ranker is None else _unknown_score(ranker, fitter),
        "next_measurement": next((row.next_measurement for row in ranking if row.effect_id == first), ""),
        "loss": None if fitter is None else fitter.loss_,
        "verdict_after": None if workflow.locator_after_ is None else workflow.locator_after_.verdict_,
        "grr": None if report is None else _grr(report, "after"),
        "alternatives": {}
        if report is None
        else {name: _grr(report, name) for name in report.alternatives_ if name != "after"},
        "warnings": list(workflow.warnings_),
        "seconds": round(workflow.seconds_, 1),
    }


def _unknown_score(ranker: EffectRanker, fitter: EffectFitter | None) -> float:
    """The larger, the less the library explains: of the shape, and of what the fit leaves."""
    left = np.log(fitter.loss_) if fitter is not None else np.log(1e3)
    return float(left - 0.5 * np.log(max(ranker.conformal_p_.values())))


def _named(effect: Effect, probability: dict[str, float], fitter: EffectFitter) -> dict[str, Any]:
    names = effect.vector_names()
    key = {name: f"{effect.effect_id}.{name}" for name in names}
    return {
        "id": effect.effect_id,
        "probability": round(probability.get(effect.effect_id, 0.0), 6),
        "theta": {name: fitter.theta_[key[name]] for name in names},
        "interval": {name: list(fitter.theta_ci_[key[name]]) for name in names},
        "identifiable": {name: fitter.identifiable_[key[name]] for name in names},
        "at_bound": {name: fitter.at_bound_[key[name]] for name in names},
    }


def _grr(report: GapReport, alternative: str) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for row in report.comparison_:
        if row.alternative != alternative:
            continue
        found[row.condition] = None if np.isnan(row.grr) else row.grr
        if row.condition == "all" and not np.isnan(row.low):
            found["ci"] = [row.low, row.high]
    return found
