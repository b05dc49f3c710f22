"""The report of a gap: the answer first, in plain words, whole, escaped, and honest about its recordings."""

from __future__ import annotations

import base64
import dataclasses
import html
import json
import math
import re
from types import SimpleNamespace
from xml.etree import ElementTree

import pytest
from pages import parse, words

from cyclofeat.gap import (
    DistanceRow,
    EffectProbability,
    FittedParameter,
    GapResult,
    Proof,
    ProofRow,
    where_of,
)
from cyclofeat.report import summarise_gap, write_gap_report
from cyclofeat.report._gap import _recordings_for_agreement
from cyclofeat.report._gap_numbers import quantity, rounded
from cyclofeat.simulators import (
    BrakeRotor,
    Hum,
    Noise,
    PinErrors,
    Rig,
)

RATE = 6400.0
BASE = Rig(effects=[BrakeRotor(0.02, 1e4, 0.05), Noise(0.05)], name="R1")
LOW_PASS = "torque_meter_low_pass"


@pytest.fixture(scope="module")
def locators(compared_hum):
    """Of strong hum, and of nothing; the latter also stands for what a fit leaves."""
    before = where_of(compared_hum["hum"])
    return SimpleNamespace(before=before, null=where_of(compared_hum["nothing"], pictures=False))


def compared(beaten=None, **alternatives):
    return tuple(
        ProofRow(
            name,
            condition,
            grr,
            grr - 0.05,
            grr + 0.04,
            beaten=(beaten or {}).get((name, condition), math.nan),
        )
        for name, ratios in alternatives.items()
        for condition, grr in zip(("all", "seen", "unseen"), ratios, strict=True)
    )


def proof_of(rows=None):
    distances = [
        DistanceRow(name, "all", family, distance)
        for name, distance in (("nothing", 4.25), ("after", 1.5), ("floor", 1.125))
        for family in ("spectrum", "overall")
    ]
    if rows is None:
        of_box = zip(("all", "seen", "unseen"), (0.99, 0.3, 1.0), strict=True)
        rows = compared(
            {("equaliser", condition): share for condition, share in of_box},
            after=(0.91, 0.93, 0.88), nothing=(0, 0, 0), equaliser=(0.74, 0.95, 0.41), oracle=(0.97,) * 3,
        )  # fmt: skip
    return Proof(tuple(rows), tuple(distances), 6)


@pytest.fixture(scope="module")
def result(locators):
    """A complete result, of surrogate recordings."""
    return GapResult(
        where=dataclasses.replace(locators.before, family_p=locators.before.family_p | {"spectrum": 0.018}),
        rig=BASE.with_added(Hum(2.0)),
        where_after=locators.null,
        ranking=(
            EffectProbability("pin_errors", 0.9),
            EffectProbability("hum", 0.62),
            EffectProbability(LOW_PASS, 0.31),
        ),
        effects=(Hum(2.0), PinErrors(1.2e-5)),
        parameters=(
            FittedParameter("hum", "amplitude_nm", 1.987, 1.91, 2.06, "Nm"),
            FittedParameter("pin_errors", "rms", 1.2e-5, 2e-6, 5e-5, "m", identifiable=False, at_bound=True),
        ),
        tie_group=("hum", LOW_PASS),
        next_measurement="a record with the motor off, or at another speed",
        proof=proof_of(),
        warnings=("No tachometer.", "No tachometer.", "One record was clipped."),
        seconds=83.4,
    )


OPTIONS = {"sources": ["surrogate"] * 6, "settings": {"model": "rig/<script>alert(1)</script>.csv"}}


@pytest.fixture(scope="module")
def page(result, tmp_path_factory):
    path = write_gap_report(result, tmp_path_factory.mktemp("gap") / "gap.html", **OPTIONS)
    return path.read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def parsed(page):
    return parse(page)


@pytest.fixture
def bare(monkeypatch):
    """Text of a report whose pictures are not drawn."""
    drawn = {"light": "data:,", "dark": "data:,", "alt": "x", "width": 1, "height": 1}
    for module in ("_gap", "_gap_reduction"):
        monkeypatch.setattr(f"cyclofeat.report.{module}.picture", lambda *_: drawn)

    def text(result, tmp_path, **options):
        path = write_gap_report(result, tmp_path / "gap.html", **(OPTIONS | options))
        return words(parse(path.read_text(encoding="utf-8")))

    return text


# -- the complete report


