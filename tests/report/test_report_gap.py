"""The page of a gap: the answer first, in plain words, whole, escaped, and honest about its recordings."""

from __future__ import annotations

import base64
import dataclasses
import html
import json
import math
import re
from xml.etree import ElementTree

import numpy as np
import pytest
from gap_answers import EFFECTS, REMAINDER, answered, compared, proof_of
from numpy.testing import assert_allclose
from pages import assert_in_order, parse, read_words, summary_of, without_scripts, words

from cyclofeat._base.quantities import quantity_text
from cyclofeat.gap.result import FoundEffect, NextMeasurement
from cyclofeat.gap.where.locate import where_of
from cyclofeat.report import write_gap_report
from cyclofeat.report._gap import recordings_for_agreement
from cyclofeat.report._page import rounded_text

OPTIONS = {"sources": ["surrogate"] * 12, "settings": {"model": "rig/<script>alert(1)</script>.csv"}}

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def result(compared_hum):
    return answered(compared_hum["hum"])


@pytest.fixture(scope="module")
def null(compared_hum):
    return where_of(compared_hum["nothing"], pictures=False)


def without_drawing(monkeypatch):
    """Leave the pictures empty."""
    monkeypatch.setattr("cyclofeat.report._figures._draw_svg", lambda *_: "<svg/>")


@pytest.fixture(scope="module")
def page(result, tmp_path_factory):
    with pytest.MonkeyPatch.context() as monkeypatch:
        without_drawing(monkeypatch)
        path = write_gap_report(result, tmp_path_factory.mktemp("gap") / "gap.html", **OPTIONS)
    return path.read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def parsed(page):
    return parse(page)


@pytest.fixture
def bare(monkeypatch):
    """Text of a page whose pictures are not drawn."""
    without_drawing(monkeypatch)

    def text(result, tmp_path, **options):
        return read_words(write_gap_report(result, tmp_path / "gap.html", **(OPTIONS | options)))

    return text


# -- the whole page


def test_all_is_stated(parsed, result):
    text = words(parsed)
    for part in (
        "2 effects are missing in the model, 1 is probably missing",
        "Mains hum in the torque signal hum missing > 0.99 amplitude 1.99 (1.91 to 2.06) Nm",
        "Position errors of the pins pin_errors missing 0.96 rms 12 (2 to 50) µm",
        "meter gain or: Offset of the torque meter (one of them: 0.97) probably missing 0.61 factor 1.05",
        "1 effect undecided",
        "clearance undecided 0.30 clearance 10 µm",
        "1 other effect not missing, 1 too small to matter Too small to matter, with its probability and the "
        "size from which on it would be seen: Run-out of the wheels (0.12; above 25 µm).",
        "Noise of the sensor (0.02).",
        f"(p = {result.p:.2g}, 12 recordings at 2 conditions)",
        "Gap closed on recordings held out 91 to 97 % at 2 of 2 conditions",
        "Left unexplained nothing the remaining differences are chance (p = 0.31)",
        "Measure next A record at 44 Nm would decide about 2 effects",
        "A record at 44 Nm Gain of the torque meter, Offset of the torque meter Dead weights",
        "Next command Write the corrected model, then train a counter on it: cyclofeat gap RECORDINGS "
        "--save-simulator corrected.json cyclofeat train --rig corrected.json --out counter.skops",
        "the corrected model agrees with the recordings (p = 0.31)",
        "500 RPM, 22 Nm",
        "400 RPM, 12 Nm, reverse",
        "the correction closed 91 % of the gap (range 86 to 95 %)",
        "93 % with counts of worn lobes seen in the fit and 88 % with counts never seen in the fit",
        "nothing changed 0 %",
        "spectrum in third octaves 4.25 1.50 1.12",
        "One record was clipped.",
        "computing time 83 s",
        "conditions 500 RPM, 22 Nm; 400 RPM, 12 Nm, reverse",
        "random state 0",
        "numpy",
    ):  # fmt: skip
        assert part in text, part
    assert text.count("No tachometer.") == 1


def test_the_answer_comes_before_all_else(parsed):
    headings = [
        "2 effects are missing", "What to measure next", "What remains unexplained",
        "Recordings, model and corrected model", "Where recordings and uncorrected model differ",
        "How far the gap shrank", "Warnings", "Method in short", "Made from",
    ]  # fmt: skip
    text = words(parsed)
    assert_in_order(text, headings)
    assert_in_order(text[: text.index(headings[1])], [
        "Mains hum", "1.99 (1.91", "91 to 97 %", "Left unexplained", "Measure next", "cyclofeat train",
        "2 warnings",
    ])  # fmt: skip


