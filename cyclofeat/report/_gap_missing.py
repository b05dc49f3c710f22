"""What is missing in the model, as the page of a gap shows it."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from cyclofeat._base.words import number
from cyclofeat.report._gap_numbers import quantity, sentence
from cyclofeat.report._page import probability_text

if TYPE_CHECKING:
    from cyclofeat.gap import FittedParameter, GapResult

_N_RANKED = 5  # effects whose probabilities are shown


def what_is_missing(result: GapResult) -> dict[str, Any]:
    """Effects with their sizes, look-alikes, what to measure next, and the most probable of all."""
    accepted = [_effect(result, effect.effect_id, first=k == 0) for k, effect in enumerate(result.effects)]
    heading = "No effect was accepted"
    if result.unknown:
        heading = f"No effect considered explains {'the rest' if accepted else 'it'}"
    text = ""
    if result.unknown:
        text = (
            "None of the effects considered changes the torque in the way that is seen here. The "
            "probabilities below say which come nearest, not that one of them is right. The pictures show "
            "what a new effect would have to do."
        )
    elif not accepted:
        text = "Model and recordings disagree, but none of the effects considered closes the gap."
    names = {effect["id"] for effect in accepted}
    together = min(sum(result.probability(name) for name in result.tie_group), 1.0)
    return {
        "heading": heading,
        "effects": accepted,
        "unknown": text,
        "look_alikes": [_named(result, name) for name in result.tie_group if name not in names],
        "look_alikes_text": "These recordings cannot tell it from the following effects; together they have "
        f"a probability of {probability_text(together)}. Any of them may be what is missing:",
        "next_measurement": sentence(result.next_measurement),
        "ranking": [
            _named(result, row.effect)
            | {"probability": row.probability, "text": probability_text(row.probability)}
            for row in result.ranking[:_N_RANKED]
        ],
        "ranking_caption": "The most probable of the effects considered, given that something is missing"
        + (" and that it is one of them (which is doubtful here)." if result.unknown else "."),
    }


def _effect(result: GapResult, effect_id: str, *, first: bool) -> dict[str, Any]:
    probability = result.probability(effect_id)
    short = f"{_likely(probability)}: probability {probability_text(probability)}"
    confidence = f"{short[0].upper()}{short[1:]}, among the effects considered."
    if first and len(result.tie_group) > 1:
        short += f", with {number(len(result.tie_group) - 1, 'look-alike')}"
        confidence += " It has look-alikes, see below."
    sizes = [_size(parameter) for parameter in result.parameters_of(effect_id)]
    remarks = any(size["remark"] for size in sizes)
    return _named(result, effect_id) | {
        "short": short, "confidence": confidence, "sizes": sizes, "remarks": remarks,
    }  # fmt: skip


def _size(parameter: FittedParameter) -> dict[str, str]:
    remarks = []
    if not parameter.identifiable:
        remarks.append("poorly identified: other values fit as well")
    if parameter.at_bound:
        remarks.append("at an end of the range that was tried: the true value may lie beyond")
    ends = [parameter.low, parameter.high]
    return {
        "name": parameter.name.removesuffix("_nm").removesuffix("_hz").replace("_", " "),
        "value": quantity([parameter.value], parameter.unit),
        "range": "" if any(math.isnan(end) for end in ends) else quantity(ends, parameter.unit),
        "remark": "; ".join(remarks),
    }


def _named(result: GapResult, effect_id: str) -> dict[str, Any]:
    """Id, name in plain words, summary, and what tells the effect apart."""
    from cyclofeat.simulators import effect_library  # loads numba: only for a page of the gap

    kinds = {**effect_library(), **{effect.effect_id: type(effect) for effect in result.effects}}
    kind = kinds.get(effect_id)
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
