"""All pages, whole or not at all; a page of a user's own: parts in their order, escaped, pictures inside."""

from __future__ import annotations

import base64
import json
import re
import sys

import numpy as np
import pandas as pd
import pytest
from gap_answers import REMAINDER, answered
from matplotlib.figure import Figure
from pages import PICTURE, assert_in_order, evaluated, parse, without_pictures, words

from cyclofeat import Recording
from cyclofeat.plotting import TorqueDisplay
from cyclofeat.report import Report, check_page_path, write_evaluation_report, write_gap_report

HOSTILE = "<script>alert(1)</script>"
RECORDING = Recording(22 + np.sin(np.arange(200.0)), 100, run=HOSTILE)


def test_parts_stand_in_their_order_and_are_escaped(tmp_path):
    picture = tmp_path / "bench.svg"
    picture.write_text(f"<svg xmlns='http://www.w3.org/2000/svg'>{HOSTILE}</svg>", encoding="utf-8")
    figure = Figure(figsize=(2, 1))
    figure.subplots().plot([1, 2])
    report = (
        Report(f"Press {HOSTILE}")
        .add_heading(f"Heading {HOSTILE}")
        .add_text(f"One {HOSTILE}\n\nTwo\n\n")
        .add(RECORDING)
        .add_figure(figure, f"Figure {HOSTILE}")
        .add_figure(picture, "Photograph")
        .add_figure(TorqueDisplay(RECORDING), "Drawn again")
        .add_table([{f"name {HOSTILE}": HOSTILE, "value": 1.23456}, {"value": None}], f"Table {HOSTILE}")
    )
    page = without_pictures(report.write(tmp_path / "own.html").read_text(encoding="utf-8"))
    empty = Report("x").add_text("x").write(tmp_path / "empty.html").read_text(encoding="utf-8")
    parsed = parse(page)
    assert parsed.tags.count("script") == parse(empty).tags.count("script")
    parts = [
        f"Press {HOSTILE}", f"Heading {HOSTILE}", f"One {HOSTILE}", "Two", "Recording of output torque",
        f"Figure {HOSTILE}", "Photograph", "Drawn again", f"Table {HOSTILE}", "1.235",
    ]  # fmt: skip
    assert_in_order(words(parsed), parts)
    assert page.count("<p>") == 2
    assert not re.search(r"""(src|href)=["'](?!data:|#|")""", page)
    # Every picture has its text.
    assert [value for _, name, value in parsed.attributes if name == "alt"] == [
        f"Figure {HOSTILE}", "Photograph", "Drawn again",
    ]  # fmt: skip


def test_a_recording_is_drawn_whole_with_all_that_is_wrong_with_it(tmp_path):
    torque = 22 + np.random.default_rng(0).normal(size=20_000)
    torque[4000:4200] = torque[4000]
    torque[9000:9300] = torque.max() + 1
    joined = Recording.concatenate([Recording(torque, 1000, meta={"channel": HOSTILE})] * 2)
    report = Report("x").add_heading(HOSTILE).add_figure(joined.with_bad_spans([(30, 31)]))
    page = report.write(tmp_path / "x.html").read_text(encoding="utf-8")
    assert words(parse(without_pictures(page))).count(HOSTILE) == 1
    plot = json.loads(re.search(r'application/json">(.*?)</script>', page)[1])
    bands = sorted((span["label"], span["start"], span["stop"]) for span in plot["spans"])
    assert bands == [
        ("bad span", 30, 31), ("clipped samples", 9, 9.3), ("clipped samples", 29, 29.3),
        ("lost samples", 4, 4.2), ("lost samples", 24, 24.2),
    ]  # fmt: skip
    assert plot["marks"][0]["at"] == [20]
    assert (plot["axes"][1]["quantity"], plot["axes"][1]["unit"]) == (HOSTILE, "Nm")


def test_a_file_is_embedded_as_it_is(tmp_path):
    content = bytes(range(256))
    (tmp_path / "photo.PNG").write_bytes(content)
    page = Report("x").add_figure(tmp_path / "photo.PNG").write(tmp_path / "x.html")
    found = re.search(r"data:image/png;base64,([A-Za-z0-9+/=]+)", page.read_text(encoding="utf-8"))
    assert base64.b64decode(found[1]) == content