def test_the_clearest_difference_is_told_in_words(parsed, result):
    line = next(row for row in result.where[0].means() if row.cell.name == "input order 6")
    assert re.search(rf"input order 6 {line.difference:.0f} dB more \+\d+ to \+\d+ dB", words(parsed))


def test_surrogates_are_called_so_and_nothing_measured(page):
    assert "All recordings are SIMULATED" in page.split("</header>")[0]
    assert "measured" not in page.lower()


def test_values_are_escaped(page):
    assert "<script>alert" not in page
    assert html.escape("rig/<script>alert(1)</script>.csv") in page


def test_the_file_needs_nothing_else(page, parsed):
    assert not re.search("https?://", without_scripts(page))
    assert not {"link", "iframe", "object", "base"} & set(parsed.tags)
    for tag, name, value in parsed.attributes:
        if name in ("src", "srcset", "action", "poster"):
            assert value.startswith("data:image/svg+xml;base64,"), (tag, name, value[:40])
        if name == "href":
            assert value == "#warnings"


def test_pictures_are_there_once_for_both_schemes(result, tmp_path):
    path = write_gap_report(result, tmp_path / "gap.html", **OPTIONS)
    parsed = parse(path.read_text(encoding="utf-8"))
    classes = [value for tag, name, value in parsed.attributes if (tag, name) == ("img", "class")]
    # three comparisons at two conditions, two foldings at one, two proofs; overlays are drawn by the page
    assert classes == ["drawing"] * (6 + 2 + 2)
    sources = [value for tag, name, value in parsed.attributes if (tag, name) == ("img", "src")]
    for source in sources:
        root = ElementTree.fromstring(base64.b64decode(source.split(",")[1]))
        tags = [node.tag.rpartition("}")[2] for node in root.iter()]
        assert tags.count("path") >= 10  # axes and what they hold
        assert tags.count("text") >= 4  # words are texts, not outlines


def test_overlays_hold_the_curves_with_their_bands(page, result):
    plots = [json.loads(data) for data in re.findall(r'json">(.*?)</script>', page)]
    assert [plot["axes"][0]["unit"] for plot in plots] == ["Hz", "Hz", "", "", "Nm", "Nm"]
    for first, second in zip(plots[::2], plots[1::2], strict=True):  # neighbours can be compared by eye
        assert first["axes"][1]["ends"] == second["axes"][1]["ends"]
    names = [line["name"] for line in plots[0]["lines"]]
    assert names == ["model", "simulated recordings", "corrected model"]
    of_spectrum = next(overlay for overlay in result.overlays if overlay.kind == "spectrum")
    band, columns = of_spectrum.corrected, plots[0]["lines"][2]["columns"]
    drawn = [np.linspace(column["first"], column["last"], column["n"]) for column in columns]
    assert_allclose(drawn, [band.mean, band.low, band.high])


# -- parts that are not there, and other answers


@pytest.mark.usefixtures("bare")
def test_the_summary_is_plain(result):
    summary = summary_of(write_gap_report, result)
    told = json.loads(json.dumps(summary))
    assert told.keys() == summary.keys()
    assert told["effects"] == summary["effects"]
    counters = [
        {"counter": name, "n": 12, "right": n, "refused": 12 - n} for name, n in (("new", 12), ("old", 7))
    ]
    summary = summary_of(write_gap_report, result, counters=counters, settings={"corrected model": "c.json"})
    assert (summary["counters"], summary["rig_file"]) == (counters, "c.json")


def rows(undefined="", **shares):
    first, *others = compared(**shares)
    return {"proof": (proof_of((dataclasses.replace(first, undefined=undefined), *others)),)}


