"""Linear calibration: intervals that cover, and no knowledge where there is none."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from cyclofeat.gap.size import Calibration

WIDTHS = np.array([10.0, 10.0])
LEVELS = np.array([[0.0, 1.0], [5.0, -3.0]])


def drawn(rng, n, slope, scatter, places):
    """Statistics of n recordings of two classes, one parameter vector each."""
    labels = np.arange(n) % 2
    noise = rng.multivariate_normal(np.zeros(2), scatter, size=n)
    return LEVELS[labels] + places @ slope.T + noise, labels


def calibrated(rng, slope, scatter, truth, n_simulated=60, n_measured=8, widths=WIDTHS):
    places = rng.uniform(-1, 1, (n_simulated, 2))
    statistics, labels = drawn(rng, n_simulated, slope, scatter, places)
    line = Calibration(places, statistics, labels, np.zeros(2), widths)
    measured, of_measured = drawn(rng, n_measured, slope, scatter, np.tile(truth, (n_measured, 1)))
    return line, *line.solve(measured, of_measured)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("slope", "scatter"),
    [
        (np.eye(2), 0.1 * np.eye(2)),
        (np.array([[1.0, 0.8], [-0.3, 0.5]]), np.array([[0.3, 0.1], [0.1, 0.2]])),
        # Statistics that answer weakly and to the wrong parameter, as those of rough derivatives do.
        (np.array([[0.2, 0.9], [0.4, -0.1]]), np.array([[0.1, 0.05], [0.05, 0.1]])),
    ],
    ids=["its own", "mixed", "wrong"],
)
def test_intervals_cover(slope, scatter):
    rng = np.random.default_rng(3)
    truth = np.array([0.4, -0.3])
    inside = []
    for _ in range(400):
        line, found, covariance = calibrated(rng, slope, scatter, truth)
        reach = stats.t.ppf(0.95, line.degrees) * np.sqrt(np.diag(covariance))
        inside.append(np.abs(found - truth) <= reach)
    # 90 %, and not much more: the normal limits of a share of 400 are +-3 % around it.
    assert np.all(np.mean(inside, axis=0) > 0.87)
    assert np.all(np.mean(inside, axis=0) < 0.97)


def test_without_scatter_the_parameters_come_back():
    rng = np.random.default_rng(5)
    slope = np.array([[1.0, 0.8], [-0.3, 0.5]])
    line, found, covariance = calibrated(rng, slope, 1e-12 * np.eye(2), np.array([0.4, -0.3]))
    assert found == pytest.approx([0.4, -0.3], abs=1e-5)
    assert line.slope == pytest.approx(slope, abs=1e-5)
    assert np.all(np.diag(covariance) < 1e-10)


def test_a_parameter_that_moves_nothing_is_as_unknown_as_before():
    rng = np.random.default_rng(7)
    slope = np.array([[1.0, 0.0], [0.5, 0.0]])
    widths, deviations = np.array([3.0, 3.0]), []
    for _ in range(50):
        _, _, covariance = calibrated(rng, slope, 0.1 * np.eye(2), np.array([0.4, 2.0]), widths=widths)
        deviations.append(np.sqrt(np.diag(covariance)))
    assert np.median(deviations, axis=0)[1] > 0.5 * widths[1]
    assert np.median(deviations, axis=0)[0] < 0.1 * widths[0]


def test_measured_scatter_counts_where_it_is_larger():
    rng = np.random.default_rng(9)
    line, _, covariance = calibrated(rng, np.eye(2), 0.01 * np.eye(2), np.zeros(2))
    measured, labels = drawn(rng, 8, np.eye(2), np.eye(2), np.zeros((8, 2)))
    _, wider = line.solve(measured, labels)
    assert np.all(np.diag(wider) > 10 * np.diag(covariance))


def test_too_few_places():
    with pytest.raises(ValueError, match="places must be more than 4, got 4"):
        Calibration(np.zeros((4, 2)), np.zeros((4, 2)), np.array([0, 1, 0, 1]), np.zeros(2), WIDTHS)
