"""The report of a count: the answer first, escaped, whole, and honest about what it rests on."""

import dataclasses
import json
import re
import weakref

import numpy as np
import pytest
from numpy.testing import assert_allclose
from pages import assert_in_order, parse, read_words, summary_of, unpacked, without_pictures, words
from small_model import RATE, SPEED, recording, small_model, unlike_training

from cyclofeat.counting.model.radial_wear import WearDepth
from cyclofeat.plotting import SpectrumDisplay
from cyclofeat.report import CountedRecording, write_count_report
from cyclofeat.report._figures import window_spans


@pytest.fixture(scope="module")
def model():
    return small_model()


def count(model, one, name="a.npz"):
    return CountedRecording(name, one, model.count(one))


def summary(model, *counted, **options):
    return summary_of(write_count_report, model, counted, **options)


@pytest.fixture(scope="module")
def counted(model):
    worn = recording((4, 5, 6), seed=100, turns=2)
    found = {"<b>worn</b>": worn, "healthy": recording((), seed=102), "strange": unlike_training()}
    return [count(model, one, f"{name}.npz") for name, one in found.items()]


@pytest.fixture
def drawn(monkeypatch):
    """What would have been drawn, in place of pictures: what pictures show in words, with their plots."""
    made = {}

    def draw_picture(draw, size, alt, *, plot=None):
        made[alt] = plot and plot.to_dict()
        return {"image": "data:,", "alt": alt, "width": 1, "height": 1, "plot": made[alt]}

    monkeypatch.setattr("cyclofeat.report._figures.draw_picture", draw_picture)
    return made


@pytest.fixture(scope="module")
def page(model, counted, tmp_path_factory):
    path = tmp_path_factory.mktemp("count") / "count.html"
    write_count_report(model, counted[:1], path, settings={"model file": "<model>"})
    return path.read_text(encoding="utf-8")


@pytest.mark.slow
def test_the_depth_of_the_wear_is_beside_the_count(model, counted, drawn, tmp_path):
    depths = [WearDepth(52.4, 41.0, 66.0, 0.9, 12.0), WearDepth(None, 0.0, 12.0, 0.9, 12.0)]
    worn, healthy = (
        dataclasses.replace(one, count=dataclasses.replace(one.count, wear_um=depth))
        for one, depth in zip(counted, depths, strict=False)
    )
    text = read_words(write_count_report(model, [worn, healthy], tmp_path / "count.html"))
    assert "52.4 um; 90 % interval 41 to 66 um" in text  # in the table
    assert "Depth of the wear 52.4 um 90 % interval 41 to 66 um" in text  # beside the count
    assert "Depth of the wear below what can be seen up to 12 um may be there" in text
    text = read_words(write_count_report(model, counted[:2], tmp_path / "count.html"))
    assert "Depth of the wear" not in text


@pytest.mark.slow
def test_the_count_comes_before_all_evidence(page):
    order = [
        "Worn lobes: <b>worn</b>.npz", "All recordings are SIMULATED", "3 worn lobes probability",
        "5, 6, 7 as numbered on the disc",
        "Against the training Inside this recording resembles the training data", "the count agrees",
        "probabilities are not calibrated", "Evidence", "The disc", "How sure", "Torque", "Spectrum",
        "Orders", "Strength of the lobe lines", "What the words mean",
        "Not calibrated: it ranks the counts", "In the code: lobe_slot_rms , std of the whitened",
        "The model", "bursts <i>by hand</i>", "Made from",
        "model file <model>",
    ]  # fmt: skip
    assert_in_order(words(parse(page)), order)


@pytest.mark.slow
def test_the_page_is_whole_and_escaped(page):
    assert len(page) < 1e6
    bare = without_pictures(page)
    assert "<b>worn" not in bare
    assert "<model>" not in bare
    parsed = parse(page)
    addresses = [value for _, name, value in parsed.attributes if name in ("src", "href", "xlink:href")]
    # disc, four kinds of features, and plots of torque, spectrum and orders
    assert len(addresses) == 5 + 3
    assert all(address.startswith("data:image/svg+xml;base64,") for address in addresses)


@pytest.mark.slow
def test_plots_hold_the_numbers_of_the_recording(page, counted):
    torque, spectrum, orders = (json.loads(data) for data in re.findall(r'json">(.*?)</script>', page))
    recorded = counted[0].recording.torque
    assert torque["x"] == {"first": 0, "last": (recorded.size - 1) / 2000, "n": recorded.size}
    assert_allclose(unpacked(torque["lines"][0]["columns"][0]), recorded, rtol=1e-7)
    assert [span["label"] for span in torque["spans"]] == ["3 worn", "3 worn"]
    assert spectrum["view"] == [0, 400]
    amplitudes = SpectrumDisplay(counted[0].recording).values[1 : spectrum["x"]["n"] + 1]
    assert_allclose(unpacked(spectrum["lines"][0]["columns"][0]), amplitudes, atol=1e-6)
    kinds = {line["name"] for line in orders["lines"]}
    assert "multiples of the lobes' passage (order 16/15)" in kinds
    assert len(kinds) == 4


