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

import numpy as np
import pytest
from pages import parse, words

from cyclofeat.gap import GapLocator, NuisancePrior, make_bank
from cyclofeat.report import GapFindings, summarise_gap, write_gap_report
from cyclofeat.report._gap import _needed
from cyclofeat.report._gap_numbers import quantity, rounded
from cyclofeat.simulators import CompositeSimulator, Hum, PinErrors, Rig

RATE = 6400.0
BASE = Rig.r1().replace(load_drift_nm=0.0, noise_nm=0.05)
LOW_PASS = "torque_meter_low_pass"


@pytest.fixture(scope="module")
def locators(tmp_path_factory):
    """Of strong hum, and of nothing, by one small bank; the latter also stands for what a fit leaves."""
    options = {"n_samples": 11_520, "sampling_rate": RATE}
    hum, none = (
        make_bank(
            CompositeSimulator(BASE, effects), NuisancePrior(), [0, 3], n=6, random_state=102, **options
        )
        for effects in ([Hum(2.0)], [])
    )
    cache = tmp_path_factory.mktemp("banks")
    before, null = (
        GapLocator(RATE, BASE, n_bank=24, n_permutations=499, cache=cache).fit(bank.X, y=bank.counts)
        for bank in (hum, none)
    )
    return SimpleNamespace(before=before, null=null)


def compared(**alternatives):
    return [
        SimpleNamespace(alternative=name, condition=condition, grr=grr, low=grr - 0.05, high=grr + 0.04)
        for name, ratios in alternatives.items()
        for condition, grr in zip(("all", "seen", "unseen"), ratios, strict=True)
    ]


def scored(**changes):
    distances = [
        SimpleNamespace(alternative=name, condition="all", family=family, distance=distance)
        for name, distance in (("nothing", 4.25), ("after", 1.5), ("floor", 1.125))
        for family in ("spectrum", "overall")
    ]
    found = {
        "comparison_": compared(
            after=(0.91, 0.93, 0.88), nothing=(0, 0, 0), equaliser=(0.74, 0.95, 0.41), oracle=(0.97,) * 3
        ),
        "distances_": distances, "grr_": 0.91, "grr_ci_": (0.86, 0.95), "undefined_": "",
        "beats_": {"equaliser": {"all": 0.99, "seen": 0.3, "unseen": 1.0}},
    }  # fmt: skip
    return SimpleNamespace(**(found | changes))


@pytest.fixture(scope="module")
def findings(locators):
    """A complete set, with surrogate recordings."""
    return GapFindings(
        result={
            "verdict": "disagree",
            "p": 0.018,
            "effects": [
                {"id": "hum", "probability": 0.62, "theta": {"amplitude_nm": 1.0}, "interval": {}},
                {"id": "pin_errors", "probability": 0.9},
            ],
            "ranking": [{"id": "hum", "probability": 0.62}, {"id": LOW_PASS, "probability": 0.31}],
            "tie_group": ["hum", LOW_PASS],
            "unknown": False,
            "next_measurement": "a record with the motor off, or at another speed",
            "warnings": ["No tachometer."],
        },
        locator=locators.before,
        locator_after=locators.null,
        report=scored(),
        effects=(Hum(2.0), PinErrors(1.2e-5)),
        theta={"hum.amplitude_nm": 1.987, "pin_errors.rms": 1.2e-5},
        theta_ci={"hum.amplitude_nm": (1.91, 2.06), "pin_errors.rms": (2e-6, 5e-5)},
        identifiable={"hum.amplitude_nm": True, "pin_errors.rms": False},
        at_bound={"hum.amplitude_nm": False, "pin_errors.rms": True},
        sources=["surrogate"] * 6,
        settings={"recordings": "rig/<script>alert(1)</script>.csv"},
        warnings=["No tachometer.", "One record was clipped."],
        seconds=83.4,
    )


@pytest.fixture(scope="module")
def page(findings, tmp_path_factory):
    path = write_gap_report(tmp_path_factory.mktemp("gap") / "gap.html", findings)
    return path.read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def parsed(page):
    return parse(page)


