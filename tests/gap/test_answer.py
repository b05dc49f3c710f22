"""Result of the gap: one verdict over conditions, plain values, tables."""

from __future__ import annotations

import dataclasses
import json
import math

import pytest
from gap_answers import EFFECTS, REMAINDER, answered, compared, proof_of

from cyclofeat.gap.result import FoundEffect, Size
from cyclofeat.simulators import Hum


@pytest.fixture(scope="module")
def result(compared_hum):
    return answered(compared_hum["hum"])


def test_conditions_share_one_verdict(result) -> None:
    first = result.where[0]
    assert result.p == pytest.approx(2 * first.p)
    assert result.verdict == "disagree"
    for verdicts, expected in (
        (("equivalent", "equivalent"), "equivalent"),
        (("equivalent", "unresolved"), "unresolved"),
        (("unresolved", "disagree"), "disagree"),
    ):
        where = tuple(dataclasses.replace(first, verdict=verdict) for verdict in verdicts)
        assert dataclasses.replace(result, where=where).verdict == expected


def test_an_effect_that_was_not_asked_for(result) -> None:
    assert result.effect("gain") is EFFECTS[2]
    with pytest.raises(KeyError, match="rattle is not among the effects that were asked for"):
        result.effect("rattle")


def test_plain_values(result) -> None:
    unexplained = dataclasses.replace(result, remainder=REMAINDER)
    plain = unexplained.to_dict()
    assert json.loads(json.dumps(plain, allow_nan=False)) == plain
    assert plain["format"] == "cyclofeat gap 2"
    assert plain["named"] == ["hum", "pin_errors", "gain"]
    assert plain["effects"][2] == {
        "id": "gain", "probability": 0.61, "state": "probably missing", "ties": ["offset"],
        "sizes": {"factor": {"unit": "1", "value": 1.05, "low": 1.01, "high": 1.09}},
        "visible": None, "visible_from": None,
    }  # fmt: skip
    small = next(one for one in plain["effects"] if one["id"] == "run_out")
    assert small["visible_from"] == {"name": "runout", "unit": "m", "below": None, "above": 2.5e-5}
    assert [one["speed_rpm"] for one in plain["conditions"]] == [500.0, 400.0]
    assert plain["proof"][1]["closed"]["after"]["all"] == 0.97
    assert plain["proof"][1]["direction"] == -1
    assert plain["remainder"]["unexplained"]
    assert [row["low_hz"] for row in plain["remainder"]["rows"]] == [562.0, None]


def test_the_text_says_each_thing_once(result) -> None:
    assert str(result).splitlines() == [
        "2 effects are missing in the model, 1 is probably missing",
        "  recordings: 12 at 500 RPM, 22 Nm; 400 RPM, 12 Nm, reverse; against the model: disagree "
        f"(p = {result.p:.2g})",
        "  missing: hum (> 0.99): amplitude 1.99 (1.91 to 2.06) Nm",
        "  missing: pin_errors (0.96): rms 12 (2 to 50) µm",
        "  probably missing: gain (0.61), or offset (0.36): factor 1.05 (1.01 to 1.09)",
        "  undecided: clearance (0.30)",
        "  left unexplained: nothing that chance does not explain (p = 0.31)",
        "  measure next: a record at 44 Nm, to decide about gain, offset",
        "  gap closed on recordings held out: 91% (86% to 95%) at 500 RPM, 22 Nm; 97% (92% to 101%) at "
        "400 RPM, 12 Nm, reverse",
        "  note: No tachometer.",
        "  note: One record was clipped.",
    ]


def test_what_is_left_and_what_is_not_known(result) -> None:
    undefined, note = proof_of(compared(after=(math.nan,)), None), "sizes may be off"
    changes = {"proof": (undefined,), "warnings": (note,), "size_note": note}
    lines = str(dataclasses.replace(result, remainder=REMAINDER, **changes)).splitlines()
    assert lines[0].startswith("2 effects are missing in the model, 1 is probably missing, something unknown")
    assert lines[6] == (
        "  left unexplained: differences that no effect considered explains (p < 0.001), most of all "
        "third octave at 631 Hz: 2.3 dB more in the recordings"
    )
    assert lines[8:] == [
        "  gap closed on recordings held out: too little disagreement to state how far it shrank",
        f"  note: {note}",
    ]


def test_tables(result) -> None:
    unexplained = dataclasses.replace(result, remainder=REMAINDER)
    rows = {
        "effects": 7, "sizes": 4, "remainder": 2, "next_measurements": 2, "proof": 7,
        "where": 2 * len(result.where[0].rows),
    }  # fmt: skip
    for table, n in rows.items():
        assert len(unexplained.to_frame(table)) == n, table
    assert unexplained.to_frame("where").speed_rpm.nunique() == 2
    assert unexplained.to_frame("sizes").effect.tolist() == ["hum", "pin_errors", "gain", "clearance"]
    assert result.to_frame("remainder").empty
    with pytest.raises(ValueError, match="table must be one of 'effects', 'sizes', .*, got 'ranking'"):
        result.to_frame("ranking")


def test_html_is_escaped_and_short(result) -> None:
    text = result._repr_html_()
    assert text.count("<polyline") == 3
    assert text.count("No tachometer.") == 1
    for part in (
        "&gt; 0.99",
        "1.99 (1.91 to 2.06) Nm",
        "400 RPM, 12 Nm, reverse",
        "97%",
        "explain (p = 0.31)",
    ):
        assert part in text, part
    odd = FoundEffect("hum", 0.9, "probably missing", (Size("<b>", "Nm", 1.0, 0.5, 2.0),))
    text = dataclasses.replace(
        result, effects=(odd,), named=(Hum(1.0),), proof=(proof_of(compared(after=(0.5,)), None),)
    )._repr_html_()
    assert "<b>" not in text
    assert "gap closed on recordings held out</th>" in text
