"""What is missing in the model, as the gap's report shows it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from cyclofeat.report._gap_numbers import (
    quantity,
    sentence,
)
from cyclofeat.report._page import number, probability_text

if TYPE_CHECKING:
    from cyclofeat.report._gap_findings import GapFindings

_N_RANKED = 5  # effects whose probabilities are shown


def what_is_missing(findings: GapFindings) -> dict[str, Any]:
    """Effects with their sizes, look-alikes, what to measure next, and the most probable of all."""
    result = findings.result
    # Most probable first.
    probability = {str(row["id"]): float(row["probability"]) for row in result.get("ranking", ())}
    tie_group = [str(name) for name in result.get("tie_group", ())]
    accepted = [
        _effect(findings, dict(row), tie_group if k == 0 else [], probability)
        for k, row in enumerate(result.get("effects", ()))
    ]
    unknown = bool(result.get("unknown", False))
    heading = "No effect considered explains it" if unknown else "No effect was accepted"
    if unknown and accepted:
        heading = "No effect considered explains the rest"
    text = ""
    if unknown:
        text = (
            "None of the effects considered does to the torque what is seen here. The probabilities below "
            "say which come nearest, not that one of them is right. The pictures show what a new effect "
            "would have to do."
        )
    elif not accepted:
        text = "Model and recordings disagree, but none of the effects considered was found to close the gap."
    alike = [name for name in tie_group if name not in {effect["id"] for effect in accepted}]
    together = sum(probability.get(name, 0.0) for name in tie_group)
    return {
        "heading": heading,
        "effects": accepted,
        "unknown": text,
        "look_alikes": [_named(findings, name) for name in alike],
        "look_alikes_text": "These recordings cannot tell it from the following; together they have a "
        f"probability of {probability_text(min(together, 1.0))}. What is missing may be any of them:",
        "next_measurement": sentence(str(result.get("next_measurement") or "")),
        "ranking": [
            _named(findings, name) | {"probability": share, "text": probability_text(share)}
            for name, share in list(probability.items())[:_N_RANKED]
        ],
        "ranking_caption": "The most probable of the effects considered, given that something is missing"
        + (" and that it is one of them (which is doubtful here)." if unknown else "."),
    }


def _effect(
    findings: GapFindings, row: Mapping[str, Any], tie_group: Sequence[str], among: Mapping[str, float]
) -> dict[str, Any]:
    effect_id = str(row["id"])
    found = _named(findings, effect_id)
    probability = row.get("probability", among.get(effect_id))
    short, confidence = "", ""
    if probability is not None:
        text = probability_text(float(probability))
        short = f"{_likely(float(probability))}: probability {text}"
        confidence = f"{short[0].upper()}{short[1:]}, among the effects considered."
        if len(tie_group) > 1:
            short += f", with {number(len(tie_group) - 1, 'look-alike')}"
            confidence += " It has look-alikes, see below."
    theta, interval = dict(row.get("theta", {})), dict(row.get("interval", {}))
    prefix = f"{effect_id}."
    for key, value in findings.theta.items():
        if key.startswith(prefix):
            theta[key.removeprefix(prefix)] = value
    for key, ends in findings.theta_ci.items():
        if key.startswith(prefix):
            interval[key.removeprefix(prefix)] = ends
    units = _units(findings, effect_id)
    sizes = [
        _size(findings, effect_id, name, float(value), interval.get(name), units.get(name, "1"))
        for name, value in theta.items()
    ]
    remarks = any(size["remark"] for size in sizes)
    return found | {"short": short, "confidence": confidence, "sizes": sizes, "remarks": remarks}


def _size(
    findings: GapFindings,
    effect_id: str,
    name: str,
    value: float,
    interval: Sequence[float] | None,
    unit: str,
) -> dict[str, str]:
    remarks = []
    key = f"{effect_id}.{name}"
    if not findings.identifiable.get(key, True):
        remarks.append("not fixed by these recordings: other values do as well")
    if findings.at_bound.get(key, False):
        remarks.append("at an end of what was tried: the true value may lie beyond")
    low, high = (math.nan, math.nan) if interval is None else (float(end) for end in interval)
    there = not (math.isnan(low) or math.isnan(high))
    return {
        "name": name.removesuffix("_nm").removesuffix("_hz").replace("_", " "),
        "value": quantity([value], unit),
        "range": quantity([low, high], unit) if there else "",
        "remark": "; ".join(remarks),
    }


def _kinds(findings: GapFindings) -> dict[str, Any]:
    from cyclofeat.simulators import effect_library

    return {**effect_library(), **{effect.effect_id: type(effect) for effect in findings.effects}}


def _units(findings: GapFindings, effect_id: str) -> dict[str, str]:
    kind = _kinds(findings).get(effect_id)
    return {} if kind is None else {name: parameter.unit for name, parameter in kind.parameters.items()}


def _named(findings: GapFindings, effect_id: str) -> dict[str, Any]:
    """Id, name in plain words, what it is and what tells it apart."""
    kind = _kinds(findings).get(effect_id)
    if kind is None:
        return {"id": effect_id, "name": effect_id.replace("_", " "), "summary": "", "separated_by": ""}
    summary = kind.summary()
    name = summary.partition(":")[0].partition(",")[0].removesuffix(".")
    return {"id": effect_id, "name": name, "summary": summary, "separated_by": kind.separated_by}


def _likely(probability: float) -> str:
    for least, word in ((0.95, "very likely"), (0.8, "likely"), (0.5, "more likely than not")):
        if probability >= least:
            return word
    return "uncertain"