@pytest.fixture
def bare(monkeypatch):
    """Text of a report whose pictures are not drawn."""
    drawn = {"light": "data:,", "dark": "data:,", "alt": "x", "width": 1, "height": 1}
    monkeypatch.setattr("cyclofeat.report._figures.picture", lambda *_: drawn)

    def text(findings, tmp_path):
        path = write_gap_report(tmp_path / "gap.html", findings)
        return words(parse(path.read_text(encoding="utf-8")))

    return text


# -- the complete report


def test_all_is_told(parsed):
    text = words(parsed)
    for part in (
        "Model and recordings disagree",
        "in at most 1 of 56 such comparisons (p = 0.018, 6 recordings against 24 simulated ones)",
        "Mains hum in the torque signal hum",
        "More likely than not: probability 0.62, among the effects considered. It has look-alikes",
        "amplitude 1.99 Nm 1.91 to 2.06 Nm",
        "Position errors of the pins",
        "12 µm 2 to 50 µm not fixed by these recordings: other values do as well; at an end of what was",
        "together they have a probability of 0.93",
        "Low-pass in the torque meter - told apart by a tap test with the filter switched off",
        "What to measure next A record with the motor off, or at another speed.",
        "the correction closed 91 % of the gap (range 86 to 95 %)",
        "93 % with counts of worn lobes seen in the fit and 88 % with counts never seen in the fit",
        "with 74 % against 91 % (with recordings drawn anew, the named effect is nearer in 99 % of draws)",
        "With counts seen in the fit, “equaliser and shaped noise (black box)” does better, with 95 %",
        "counts never seen in the fit, “equaliser and shaped noise (black box)” comes nearest, with 41 %",
        "the true simulator 97 %",
        "spectrum in third octaves 4.25 1.50 1.12",
        "What stays unexplained",
        "One record was clipped.",
        "computing time 83 s",
        "seed of the comparison 0",
        "numpy",
    ):
        assert part in text, part
    assert text.count("No tachometer.") == 1


def test_the_answer_comes_before_all_else(parsed):
    headings = [
        "The answer", "Where recordings and model differ", "What is missing in the model",
        "How far the gap shrank", "What stays unexplained", "Pictures before the correction", "Warnings",
        "Method in short", "Made from",
    ]  # fmt: skip
    text = words(parsed)
    places = [text.index(heading) for heading in headings]
    assert places == sorted(places)
    tiles = text[: places[1]]
    for part in ("Mains hum in the torque signal", "1.99 Nm", "91 %", "2 warnings"):
        assert part in tiles, part


def test_the_clearest_difference_is_told_in_words(parsed, locators):
    line = next(
        row for row in locators.before.table_ if row.cell.name == "input order 6" and row.of == "mean"
    )
    assert line.p <= 0.05
    assert re.search(rf"input order 6 {line.effect:.0f} dB more \+\d+ to \+\d+ dB", words(parsed))


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


def test_the_same_findings_give_the_same_text(findings, bare, tmp_path):
    assert bare(findings, tmp_path) == bare(findings, tmp_path)


# -- parts that are not there


@pytest.mark.usefixtures("bare")
def test_the_summary_is_plain(findings):
    summary = summarise_gap(findings)
    told = json.loads(json.dumps(summary))
    assert told.keys() == summary.keys()
    assert told["missing"] == summary["missing"]


def test_without_hold_out_it_says_how_to_get_a_ratio(findings, bare, tmp_path):
    text = bare(dataclasses.replace(findings, report=None, locator_after=None), tmp_path)
    assert "Not tested: no recordings were held out." in text
    assert "--hold-out DIR" in text
    assert "Gap closed on" not in text
    assert "the recordings were not compared with the corrected simulator" in text


def test_an_undefined_ratio_has_its_reason(findings, bare, tmp_path):
    rows = compared(after=(math.nan,) * 3, equaliser=(math.nan,) * 3)
    report = scored(
        grr_=math.nan, grr_ci_=(math.nan,) * 2, comparison_=rows, undefined_="there is no gap to close."
    )
    text = bare(dataclasses.replace(findings, report=report), tmp_path)
    assert "No share of the gap can be stated: there is no gap to close." in text
    assert "Gap closed on recordings not used not defined" in text
    assert "nan" not in text.lower().split()