NOTHING = {"effects": EFFECTS[-1:], "named": (), "proof": (), "overlays": (), "next_measurements": ()}
ABSENT = tuple(FoundEffect(effect.effect, 0.01, "not missing") for effect in EFFECTS)
LEAST = NOTHING | {"effects": (), "remainder": None, "warnings": ()}
ODD = FoundEffect("loose_bolt", 0.97, "missing")
OPEN = dataclasses.replace(REMAINDER, unexplained=False, p_undecided=0.2)
UNDEFINED = "there is no gap to close."
# Changes of the answer, and of the comparison if it is that without a difference; stated parts, absent ones.
ANSWERS = [
    ({"remainder": REMAINDER, "size_note": "reason"}, None, "something unknown is missing too | Left "
     "unexplained something most of all: third octave at 631 Hz, 2.3 dB more | differs from the recordings "
     "by more than chance explains (p < 0.001) | third octave at 631 Hz 2.3 dB more 6.1 | the largest "
     "value 0.4 lower 4.2 | Reason.", ""),
    ({"remainder": OPEN}, None, "missing in the model, 1 is probably missing | Left unexplained "
     "undecided | chance explains (p < 0.001): undecided effects may explain it.", "something unknown"),
    ({"proof": ()}, None, "held out not tested no recordings were held out | --hold-out DIR", ""),
    (rows(UNDEFINED, after=(math.nan,) * 3, nothing=(math.nan,) * 3), None,
     f"No share of the gap can be stated: {UNDEFINED} | Gap closed on recordings held out not defined",
     " nan "),
    (rows(after=(0.9, 0.9)), None, "Gap closed on recordings held out 90 % range 85 to 94 %",
     "counts of worn lobes seen in the fit"),
    (rows(after=(-0.25, -0.2, -0.3)), None, "correction widened the gap by 25 % (range -30 to -21 %)", ""),
    (NOTHING | {"effects": ABSENT}, {"verdict": "equivalent"}, "7 other effects not missing | Model and "
     "recordings agree | compared agree within 1.5 dB", "How far the gap shrank | disagree"),
    ({}, {}, "2 effects are missing in the model | One by one, no number differs clearly (6 recordings)", ""),
    (NOTHING | {"remainder": REMAINDER}, None,
     "Model and recordings disagree, and no effect considered explains it",
     "Gap closed | What to measure next"),
    (NOTHING, None, "no effect is decided", ""),
    (LEAST, {}, "No single difference is clear", "not missing"),
    (LEAST, None, "Model and recordings disagree", "Warnings | How sure | What remains | not missing"),
    ({"effects": (*EFFECTS, ODD), "next_measurements": (NextMeasurement("the bolts", ("loose_bolt",)),)},
     None, "loose bolt loose_bolt missing 0.97 not learned | The bolts loose bolt", ""),
    (LEAST, {"n_recordings": 3}, "Only 3 recordings: with fewer than 5, only large differences can be", ""),
]  # fmt: skip


@pytest.mark.parametrize(("changes", "of_null", "stated", "absent"), ANSWERS)
def test_other_answers(result, null, bare, tmp_path, changes, of_null, stated, absent):
    if of_null is not None:
        changes = changes | {"where": (dataclasses.replace(null, **of_null),)}
    text = bare(dataclasses.replace(result, **changes), tmp_path)
    assert not [part for part in stated.split(" | ") if part not in text]
    assert not [part for part in absent.split(" | ") if part and part in text]


def test_one_condition_without_a_ratio_has_its_reason(result, bare, tmp_path):
    *rows, last = compared(after=(0.9, 0.9, math.nan))
    last = dataclasses.replace(last, undefined="one held-out recording in this condition")
    text = bare(dataclasses.replace(result, proof=(proof_of((*rows, last)),)), tmp_path)
    assert "That is 90 % with counts of worn lobes seen in the fit." in text
    assert "With counts never seen in the fit no share can be stated: one held-out recording in this" in text


@pytest.mark.parametrize(
    ("sources", "expected"),
    [
        (["measured"] * 6, "6 recordings, stated to be measured"),
        (["measured"] * 4 + ["simulated"] * 2, "2 of 6 recordings are SIMULATED:"),
        (["measured"] * 5 + [None], "do not state whether they were taken on"),
    ],
)
def test_origins(result, bare, tmp_path, sources, expected):
    assert_in_order(bare(result, tmp_path, sources=sources), ["Model against recordings", expected])


# -- numbers


def test_recordings_that_agreement_would_take(null):
    """Ranges half as wide need four times the sum of the inverse numbers."""
    row = next(row for row in null.rows if row.cell.name == "third octave at 398 Hz")
    row = dataclasses.replace(row, of="mean", low=-3.0, high=3.0)
    where = dataclasses.replace(null, rows=(row,), n_recordings=10, n_simulated=100)
    # 1/10 + 1/100 falls to a quarter with 40 recordings against 400
    text = recordings_for_agreement(where)
    assert "about 40 recordings, compared with 400 simulated ones" in text
    assert "third octave at 398 Hz" in text


@pytest.mark.parametrize(
    ("values", "unit", "text"),
    [
        ([1.2e-5], "m", "12 µm"),
        ([2e-6, 5e-5], "m", "2 to 50 µm"),
        ([1.02345], "1", "1.02"),
        ([1.2e-4, 3e-4], "1", "120 to 300 ppm"),
        ([140.4, math.inf], "Hz", "140 to infinite Hz"),
        ([5149.0, 12_345.0], "Nm/rad", "5150 to 12300 Nm/rad"),
        ([0.0072], "kg m2", "0.0072 kg m²"),
    ],
)
def test_quantities(values, unit, text):
    assert quantity_text(values, unit).replace("\N{NO-BREAK SPACE}", " ") == text


@pytest.mark.parametrize(("value", "text"), [(7.25, "7.2"), (111.1, "110"), (12_345.0, "12000")])
def test_rounding(value, text):
    assert rounded_text(value) == text
