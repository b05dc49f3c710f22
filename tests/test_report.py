"""Reports: complete, self-contained, escaped, and honest about what they show."""

import base64
import html
import json
import re
import sys
from xml.etree import ElementTree

import numpy as np
import pytest
from pages import parse, without_pictures

from cyclofeat import Recording, plotting
from cyclofeat.report import summarise_demo, write_demo_report

RATE = 25_600


def recording(lobes, **labels):
    """One output turn with a burst at each worn lobe, seen by a tachometer."""
    phi = 2 * np.pi * 500 / 60 * np.arange(46_080) / RATE
    cam = (16 * phi + np.pi) / (2 * np.pi)  # in lobes
    torque = 22 + np.random.default_rng(0).normal(0, 0.05, phi.size)
    for lobe in lobes:
        torque += np.exp(-((((cam - lobe + 7.5) % 15 - 7.5) / 0.1) ** 2))
    known = {
        "angle": phi, "angle_is_absolute": True, "assembly": "R1-7", "source": "surrogate",
        "worn_lobes": lobes, "speed_rpm": 500,
    }  # fmt: skip
    return Recording(torque, RATE, **(known | labels))


def predicted(count, lobes, **more):
    probability = {str(c): 0.93 if c == count else 0.01 for c in range(8)}
    by_lobe = [0.9 if lobe in lobes else 0.05 for lobe in range(15)]
    return {
        "defect_count": count,
        "probability": probability,
        "lobes": lobes,
        "lobe_probability": by_lobe,
    } | more


CONTENT = {
    "title": "Worn lobes & torque",
    "provenance": {"rig": "R1", "seed": 1},
    "accuracy_rows": [
        {"method": "LobeMap", "accuracy": 0.946, "low": 0.917, "high": 0.971, "mean_absolute_error": 0.07},
        {"method": "Shannon", "accuracy": 0.158, "low": 0.11, "high": 0.2, "mean_absolute_error": 2.3},
    ],
    "examples": [
        {"recording": recording(()), "heading": "Healthy", "predicted": predicted(0, [])},
        {
            "recording": recording((6, 7, 8)),
            "heading": "Worn",
            "predicted": predicted(4, [5, 6, 7, 8]),
            "outline": 0.06 * np.exp(2j * np.pi * np.arange(300) / 300),
        },
    ],
    "predictions": [
        {
            "file": "<script>alert(1)</script>.npz", "true": 3, "predicted": 3, "probability": 0.998,
            "true_lobes": (0, 1, 14), "lobes": [1, 0, 14], "result": {"ignored": True},
        },
        {"file": "b.npz", "true": 0, "predicted": 1, "probability": 0.51, "true_lobes": (), "lobes": [3]},
    ],
    "confusion": [[5, 1], [0, 6]],
    "class_labels": [0, 1],
    "notes": ["Rig & drift are assumptions."],
}  # fmt: skip


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    path = write_demo_report(tmp_path_factory.mktemp("report") / "report.html", **CONTENT)
    return path.read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def parsed(page):
    return parse(page)


def test_all_is_told(parsed):
    text = " ".join(" ".join(parsed.text).split())
    for part in (
        "Worn lobes & torque",
        "1 of 2 surrogate recordings counted right",
        "0.946",
        "0.917 to 0.971",
        "0.110 to 0.200",
        "2.30",
        "a guess: 0.5",
        "Healthy",
        "True: no worn lobe. Predicted: no worn lobe (probability 0.93).",
        "True: 3 worn lobes: 7, 8, 9. Predicted: 4 worn lobes: 6, 7, 8, 9 (probability 0.93) wrong count",
        "1, 2, 15",
        "> 0.99",
        "Confusion of LobeMap",
        "Rig & drift are assumptions.",
        "seed",
    ):
        assert part in text, part


def test_the_head_says_surrogate_and_nothing_says_otherwise(page):
    head = without_pictures(page).split("</header>")[0]
    assert "SURROGATE" in head
    assert "simulated torque with simulated brake drift" in " ".join(head.split())
    assert "measured" not in without_pictures(page).lower()


def test_values_are_escaped(page):
    assert "<script" not in page
    assert html.escape("<script>alert(1)</script>.npz") in page


def test_the_file_needs_nothing_else(page, parsed):
    assert "http://" not in page
    assert "https://" not in page
    assert not {"script", "link", "iframe", "object", "base"} & set(parsed.tags)
    for tag, name, value in parsed.attributes:
        if name in ("src", "srcset", "href", "action", "poster"):
            assert value.startswith("data:image/svg+xml;base64,"), (tag, name, value[:40])
    assert not re.search(r"url\(|@import", without_pictures(page))


def test_there_is_a_picture_of_everything_for_both_schemes(parsed):
    classes = [value for tag, name, value in parsed.attributes if (tag, name) == ("img", "class")]
    assert classes == ["on-light", "on-dark"] * 7  # three for each example and the confusion matrix
    sources = [value for tag, name, value in parsed.attributes if (tag, name) == ("img", "src")]
    for source in sources:
        assert ElementTree.fromstring(base64.b64decode(source.split(",")[1])).tag.endswith("svg")
    assert len(set(sources)) == len(sources)
    alternatives = [value for tag, name, value in parsed.attributes if (tag, name) == ("img", "alt")]
    assert all(alternatives)