def test_all_is_stated(parsed, result):
    text = words(parsed)
    for part in (
        "Model and recordings disagree",
        f"(p = {result.where.p:.2g}, 6 recordings against 24 simulated ones)",
        "Mains hum in the torque signal hum",
        "More likely than not: probability 0.62, among the effects considered. It has look-alikes",
        "amplitude 1.99 Nm 1.91 to 2.06 Nm",
        "Position errors of the pins",
        "12 µm 2 to 50 µm poorly identified: other values fit as well; at an end of the range that was",
        "together they have a probability of 0.93",
        "Low-pass in the torque meter (to tell it apart: a tap test with the filter switched off",
        "What to measure next A record with the motor off, or at another speed.",
        "the correction closed 91 % of the gap (range 86 to 95 %)",
        "93 % with counts of worn lobes seen in the fit and 88 % with counts never seen in the fit",
        "with 74 % against 91 % (the correction is nearer in 99 % of resampled sets of recordings)",
        "With counts seen in the fit, “equaliser and shaped noise (black box)” does better, with 95 %",
        "counts never seen in the fit, “equaliser and shaped noise (black box)” comes nearest, with 41 %",
        "the true simulator 97 %",
        "spectrum in third octaves 4.25 1.50 1.12",
        "What remains unexplained",
        "One record was clipped.",
        "computing time 83 s",
        "random state 0",
        "numpy",
    ):
        assert part in text, part
    assert text.count("No tachometer.") == 1


def test_the_answer_comes_before_all_else(parsed):
    headings = [
        "The answer", "Where recordings and model differ", "What is missing in the model",
        "How far the gap shrank", "What remains unexplained", "Pictures before the correction", "Warnings",
        "Method in short", "Made from",
    ]  # fmt: skip
    text = words(parsed)
    places = [text.index(heading) for heading in headings]
    assert places == sorted(places)
    tiles = text[: places[1]]
    for part in ("Mains hum in the torque signal", "1.99 Nm", "91 %", "2 warnings"):
        assert part in tiles, part


def test_the_clearest_difference_is_told_in_words(parsed, locators):
    line = next(row for row in locators.before.means() if row.cell.name == "input order 6")
    assert line.p <= 0.05
    assert re.search(rf"input order 6 {line.difference:.0f} dB more \+\d+ to \+\d+ dB", words(parsed))


def test_surrogates_are_called_so_and_nothing_measured(page):
    without = re.sub(r"data:image/svg\+xml;base64,[A-Za-z0-9+/=]+", "", page)
    assert "All recordings are SURROGATE" in without.split("</header>")[0]
    assert "measured" not in without.lower()


def test_values_are_escaped(page):
    assert "<script" not in page
    assert html.escape("rig/<script>alert(1)</script>.csv") in page


def test_the_file_needs_nothing_else(page, parsed):
    assert "http://" not in page
    assert "https://" not in page
    assert not {"script", "link", "iframe", "object", "base"} & set(parsed.tags)
    for tag, name, value in parsed.attributes:
        if name in ("src", "srcset", "action", "poster"):
            assert value.startswith("data:image/svg+xml;base64,"), (tag, name, value[:40])
        if name == "href":
            assert value == "#warnings"


def test_pictures_are_there_for_both_schemes(parsed):
    classes = [value for tag, name, value in parsed.attributes if (tag, name) == ("img", "class")]
    # families, comparison, before and after, spectrum, orders, two phases
    assert classes == ["on-light", "on-dark"] * 7
    sources = [value for tag, name, value in parsed.attributes if (tag, name) == ("img", "src")]
    assert len(set(sources)) == len(sources)
    for source in sources:
        root = ElementTree.fromstring(base64.b64decode(source.split(",")[1]))
        paths = [node for node in root.iter() if node.tag.endswith("}path")]
        assert len(paths) > 50


def test_the_same_result_give_the_same_text(result, bare, tmp_path):
    assert bare(result, tmp_path) == bare(result, tmp_path)


# -- parts that are not there


@pytest.mark.usefixtures("bare")
def test_the_summary_is_plain(result):
    summary = summarise_gap(result)
    told = json.loads(json.dumps(summary))
    assert told.keys() == summary.keys()
    assert told["missing"] == summary["missing"]


def test_without_hold_out_it_says_how_to_get_a_ratio(result, bare, tmp_path):
    text = bare(dataclasses.replace(result, proof=None, where_after=None), tmp_path)
    assert "Not tested: no recordings were held out." in text
    assert "--hold-out DIR" in text
    assert "Gap closed on" not in text
    assert "What remains unexplained" not in text


