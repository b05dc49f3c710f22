"""Intervals of a fit, by recordings of known parameters in boxes around the best."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import stats
from scipy.stats import qmc

from cyclofeat.gap._calibration import Calibration, slopes
from cyclofeat.gap._fit_model import PER_STEP
from cyclofeat.gap._fit_search import Estimate, Search
from cyclofeat.simulators import SimulationFailed

Float = NDArray[np.float64]

BOXES = 3  # in which recordings are spread
_FIRST_BOX = 0.15  # half its width, in widths of the prior
_LEAST_BOX, _WIDEST_BOX = 0.01, 0.5
_REACH = 3.0  # half the width of the next box, in standard deviations
_APART = 10_000  # first seed of these recordings


def calibrated(
    search: Search,
    best: Float,
    estimate: Estimate,
    measured: Float,
    counts: NDArray[np.int64] | None,
    n: int,
    alpha: float,
    random: np.random.Generator,
) -> tuple[Float, Float]:
    """Parameters of measured recordings, and half their intervals.

    Parameters
    ----------
    search : Search
    best : ndarray, shape (n_parameters,)
        Where the search ended.
    estimate : Estimate
        Of the last step there: weights of the cells, scatter.
    measured : ndarray, shape (n_measured, n_cells)
        Summaries.
    counts : ndarray of int, shape (n_measured,), or None
        Of worn lobes, if known.
    n : int
        Recordings to simulate.
    alpha : float
    random : numpy.random.Generator

    Returns
    -------
    parameters, reach : ndarray, shape (n_parameters,)

    Raises
    ------
    SimulationFailed
        If too few of the simulations succeed.
    """
    model, at = search.model, search.at
    told = estimate.weighted(measured)
    of_told = np.zeros(len(measured), dtype=np.int64) if counts is None else counts
    drawn, values, labels = np.empty((0, best.size)), np.empty((0, told.shape[1])), of_told[:0]
    turn: Float | None = None
    radius = np.maximum(_FIRST_BOX * at.widths, _REACH * np.minimum(estimate.deviation, at.widths))
    spread = qmc.Halton(best.size, seed=random)
    for box in range(BOXES):
        low, high = at.clipped(best - radius), at.clipped(best + radius)
        places = low + spread.random(len(range(box, n, BOXES))) * (high - low)
        simulated, done, own = model.scattered(places, counts, _APART + box * n)
        places, simulated = places[done], estimate.weighted(simulated)
        own = 0 * own if counts is None else own
        if len(places) <= np.unique(own).size + best.size or not np.all(np.isin(of_told, own)):
            raise SimulationFailed(
                f"only {len(places)} of {len(done)} simulations around the optimum succeed: no interval can "
                "be stated; take a larger n_interval"
            )
        drawn, values = np.vstack([drawn, places]), np.vstack([values, simulated])
        labels = np.r_[labels, own]
        # Means over the search's own recordings have a level of their own, and weigh as many.
        searched, means = search.within(low, high)
        slope = slopes(
            np.vstack([drawn, searched]),
            np.vstack([values, estimate.weighted(means)]),
            np.r_[labels, np.full(len(searched), -1)],
            np.r_[np.ones(len(drawn)), np.full(len(searched), PER_STEP)],
        )
        following = np.asarray(np.linalg.pinv(slope), dtype=float)
        # Statistics that these very recordings chose would promise too much, but for the first step.
        turn = following if turn is None else turn
        line = Calibration(places, simulated @ turn.T, own, best, at.widths / 2)
        found, covariance = line.solve(told @ turn.T, of_told)
        deviation = np.sqrt(np.diag(covariance))
        # A line holds in its box.
        best = np.clip(found, low, high)
        if box > 0:
            # What is told narrows; what is not is spread as widely as it may be, or the little that is known
            # of its slope would blur all others.
            radius = np.clip(_REACH * deviation, _LEAST_BOX * at.widths, _WIDEST_BOX * at.widths)
        turn = following
    return best, float(stats.t.ppf(1 - alpha / 2, line.degrees)) * deviation