def test_pictures_follow_the_scheme_of_the_screen_and_not_of_the_printer(page):
    assert "@media screen and (prefers-color-scheme: dark)" in page
    assert "@media (prefers-color-scheme" not in page
    assert "@media print" in page


def test_the_same_values_give_the_same_file(tmp_path):
    content = CONTENT | {"examples": []}
    first, again = (write_demo_report(tmp_path / name, **content) for name in ("a.html", "b.html"))
    assert first.read_bytes() == again.read_bytes()


def test_the_summary_is_plain():
    summary = summarise_demo(**CONTENT | {"examples": CONTENT["examples"][1:]})
    assert json.loads(json.dumps(summary)) == summary
    assert summary["n_right"] == 1
    assert summary["chance"] == 0.5
    assert [example["right"] for example in summary["examples"]] == [False]


def test_a_report_can_be_bare(tmp_path):
    path = write_demo_report(tmp_path / "bare.html", title="Bare", provenance={}, accuracy_rows=[])
    parser = parse(path.read_text(encoding="utf-8"))
    assert "SURROGATE" in " ".join(parser.text)
    assert "img" not in parser.tags


@pytest.fixture
def _no_pictures(monkeypatch):
    """Examples without the time that their pictures take."""
    monkeypatch.setattr("cyclofeat.report._figures.example_pictures", lambda torques, *_: [[]] * len(torques))


@pytest.mark.usefixtures("_no_pictures")
def test_lobes_counted_from_the_first_sample_are_drawn_so(monkeypatch):
    made, texts = [], []
    original = plotting.LobeMapDisplay.from_recording
    monkeypatch.setattr(
        plotting.LobeMapDisplay,
        "from_recording",
        lambda *args, **kwargs: made.append(original(*args, **kwargs)) or made[-1],
    )
    for absolute in (True, False):
        example = {
            "recording": recording((3,)),
            "heading": "x",
            "predicted": predicted(1, [3], lobes_absolute=absolute),
        }
        summary = summarise_demo(title="", provenance={}, accuracy_rows=[], examples=[example])
        texts.append(summary["examples"][0]["predicted"])
    assert texts == [
        "1 worn lobe: 4 (probability 0.93)",
        "1 worn lobe: 4 counted from the first sample (probability 0.93)",
    ]
    assert [display.absolute for display in made] == [True, False]
    assert [display.worn_lobes for display in made] == [(3,), None]


@pytest.mark.usefixtures("_no_pictures")
def test_probabilities_may_be_a_list_and_labels_may_be_missing():
    example = {
        "recording": recording((), defect_count=None, worn_lobes=None, assembly=None),
        "heading": "x",
        "predicted": {"defect_count": 1, "probability": [0.25, 0.75], "lobes": [0], "lobe_probability": []},
    }
    (found,) = summarise_demo(title="", provenance={}, accuracy_rows=[], examples=[example])["examples"]
    assert found["true"] == "not stated"
    assert found["predicted"] == "1 worn lobe: 1 (probability 0.75)"
    assert found["right"] is None


def test_a_failure_leaves_the_old_report_alone(tmp_path, monkeypatch):
    path = tmp_path / "report.html"
    path.write_text("old", encoding="utf-8")
    monkeypatch.setattr("pathlib.Path.replace", lambda *_: (_ for _ in ()).throw(OSError("disk")))
    with pytest.raises(OSError, match="disk"):
        write_demo_report(path, title="new", provenance={}, accuracy_rows=[])
    assert path.read_text(encoding="utf-8") == "old"
    assert [file.name for file in tmp_path.iterdir()] == ["report.html"]


@pytest.mark.parametrize("module", ["jinja2", "matplotlib.figure"])
def test_missing_packages_are_named_with_their_remedy(module, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(ImportError, match=r'pip install "cyclofeat\[report\]"'):
        write_demo_report(tmp_path / "x.html", **CONTENT)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"accuracy_rows": [{"method": "x", "accuracy": 1.0}]}, r"accuracy_rows\[0\].*is missing"),
        ({"accuracy_rows": [CONTENT["accuracy_rows"][0] | {"high": 1.7}]}, "between 0 and 1, got 1.7"),
        ({"predictions": [{"file": "x"}]}, r"predictions\[0\].*true, predicted, probability is missing"),
        ({"examples": [{"heading": "x"}]}, r"examples\[0\].*recording is missing"),
        ({"examples": [{"heading": "x", "recording": recording((), source="measured")}]}, "surrogates"),
        ({"examples": [{"heading": "x", "recording": recording((), source=None)}]}, "source=None"),
        ({"confusion": [[1, 2]]}, "confusion must be a square"),
        ({"class_labels": [0, 1, 2]}, "class_labels must hold one label for each of 2"),
    ],
)
def test_reports_refuse(changes, message, tmp_path):
    with pytest.raises(ValueError, match=message):
        write_demo_report(tmp_path / "x.html", **(CONTENT | changes))
    assert not list(tmp_path.iterdir())


def test_a_missing_folder_is_named(tmp_path):
    with pytest.raises(FileNotFoundError, match="nowhere does not exist"):
        write_demo_report(tmp_path / "nowhere" / "x.html", title="", provenance={}, accuracy_rows=[])