def test_an_undefined_ratio_has_its_reason(result, bare, tmp_path):
    rows = compared(after=(math.nan,) * 3, equaliser=(math.nan,) * 3)
    rows = (dataclasses.replace(rows[0], undefined="there is no gap to close."), *rows[1:])
    text = bare(dataclasses.replace(result, proof=proof_of(rows)), tmp_path)
    assert "No share of the gap can be stated: there is no gap to close." in text
    assert "Gap closed on recordings held out not defined" in text
    assert "nan" not in text.lower().split()


def test_one_condition_without_a_ratio_has_its_reason(result, bare, tmp_path):
    rows = compared(after=(0.9, 0.9, math.nan))
    rows = (*rows[:2], dataclasses.replace(rows[2], undefined="one held-out recording in this condition"))
    text = bare(dataclasses.replace(result, proof=proof_of(rows)), tmp_path)
    assert "That is 90 % with counts of worn lobes seen in the fit." in text
    assert "With counts never seen in the fit no share can be stated: one held-out recording in this" in text


def test_a_gap_that_grew_is_not_called_closed(result, bare, tmp_path):
    rows = compared(after=(-0.25, -0.2, -0.3), placebo=(0.1, 0.1, 0.1))
    text = bare(dataclasses.replace(result, proof=proof_of(rows)), tmp_path)
    assert "the correction widened the gap by 25 % (range -30 to -21 %)" in text
    assert "“best wrong effect” does better, with 10 % against -25 %" in text


@pytest.mark.parametrize("verdict", ["equivalent", "unresolved"])
def test_without_disagreement_nothing_is_named(result, locators, bare, tmp_path, verdict):
    where = dataclasses.replace(locators.null, verdict=verdict, global_p={"energy distance": 0.002})
    text = bare(dataclasses.replace(result, where=where, where_after=None), tmp_path)
    assert "What is missing" not in text
    assert "Mains hum" not in text
    assert "How far the gap shrank" not in text
    assert "disagree" not in text.split("Where recordings")[0]
    if verdict == "equivalent":
        assert "Model and recordings agree" in text
        assert f"All {locators.null.n_cells} numbers compared agree within 1.5 dB" in text
    else:
        assert "No clear answer yet" in text
        assert "All numbers together hint at a difference (p = 0.002), but not at its place." in text
        assert re.search(r"would take about \d+ recordings, compared with \d+ simulated ones", text)


def test_nothing_in_the_library(result, bare, tmp_path):
    changes = {"effects": (), "parameters": (), "tie_group": (), "next_measurement": "", "proof": None,
               "where_after": None}  # fmt: skip
    text = bare(dataclasses.replace(result, unknown=True, **changes), tmp_path)
    assert "Missing in the model not known No effect considered explains it" in text
    assert "not that one of them is right" in text
    assert "Nothing was added to the model, so there is nothing to show." in text
    assert "held out" not in text
    assert "Its size" not in text
    assert "What to measure next" not in text
    assert "Look-alikes" not in text
    text = bare(dataclasses.replace(result, **changes), tmp_path)
    assert "Missing in the model not known No effect was accepted" in text


def test_settings_are_told_once(result, bare, tmp_path):
    text = bare(result, tmp_path, settings={"nominal input speed": "480 RPM"})
    assert text.count("nominal input speed") == 1
    assert "nominal input speed 480 RPM" in text
    assert "nominal input speed 500 RPM" in bare(result, tmp_path)


def test_the_least_there_can_be(locators, bare, tmp_path):
    plain = GapResult(locators.null, BASE)
    text = bare(plain, tmp_path, sources=(), settings=None)
    assert "No clear answer yet" in text
    assert "The recordings do not state whether they were taken on a machine." in text
    text = bare(dataclasses.replace(plain, where=locators.before), tmp_path)
    assert "No effect was accepted" in text
    assert "Warnings" not in text


def test_an_effect_outside_the_library_keeps_its_name(result, bare, tmp_path):
    ranking = (EffectProbability("loose_bolt", 0.9),)
    text = bare(dataclasses.replace(result, ranking=ranking, tie_group=("hum", "loose_bolt")), tmp_path)
    assert text.count("loose bolt") == 2