def test_a_long_recording_shares_the_room_of_the_page_and_keeps_its_peaks(model, monkeypatch, drawn):
    monkeypatch.setattr("cyclofeat.report._figures.MOST_SAMPLES", 1000)
    long = recording((4,), seed=300, turns=2)
    torque = long.torque.copy()
    torque[5000] = 40.0
    one = CountedRecording("long.npz", long.replace(torque=torque), model.count(long))
    plot = summary(model, one, one)["sections"][0]["pictures"]["torque"]["plot"]
    time, values = unpacked(plot["x"]), unpacked(plot["lines"][0]["columns"][0])
    assert time.size + values.size <= 500
    assert values.max() == 40.0
    assert time[values.argmax()] == pytest.approx(2.5)
    # what is drawn was recorded, at the time where it is drawn
    assert_allclose(values, torque[np.round(time * 2000).astype(int)], rtol=1e-6)
    assert plot["note"].startswith("Of every 58 samples the page holds the smallest and the largest")


def test_windows_are_answered_one_by_one(model):
    healthy, worn = recording((), seed=301), recording((4, 5, 6), seed=302)
    strange = unlike_training()
    torque = np.concatenate([one.torque for one in (healthy, strange, worn)])
    joined = worn.replace(torque=torque, angle=2 * np.pi * SPEED * np.arange(torque.size) / RATE)
    answers = model.count(joined).windows
    assert [answer.defect_count for answer in answers][::2] == [0, 3]
    assert [bool(answer.reason) for answer in answers] == [False, True, False]
    length = round(0.98 * 15 * 128) / 128 / SPEED  # 128 samples per input turn
    assert [answer.start_s for answer in answers] == pytest.approx([0, length, 2 * length])
    assert answers[2].stop_s == pytest.approx(3 * length)
    alone = [model.count(one).probability for one in (healthy, worn)]
    assert answers[0].probability == pytest.approx(alone[0][0], abs=2e-3)
    spans = window_spans(answers)
    assert [span.label for span in spans] == ["0 worn", "refused", "3 worn"]
    assert [span.amiss for span in spans] == [False, True, False]
    assert spans[1].text.startswith("window 2: refused, outside the training data: ")


def test_several_recordings_have_a_table_first(model, counted, drawn, tmp_path):
    failures = {"bad.csv": "bad.csv: <i>empty</i>"}
    text = read_words(write_count_report(model, counted, tmp_path / "all.html", failures=failures))
    tiles = [
        "Counted 2 of 4 1 with no worn lobe, 1 with 3 worn lobes", "Worst 3 worn lobes <b>worn</b>.npz",
        "Agreement 2 of 2 counts agree with the labels in the files",
        "Refused 1 1: its lines could as well be those of a disc at another speed than the stated ... RPM",
        "Could not be counted 1 bad.csv", "Recording Worn lobes",
        "strange.npz - - - - refused : its lines could as well be those of a disc",
        "bad.csv - not counted : bad.csv: <i>empty</i>", "Against the training",
    ]  # fmt: skip
    assert_in_order(text, tiles)
    assert "2 of 3 recordings are SIMULATED" in text
    refused = text[text.rindex("strange.npz") :]
    assert_in_order(refused, ["Refused Why:", "outside the training data"])
    assert "Against the training Outside" in refused


def test_each_section_ends_with_what_to_do_next(model, counted, drawn, tmp_path):
    advice = ["Confirm the count", "Record again after some weeks", "Train a model for your rig"]
    for one, words_of_advice in zip(counted, advice, strict=True):
        text = read_words(write_count_report(model, [one], tmp_path / "one.html"))
        assert words_of_advice in text.rpartition("What to do next")[2].partition("What the words mean")[0]


@pytest.mark.slow
def test_a_page_of_24_recordings_is_small(model, tmp_path):
    worn = count(model, recording((4, 5, 6), seed=100, turns=5))
    path = write_count_report(model, [worn] * 24, tmp_path / "many.html")
    assert path.stat().st_size < 3e6


def test_sections_go_first_to_recordings_that_need_a_look(model, counted, drawn):
    found = summary(model, *counted, most_sections=1)
    assert [section["name"] for section in found["sections"]] == ["strange.npz"]
    assert found["n_more"] == 2
    assert [bool(row["anchor"]) for row in found["rows"]] == [False, False, True]
    json.dumps(found)