def test_one_condition_without_a_ratio_has_its_reason(findings, bare, tmp_path):
    rows = compared(after=(0.9, 0.9, math.nan))
    rows[2].undefined = "one held-out recording in this condition"
    text = bare(dataclasses.replace(findings, report=scored(comparison_=rows)), tmp_path)
    assert "That is 90 % with counts of worn lobes seen in the fit." in text
    assert "With counts never seen in the fit no share can be stated: one held-out recording in this" in text


def test_a_gap_that_grew_is_not_called_closed(findings, bare, tmp_path):
    rows = compared(after=(-0.25, -0.2, -0.3), placebo=(0.1, 0.1, 0.1))
    report = scored(grr_=-0.25, grr_ci_=(-0.4, -0.1), comparison_=rows)
    text = bare(dataclasses.replace(findings, report=report), tmp_path)
    assert "the correction widened, by 25 %, the gap (range -40 to -10 %)" in text
    assert "“best wrong effect” does better, with 10 % against -25 %" in text


@pytest.mark.parametrize("verdict", ["equivalent", "unresolved"])
def test_without_disagreement_nothing_is_named(findings, locators, bare, tmp_path, monkeypatch, verdict):
    monkeypatch.setattr(locators.null, "_p_global", {"energy distance": 0.002})
    changed = dataclasses.replace(
        findings, result=findings.result | {"verdict": verdict}, locator=locators.null, locator_after=None
    )
    text = bare(changed, tmp_path)
    assert "What is missing" not in text
    assert "Mains hum" not in text
    assert "How far the gap shrank" not in text
    assert "disagree" not in text.split("Where recordings")[0]
    if verdict == "equivalent":
        assert "Model and recordings agree" in text
        assert f"All {len(locators.null.cells_)} numbers compared agree within 1.5 dB" in text
    else:
        assert "Cannot be told yet" in text
        assert "All numbers together hint at a difference (p = 0.002), but not at its place." in text
        assert re.search(r"it would take roughly \d+ recordings, compared with \d+ simulated ones", text)


def test_nothing_in_the_library(findings, bare, tmp_path):
    result = findings.result | {"effects": [], "unknown": True, "tie_group": [], "next_measurement": ""}
    text = bare(dataclasses.replace(findings, result=result, effects=(), report=None), tmp_path)
    assert "Missing in the model not known No effect considered explains it" in text
    assert "not that one of them is right" in text
    assert "Nothing was added to the model, so there is nothing to show." in text
    assert "held out" not in text
    assert "Its size" not in text
    assert "What to measure next" not in text
    assert "Look-alikes" not in text
    result = result | {"unknown": False}
    text = bare(dataclasses.replace(findings, result=result, effects=(), report=None), tmp_path)
    assert "Missing in the model not known No effect was accepted" in text


def test_settings_are_told_once(findings, bare, tmp_path):
    text = bare(dataclasses.replace(findings, settings={"nominal input speed": "480 RPM"}), tmp_path)
    assert text.count("nominal input speed") == 1
    assert "nominal input speed 480 RPM" in text
    assert "nominal input speed 500 RPM" in bare(findings, tmp_path)


def test_the_least_there_can_be(locators, bare, tmp_path):
    text = bare(GapFindings({}, locators.null), tmp_path)
    assert "Cannot be told yet" in text
    assert "The recordings do not state whether they were taken on a machine." in text
    text = bare(GapFindings({"verdict": "disagree"}, locators.before), tmp_path)
    assert "No effect was accepted" in text
    assert "Warnings" not in text


def test_an_effect_outside_the_library_keeps_its_name(findings, bare, tmp_path):
    result = findings.result | {"effects": [{"id": "loose_bolt"}], "ranking": [], "tie_group": ["loose_bolt"]}
    text = bare(dataclasses.replace(findings, result=result, effects=()), tmp_path)
    assert "loose bolt" in text


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
def test_origins(findings, bare, tmp_path, sources, expected, title):
    text = bare(dataclasses.replace(findings, sources=sources), tmp_path)
    assert expected in text
    assert text.startswith(title)


def test_few_recordings_are_warned_of(locators, bare, tmp_path):
    few = GapLocator(RATE, BASE, n_bank=12, n_permutations=19)
    few.__dict__.update({k: v for k, v in vars(locators.null).items() if k not in few.get_params()})
    few.measured_, few.counts_ = locators.null.measured_[:3], locators.null.counts_[:3]
    text = bare(GapFindings({}, few), tmp_path)
    assert "Only 3 recordings: with fewer than 5, only large differences can be shown." in text


