"""``plot`` of recordings and results draws what displays draw; ``to_frame`` holds what the result holds."""

from __future__ import annotations

import dataclasses
import os
import subprocess
import sys

import numpy as np
import pytest
from matplotlib.figure import Figure
from pages import evaluated
from sklearn.dummy import DummyClassifier

from cyclofeat import Recording
from cyclofeat.counting import LobeCount, counts_frame, evaluate
from cyclofeat.plotting import SpectrumDisplay

SPEED = 500 / 60
COUNT = LobeCount(2, {0: 0.25, 2: 0.75}, (3, 4), (0.0, 0.1, 0.0, 0.7, 0.9), True, 3)


@pytest.fixture(scope="module")
def recording() -> Recording:
    random = np.random.default_rng(0)
    return Recording(22 + random.normal(0, 0.1, 3700), 2000, speed_rpm=500)


@pytest.fixture(scope="module")
def evaluation():
    return evaluated()


@pytest.fixture
def ax():
    return Figure().subplots()


@pytest.mark.parametrize("kind", ["torque", "spectrum", "orders", "lobes"])
def test_every_kind_of_picture_of_a_recording_is_drawn(recording, ax, kind):
    assert recording.plot(kind, ax).ax_ is ax
    assert ax.has_data()


def test_a_recording_is_drawn_as_by_the_display(recording, ax):
    recording.plot("spectrum", ax, max_frequency_hz=300.0)
    direct = SpectrumDisplay(recording).plot(Figure().subplots(), max_frequency_hz=300.0)
    np.testing.assert_array_equal(ax.lines[0].get_xydata(), direct.line_.get_xydata())


def test_a_count_is_drawn_with_its_answer_in_another_colour(ax):
    bars = COUNT.plot(ax=ax).bars_
    assert [bar.get_height() for bar in bars] == [0.25, 0.75]
    assert bars[0].get_facecolor() != bars[1].get_facecolor()
    bars = COUNT.plot("lobes", Figure().subplots()).bars_
    colours = [bar.get_facecolor() for bar in bars]
    assert [bar.get_height() for bar in bars] == [0.0, 0.1, 0.0, 0.7, 0.9]
    assert [colour == colours[-1] for colour in colours] == [False, False, False, True, True]
    with pytest.raises(ValueError, match="kind='lobes' needs a model with a locator"):
        dataclasses.replace(COUNT, lobe_probability=()).plot("lobes", ax)


def test_a_kind_that_there_is_not_is_an_error_with_those_that_there_are(recording):
    with pytest.raises(ValueError, match="one of 'torque', 'spectrum', 'orders', 'lobes', got 'wavelet'"):
        recording.plot("wavelet")


def _printed(code, folder, **environment):
    command, environment = [sys.executable, "-c", code], os.environ | environment
    return subprocess.check_output(command, cwd=folder, env=environment, text=True).strip()


@pytest.mark.slow
def test_plot_works_after_the_import_of_the_root_and_names_a_missing_matplotlib(tmp_path):
    code = (
        "import sys, cyclofeat; recording = cyclofeat.Recording([1.0, 2.0], 1.0)\n"
        "assert 'cyclofeat.plotting' not in sys.modules\n"
        "sys.modules['matplotlib.figure'] = None\n"
        "try: recording.plot()\n"
        "except ImportError as error: print(error)"
    )
    assert _printed(code, tmp_path) == "drawing needs matplotlib: pip install matplotlib"


@pytest.mark.slow
@pytest.mark.parametrize(("backend", "used"), [("none_such", "agg"), ("svg", "svg")])
def test_a_page_needs_no_backend_and_keeps_that_of_the_user(tmp_path, backend, used):
    code = (
        "from cyclofeat.report import Report; import cyclofeat\n"
        "Report('a').add_figure(cyclofeat.Recording([1.0, 2.0], 1.0)).write('page.html')\n"
        "import matplotlib, os; os.environ.pop('DISPLAY', 0); print(matplotlib.get_backend())"
    )
    assert _printed(code, tmp_path, MPLBACKEND=backend) == used


def test_an_evaluation_in_tables_is_the_evaluation(evaluation):
    windows = evaluation.to_frame("windows")
    right = windows.defect_count == windows.predicted_count
    assert right.mean() == evaluation.accuracy
    # An assembly lies in one fold, and every fold has held some out.
    assert (windows.groupby("assembly").fold.nunique() == 1).all()
    assert sorted(windows.fold.unique()) == [0, 1, 2, 3, 4]
    np.testing.assert_allclose(windows.filter(like="probability_").sum(axis=1), 1)
    assemblies = evaluation.to_frame("assemblies").set_index("assembly").accuracy
    np.testing.assert_allclose(assemblies, right.groupby(windows.assembly).mean())
    classes = evaluation.to_frame().set_index("defect_count")
    np.testing.assert_allclose(classes.recall, right.groupby(windows.defect_count).mean())
    np.testing.assert_allclose(classes.precision, right.groupby(windows.predicted_count).mean())
    assert (classes.recall_low <= classes.recall).all()
    assert (classes.recall <= classes.recall_high).all()
    with pytest.raises(ValueError, match="table must be one of 'classes', .*, got 'folds'"):
        evaluation.to_frame("folds")


def test_a_count_that_is_never_answered_has_no_precision():
    y = np.repeat([0, 0, 1], 20)
    constant = evaluate(DummyClassifier(), y[:, np.newaxis] * 1.0, y, np.arange(60))
    assert constant.to_frame().precision.isna().tolist() == [False, True]


def test_many_counts_are_one_table():
    table = counts_frame({"a.csv": COUNT, "b.csv": dataclasses.replace(COUNT, probability={2: 1.0})})
    assert table.index.tolist() == ["a.csv", "b.csv"]
    assert table.index.name == "recording"
    assert table.probability.tolist() == [0.75, 1.0]
    assert table.lobes.tolist() == [(3, 4)] * 2
    assert table.probability_0.isna().tolist() == [False, True]
    assert counts_frame([COUNT]).index.tolist() == [0]
    assert counts_frame([]).empty


def test_a_missing_pandas_is_named_with_its_remedy(evaluation, monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(ImportError, match="pip install pandas"):
        evaluation.to_frame()
