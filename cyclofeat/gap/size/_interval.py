"""Intervals of a fit, from recordings of known parameters in boxes around the optimum."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import stats
from scipy.stats import qmc

from cyclofeat.gap.size._calibration import Calibration, slopes
from cyclofeat.gap.size._model import PER_STEP
from cyclofeat.gap.size._search import Estimate, Search
from cyclofeat.gap.summaries import Measured
from cyclofeat.simulators import SimulationFailed

Float = NDArray[np.float64]

BOXES = 3  # one after the other
_FIRST_BOX = 0.15  # half width of the first box, in widths of the prior
_LEAST_BOX, _WIDEST_BOX = 0.01, 0.5
_REACH = 3.0  # half width of the next box, in standard deviations
_FIRST_NUMBER = 10_000  # number of the first of these recordings, above those of the search
CONFIDENCE = 0.9


def calibrated(
    search: Search, estimate: Estimate, best: Float, measured: Measured, n: int, random: np.random.Generator
) -> tuple[Float, Float]:
    """Return the parameters of measured recordings and half the widths of their intervals, (n_parameters,).

    ``n`` recordings are simulated around the optimum ``best`` of the search, weighted by the ``estimate`` of
    its last step. Raises SimulationFailed if too few of them succeed.
    """
    model, space, counts = search.model, search.space, measured.counts_or_zeros
    observed = estimate.weighted(measured.values)
    drawn, values, labels = np.empty((0, best.size)), np.empty((0, observed.shape[1])), counts[:0]
    turn: Float | None = None
    radius = np.maximum(_FIRST_BOX * space.widths, _REACH * np.minimum(estimate.deviation, space.widths))
    spread = qmc.Halton(best.size, seed=random)
    for box in range(BOXES):
        low, high = space.clipped(best - radius), space.clipped(best + radius)
        places = low + spread.random(len(range(box, n, BOXES))) * (high - low)
        simulated, done, of_simulated = model.scattered(places, _FIRST_NUMBER + box * n)
        places, simulated = places[done], estimate.weighted(simulated)
        of_simulated = of_simulated if model.by_count else 0 * of_simulated
        enough = len(places) > np.unique(of_simulated).size + best.size
        if not enough or not np.all(np.isin(counts, of_simulated)):
            raise SimulationFailed(
                f"only {len(places)} of {len(done)} simulations around the optimum succeed: no interval can "
                "be stated; take a larger n_interval"
            )
        drawn, values = np.vstack([drawn, places]), np.vstack([values, simulated])
        labels = np.r_[labels, of_simulated]
        # Means over PER_STEP recordings of the search get a level of their own, and their number as weight.
        searched, means = search.within(low, high)
        slope = slopes(
            np.vstack([drawn, searched]),
            np.vstack([values, estimate.weighted(means)]),
            np.r_[labels, np.full(len(searched), -1)],
            np.r_[np.ones(len(drawn)), np.full(len(searched), PER_STEP)],
        )
        following = np.asarray(np.linalg.pinv(slope), dtype=float)
        # Statistics of the box before (in the first box its own): with those chosen by the same recordings,
        # the intervals would be too narrow.
        turn = following if turn is None else turn
        line = Calibration(places, simulated @ turn.T, of_simulated, best, space.widths / 2)
        solved, covariance = line.solve(observed @ turn.T, counts)
        deviation = np.sqrt(np.diag(covariance))
        # The line is valid in its box only.
        best = np.clip(solved, low, high)
        if box > 0:
            # Wide in poorly identified parameters: in a narrow box the slopes would be too uncertain.
            radius = np.clip(_REACH * deviation, _LEAST_BOX * space.widths, _WIDEST_BOX * space.widths)
        turn = following
    return best, float(stats.t.ppf((1 + CONFIDENCE) / 2, line.degrees)) * deviation