def test_what_stays_is_told(findings, locators, bare, tmp_path):
    text = bare(dataclasses.replace(findings, locator_after=locators.before), tmp_path)
    rest = text.split("What stays unexplained")[1]
    single = [row for row in locators.before.table_ if row.cell.family != "together"]
    n = len({(row.cell.family, row.cell.name) for row in single if row.p <= 0.05})
    assert f"{n} of {len(locators.before.cells_)} numbers still differ" in rest
    assert re.search(r"input order 6: \d+ dB more than simulated", rest)


def test_as_many_numbers_are_compared_throughout(parsed, findings, locators, bare, tmp_path):
    """Each in two ways, which is said, and does not make two numbers of it."""
    n = len(locators.before.cells_)
    assert f"summarised by {n} numbers, in the groups on the left. Each is compared twice" in words(parsed)
    for after in (locators.null, locators.before):
        text = bare(dataclasses.replace(findings, locator_after=after), tmp_path)
        stated = re.findall(r"(?:of|by|All) (\d+) numbers", text)
        assert stated.count(str(n)) >= 2
        assert set(stated) == {str(n)}


def test_a_number_that_differs_in_two_ways_counts_once(findings, locators, bare, tmp_path):
    both = GapLocator(RATE, BASE, n_bank=12, n_permutations=19)
    both.__dict__.update({k: v for k, v in vars(locators.null).items() if k not in both.get_params()})
    at = [k for k, row in enumerate(both.table_) if row.cell == both.cells_[0]]
    assert [both.table_[k].of for k in at] == ["mean", "spread"]
    changes = {at[0]: 1e-3, at[1]: 1e-3}
    both.table_ = [dataclasses.replace(row, p=changes.get(k, 1.0), effect=6.0206)
                   for k, row in enumerate(both.table_)]  # fmt: skip
    text = bare(dataclasses.replace(findings, locator_after=both), tmp_path)
    assert (
        f"1 of {len(both.cells_)} numbers still differs, in its mean or in how much recordings vary" in text
    )
    assert "varies 2.0 times as much from one recording to the next as simulated" in text


def test_no_jargon_of_spreads(findings, locators, bare, tmp_path):
    for after in (locators.null, locators.before):
        text = bare(dataclasses.replace(findings, locator_after=after), tmp_path)
        assert "spread" not in text.lower()


# -- numbers


def test_recordings_that_agreement_would_take():
    """Ranges half as wide need four times the sum of the inverse numbers."""
    cell = SimpleNamespace(unit="dB", family="spectrum", name="third octave at 400 Hz")
    row = SimpleNamespace(cell=cell, of="mean", low=-3.0, high=3.0, spread=1.0)
    locator = SimpleNamespace(
        table_=[row], cells_=[cell], measured_=np.zeros((10, 1)), simulated_=np.zeros((100, 1))
    )
    # 1/10 + 1/100 falls to a quarter with 40 recordings against 400
    assert "roughly 40 recordings, compared with 400 simulated ones" in _needed(locator)
    assert "third octave at 400 Hz" in _needed(locator)


@pytest.mark.parametrize(
    ("values", "unit", "text"),
    [
        ([1.2e-5], "m", "12 µm"),
        ([2e-6, 5e-5], "m", "2 to 50 µm"),
        ([1.02345], "1", "1.02"),
        ([140.4, math.inf], "Hz", "140 to infinite Hz"),
    ],
)
def test_quantities(values, unit, text):
    assert quantity(values, unit).replace("\N{NO-BREAK SPACE}", " ") == text


@pytest.mark.parametrize(("value", "text"), [(7.25, "7.2"), (111.1, "110"), (12_345.0, "12000")])
def test_rounding(value, text):
    assert rounded(value) == text


# -- refusals


def test_reports_refuse(findings, tmp_path):
    wrong = dataclasses.replace(findings, result={"verdict": "maybe"})
    with pytest.raises(ValueError, match=r"result\['verdict'\] must be .* got 'maybe'"):
        write_gap_report(tmp_path / "x.html", wrong)
    with pytest.raises(FileNotFoundError, match="nowhere does not exist"):
        write_gap_report(tmp_path / "nowhere" / "x.html", findings)
    assert not list(tmp_path.iterdir())