def test_only_recordings_with_a_section_stay_in_memory(model, drawn):
    alive, most = [], []

    def arriving():
        for seed in range(6):
            one = recording((), seed=200 + seed)
            alive.append(weakref.ref(one))
            counted = count(model, one, str(seed))
            del one
            yield counted
            del counted
            most.append(sum(made() is not None for made in alive))

    found = summary_of(write_count_report, model, arriving(), most_sections=2)
    assert [row["name"] for row in found["rows"]] == list("012345")
    assert len(found["sections"]) == 2
    assert max(most) <= 3  # those with a section, and the one in hand


def test_failures_may_be_entered_while_recordings_are_counted(model, counted, drawn):
    failures = {}

    def arriving():
        yield counted[0]
        failures["late.csv"] = "empty"

    found = summary_of(write_count_report, model, arriving(), failures=failures)
    assert found["failures"] == [{"name": "late.csv", "reason": "empty"}]


def test_a_refused_recording_of_unknown_speed_has_no_lobe_lines(model, drawn):
    counted = [count(model, one) for one in (unlike_training(), recording((4, 5, 6), seed=100))]
    refused, sound = summary(model, *counted)["sections"]
    assert (refused["refused"], refused["speed_known"], refused["features"]) == (True, False, [])
    assert refused["recorded"]["speed measured"] == "not found: refused, and without a tachometer"
    assert refused["pictures"].keys() == {"torque", "spectrum"}
    assert refused["pictures"]["spectrum"]["plot"]["marks"] == []
    assert (sound["refused"], sound["speed_known"], len(sound["features"])) == (False, True, 4)
    assert sound["pictures"].keys() == {"torque", "spectrum", "orders", "lobe_map"}
    of_lobes, of_input = sound["pictures"]["spectrum"]["plot"]["marks"]
    assert of_lobes["at"][0] * 15 / 16 == pytest.approx(of_input["at"][0]) == pytest.approx(SPEED, rel=1e-3)
    assert [*drawn][-1].startswith("Features of the recording beside training windows with 3, 1 worn lobes")


def test_a_refused_recording_with_a_tachometer_keeps_its_lines(model, drawn):
    strange = unlike_training()
    turning = strange.replace(angle=2 * np.pi * SPEED * np.arange(strange.n_samples) / RATE)
    (section,) = summary(model, count(model, turning))["sections"]
    assert (section["refused"], section["speed_known"]) == (True, True)
    assert section["pictures"]["spectrum"]["plot"]["marks"][1]["at"][0] == pytest.approx(SPEED)


@pytest.mark.slow
def test_speeds_stated_and_measured_stand_apart(model, drawn):
    by_tachometer = recording((4, 5, 6), seed=100, slowing=0.01)
    without = by_tachometer.replace(angle=None, angle_is_absolute=False, speed_rpm=None)
    counted = [count(model, one) for one in (by_tachometer, without)]
    first, second = (section["recorded"] for section in summary(model, *counted)["sections"])
    assert first["speed stated"] == "500 RPM, the nominal speed by file or option"
    assert first["speed measured"] == "497.5 RPM, by the tachometer"
    assert second["speed stated"] == "none"
    speed, by = second["speed measured"].split(" RPM, ")
    assert float(speed) == pytest.approx(497.5, abs=1.5)
    assert by == "by the lobe lines"


def test_lobes_without_an_absolute_angle_are_said_to_be_relative(model, drawn):
    turned = recording((4, 5, 6), seed=100).replace(angle=None, angle_is_absolute=False)
    (section,) = summary(model, count(model, turned))["sections"]
    assert section["relative"]
    assert any("relative" in warning for warning in section["warnings"])


def test_a_wrong_count_stands_out(model, drawn):
    one = recording((4, 5, 6), seed=100).replace(worn_lobes=None, defect_count=0)
    (row,) = summary(model, count(model, one))["rows"]
    assert (row["count"], row["stated"], row["wrong"]) == (3, 0, True)


@pytest.mark.parametrize(
    ("options", "message"),
    [({"counted": []}, "counted must hold"), ({"most_sections": -1}, "most_sections must not be negative")],
)
def test_reports_refuse(model, counted, options, message, tmp_path):
    with pytest.raises(ValueError, match=message):
        write_count_report(model, **({"counted": counted[:1], "path": tmp_path / "a.html"} | options))
    assert not list(tmp_path.iterdir())


def test_only_failures_make_a_page_too(model, tmp_path):
    text = read_words(write_count_report(model, [], tmp_path / "a.html", failures={"x.csv": "x: empty"}))
    assert "x.csv could not be counted: x: empty" in text