@pytest.mark.parametrize(
    ("sources", "expected", "title"),
    [
        (["measured"] * 6, "6 recordings, stated to be measured", "Model against measurement"),
        (
            ["measured"] * 4 + ["simulated"] * 2,
            "2 of 6 recordings are SURROGATE:",
            "Model against recordings",
        ),
        (["measured"] * 5 + [None], "do not state whether", "Model against recordings"),
    ],
)
def test_origins(result, bare, tmp_path, sources, expected, title):
    text = bare(result, tmp_path, sources=sources)
    assert expected in text
    assert text.startswith(title)


def test_few_recordings_are_warned_of(locators, bare, tmp_path):
    few = dataclasses.replace(locators.null, n_recordings=3)
    text = bare(GapResult(few, BASE), tmp_path)
    assert "Only 3 recordings: with fewer than 5, only large differences can be shown." in text


def test_what_stays_is_told(result, locators, bare, tmp_path):
    text = bare(dataclasses.replace(result, where_after=locators.before), tmp_path)
    rest = text.split("What remains unexplained")[1]
    n = len({row.cell for row in locators.before.flagged})
    assert f"{n} of {locators.before.n_cells} numbers still differ" in rest
    assert re.search(r"third octave at 50.1 Hz: \d+ dB more than simulated", rest)


def test_as_many_numbers_are_compared_throughout(parsed, result, locators, bare, tmp_path):
    """Each in two ways, which is said, and does not make two numbers of it."""
    n = locators.before.n_cells
    assert f"summarised by {n} numbers, in the groups on the left. Each number is compared twice" in words(
        parsed
    )
    for after in (locators.null, locators.before):
        text = bare(dataclasses.replace(result, where_after=after), tmp_path)
        stated = re.findall(r"(?:of|by|All) (\d+) numbers", text)
        assert stated.count(str(n)) >= 2
        assert set(stated) == {str(n)}


def test_a_number_that_differs_in_two_ways_counts_once(result, locators, bare, tmp_path):
    null = locators.null
    first = [row.of for row in null.rows if row.cell == null.rows[0].cell]
    assert first == ["mean", "spread"]
    rows = tuple(
        dataclasses.replace(row, p=1e-3 if row.cell == null.rows[0].cell else 1.0, difference=6.0206)
        for row in null.rows
    )
    both = dataclasses.replace(null, rows=rows)
    text = bare(dataclasses.replace(result, where_after=both), tmp_path)
    assert f"1 of {both.n_cells} numbers still differs, in its mean or in how much recordings vary" in text
    assert "varies 2.0 times as much from one recording to the next as simulated" in text


def test_no_jargon_of_spreads(result, locators, bare, tmp_path):
    for after in (locators.null, locators.before):
        text = bare(dataclasses.replace(result, where_after=after), tmp_path)
        assert "spread" not in text.lower()


# -- numbers


def test_recordings_that_agreement_would_take(locators):
    """Ranges half as wide need four times the sum of the inverse numbers."""
    row = next(row for row in locators.null.rows if row.cell.name == "third octave at 398 Hz")
    row = dataclasses.replace(row, of="mean", low=-3.0, high=3.0)
    where = dataclasses.replace(locators.null, rows=(row,), n_recordings=10, n_simulated=100)
    # 1/10 + 1/100 falls to a quarter with 40 recordings against 400
    text = _recordings_for_agreement(where)
    assert "about 40 recordings, compared with 400 simulated ones" in text
    assert "third octave at 398 Hz" in text


@pytest.mark.parametrize(
    ("values", "unit", "text"),
    [
        ([1.2e-5], "m", "12 µm"),
        ([2e-6, 5e-5], "m", "2 to 50 µm"),
        ([1.02345], "1", "1.02"),
        ([140.4, math.inf], "Hz", "140 to infinite Hz"),
        ([5149.0, 12_345.0], "Nm/rad", "5150 to 12300 Nm/rad"),
        ([0.0072], "kg m2", "0.0072 kg m²"),
    ],
)
def test_quantities(values, unit, text):
    assert quantity(values, unit).replace("\N{NO-BREAK SPACE}", " ") == text


@pytest.mark.parametrize(("value", "text"), [(7.25, "7.2"), (111.1, "110"), (12_345.0, "12000")])
def test_rounding(value, text):
    assert rounded(value) == text


# -- refusals


def test_reports_refuse(result, tmp_path):
    with pytest.raises(ValueError, match=r"must end in .html"):
        write_gap_report(result, tmp_path / "x.txt")
    with pytest.raises(FileNotFoundError, match="nowhere does not exist"):
        write_gap_report(result, tmp_path / "nowhere" / "x.html")
    assert not list(tmp_path.iterdir())