def test_a_data_frame_keeps_its_named_index_and_marks_what_is_missing(tmp_path):
    frame = pd.DataFrame({"Nm": [1.0, np.nan], "n": [100_000, 2]}, index=pd.Index(["a", "b"], name="run"))
    page = Report("x").add_table(frame).write(tmp_path / "x.html").read_text(encoding="utf-8")
    assert "run Nm n a 1 100000 b - 2" in words(parse(page))
    assert '<th scope="col">run</th><th scope="col" class="number">Nm</th>' in page


@pytest.fixture
def _no_pictures(monkeypatch):
    """Pages without the time that their pictures take."""
    monkeypatch.setattr("cyclofeat.report._figures.draw_picture", lambda *_, **__: PICTURE)


@pytest.mark.slow
@pytest.mark.usefixtures("_no_pictures")
def test_whole_pages_become_sections_whose_links_stay_apart(tmp_path, compared_hum):
    result = answered(compared_hum["hum"], remainder=REMAINDER)
    report = (
        Report("Both")
        .add_page(write_gap_report, result)
        .add_page(write_gap_report, result, title="Again")
        .add_page(write_evaluation_report, {"bayes": evaluated()})
    )
    parsed = parse(report.write(tmp_path / "both.html").read_text(encoding="utf-8"))
    ids = [value for _, name, value in parsed.attributes if name == "id"]
    links = [value for _, name, value in parsed.attributes if name == "href"]
    assert len(set(ids)) == len(ids)
    assert links == ["#part-1-warnings", "#part-2-warnings"]
    assert {link[1:] for link in links} <= set(ids)
    assert parsed.tags.count("h1") == 1
    assert_in_order(words(parsed), ["Model against recordings", "Again", "Counting on assemblies"])


@pytest.mark.parametrize(
    ("add", "error", "message"),
    [
        (lambda report: report.add("text"), TypeError, "with _repr_html_, got 'text': text, figures"),
        (lambda report: report.add_figure("a.pdf"), ValueError, "one of .gif, .* got 'a.pdf'"),
        (lambda report: report.add_figure("none.png"), FileNotFoundError, "none.png"),
        (lambda report: report.add_page(len), TypeError, "write must be one of write_count_report, .*len"),
        (lambda report: report.add_figure(3), TypeError, "figure must be a file, .* got 3"),
        (lambda report: report.add_table([1, 2]), TypeError, "a sequence of mappings, got"),
        (lambda report: report.write("x.html"), ValueError, "the report is empty"),
        (lambda report: report.add_text("x").write("x.txt"), ValueError, "must end in .html"),
    ],
)
def test_bad_input_is_one_clear_error(add, error, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(error, match=message):
        add(Report("x"))
    assert not list(tmp_path.iterdir())


@pytest.mark.usefixtures("_no_pictures")
def test_the_same_values_give_the_same_file(tmp_path):
    content = {"bayes": evaluated()}
    first, again = (write_evaluation_report(content, tmp_path / name) for name in ("a.html", "b.html"))
    assert first.read_bytes() == again.read_bytes()


@pytest.mark.parametrize("module", ["jinja2", "matplotlib.figure"])
def test_missing_packages_are_named_with_their_remedy(module, tmp_path, monkeypatch):
    content = {"bayes": evaluated()}
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(ImportError, match="pip install " + module.partition(".")[0]):
        write_evaluation_report(content, tmp_path / "x.html")
    assert not list(tmp_path.iterdir())


def test_a_page_that_cannot_be_written_is_an_error_before_the_work(tmp_path, monkeypatch):
    assert check_page_path(tmp_path / "x.HTM") == tmp_path / "x.HTM"
    with pytest.raises(FileNotFoundError, match="nowhere does not exist"):
        check_page_path(tmp_path / "nowhere" / "x.html")
    with pytest.raises(ValueError, match="must end in .html, got 'x.pdf'"):
        check_page_path(tmp_path / "x.pdf")
    monkeypatch.setitem(sys.modules, "jinja2", None)
    with pytest.raises(ImportError, match="pip install jinja2"):
        check_page_path(tmp_path / "x.html")
