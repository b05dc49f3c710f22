"""Counter of rows of neighbouring worn lobes."""

from __future__ import annotations

import numpy as np
import pytest

from cyclofeat.counting import LobeModel, RowCounter, _rows, passage_of_lobe_zero
from cyclofeat.datasets import make_rig_recordings
from cyclofeat.models import load_model, save_model
from cyclofeat.recordings import shaft_windows
from cyclofeat.simulators import Solver

COUNTS = (0, 1, 3, 5)


def simulated(n: int, seed: int) -> list:
    return make_rig_recordings(
        n, COUNTS, rig="R1", speed_rpm=(400, 600), output_turns=1.05, sampling_rate=5120, random_state=seed,
        with_angle=True, kernel="auto", solver=Solver(integrator="adams_bashforth"),
    )  # fmt: skip


def windows_of(recordings):
    windows = shaft_windows(recordings, [one.input_angle(15) for one in recordings], 15)
    return windows, windows.worn_table(15), passage_of_lobe_zero(windows.start_angle, 15)


@pytest.fixture(scope="module")
def training():
    return simulated(12, 0)


@pytest.fixture(scope="module")
def judged():
    return simulated(6, 1)


@pytest.fixture(scope="module")
def counter(training):
    windows, worn, passage = windows_of(training)
    counter = RowCounter(128.0, 1.0, speed_tolerance=0.0)
    return counter.fit(windows.X, windows.y, worn, passage, windows.groups)


@pytest.mark.slow
def test_counts_and_locates_assemblies_that_training_did_not_see(counter, judged):
    windows, worn, passage = windows_of(judged)
    right = counter.predict(windows.X) == windows.y
    assert right.mean() >= 0.9
    lobes = counter._from_lines(counter.lobe_map_.lines(windows.X), passage)
    assert np.mean((lobes > 0.5)[right] == worn[right]) >= 0.98
    assert counter.calibrated_


@pytest.mark.slow
def test_networks_answer_as_scikit_learn_does(counter, judged):
    lines = counter.lobe_map_.lines(windows_of(judged)[0].X).lines
    views = _rows._views(lines, np.zeros(len(lines)), 15).reshape(-1, 2 * (lines.shape[1] - 2))
    for network in counter.networks_:
        np.testing.assert_allclose(_rows._votes(network, views), network.predict_proba(views), atol=1e-5)


@pytest.mark.slow
def test_turning_the_disc_by_a_lobe_turns_the_answer(counter, judged):
    """What is learned at one lobe holds for all: the passage only renumbers the lobes."""
    windows, _, passage = windows_of(judged)
    found = counter.lobe_map_.lines(windows.X)
    here, there = counter._from_lines(found, passage), counter._from_lines(found, passage + 1 / 15)
    np.testing.assert_allclose(there, np.roll(here, -1, axis=1), atol=1e-4)


@pytest.mark.slow
def test_expected_count_is_the_sum_over_the_lobes(counter, judged):
    windows, _, passage = windows_of(judged)
    found = counter.lobe_map_.lines(windows.X)
    expected = counter.proba_of_lines(found) @ np.array(COUNTS)
    np.testing.assert_allclose(counter._from_lines(found, passage).sum(axis=1), expected, atol=1e-6)


@pytest.mark.slow
def test_scale_and_mean_of_the_torque_do_not_matter(counter, judged):
    X = windows_of(judged)[0].X
    np.testing.assert_allclose(counter.predict_proba(50 * X + 3), counter.predict_proba(X), atol=1e-4)


@pytest.mark.slow
def test_model_of_rows_counts_recordings_and_is_small_on_disk(training, judged, tmp_path):
    model = LobeModel.train(training, n_splits=0, counter="rows")
    answers = model.count_all(judged)
    assert np.mean([a.defect_count == r.defect_count for a, r in zip(answers, judged, strict=True)]) >= 0.9
    assert [len(one.lobes) for one in answers] == [one.defect_count for one in answers]
    path = save_model(tmp_path / "rows.skops", model)
    assert path.stat().st_size < 2e6
    again = load_model(path).count_all(judged)
    assert [one.probability for one in again] == [one.probability for one in answers]


def test_rejects_lobes_that_are_no_row():
    X = np.random.default_rng(0).normal(size=(4, 2000))
    worn = np.zeros((4, 15), dtype=bool)
    worn[2:, [0, 4]] = True
    with pytest.raises(ValueError, match="use LobeCounter"):
        RowCounter(128.0, 1.0).fit(X, [0, 0, 2, 2], worn, np.zeros(4))
    with pytest.raises(ValueError, match="passage must be given"):
        RowCounter(128.0, 1.0).fit(X, [0, 0, 2, 2], worn)


def test_model_names_the_counters_that_it_knows():
    with pytest.raises(ValueError, match="counter must be 'trees' or 'rows', got 'lines'"):
        LobeModel.train([], counter="lines")
