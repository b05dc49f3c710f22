"""Linear calibration: parameters from statistics, with the scatter of measured and simulated recordings."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]
Labels = NDArray[np.int64]

_ROUNDS = 20  # of the fixed-point iteration, which converges in a few


class Calibration:
    """Linear model of statistics, T = A(label) + C (theta - centre) + scatter, and its inversion.

    The model is fitted to recordings of known parameters. It is inverted by multivariate calibration (Brown
    1982, J. R. Stat. Soc. B 44, 287-321) with a normal prior of standard deviation ``widths`` about
    ``centre``. ``slope`` is C, ``scatter`` the covariance of one recording's statistics, ``degrees`` its
    degrees of freedom. Labels are counts of worn lobes, which affect the statistics too.
    """

    def __init__(
        self, places: Float, statistics: Float, labels: Labels, centre: Float, widths: Float
    ) -> None:
        self._known = np.unique(labels)
        design = np.column_stack([self._shares(labels), places - centre])
        self.degrees = len(places) - design.shape[1]
        if self.degrees < 1:
            raise ValueError(f"places must be more than {design.shape[1]}, got {len(places)}")
        coefficients = np.linalg.lstsq(design, statistics, rcond=None)[0]
        left = statistics - design @ coefficients
        self._inverse = np.linalg.pinv(design.T @ design)
        self._levels, self.slope = coefficients[: self._known.size], coefficients[self._known.size :].T
        self.scatter = left.T @ left / self.degrees
        self._centre, self._widths = centre, widths

    def solve(self, statistics: Float, labels: Labels) -> tuple[Float, Float]:
        """Parameters of measured recordings, and their covariance.

        The scatter of each statistic is the larger one of measured and simulated recordings.
        """
        shares = self._shares(labels)
        apart = statistics - shares @ self._levels
        larger = np.sqrt(np.maximum(apart.var(axis=0, ddof=1) / np.diag(self.scatter), 1))
        of_mean = self.scatter * np.outer(larger, larger) / len(statistics)
        prior = np.diag(1 / self._widths**2)
        shift: Float = np.zeros(len(prior))
        covariance: Float = np.zeros_like(prior)
        for _ in range(_ROUNDS):
            # The uncertainty of the line grows with the distance from the centre.
            at = np.r_[shares.mean(axis=0), shift]
            of_slope = self._inverse[-len(prior) :, -len(prior) :]
            unsure = at @ self._inverse @ at + np.sum(of_slope * covariance)
            weight = np.linalg.pinv(of_mean + self.scatter * unsure)
            covariance = np.asarray(np.linalg.inv(self.slope.T @ weight @ self.slope + prior), dtype=float)
            shift = np.asarray(covariance @ self.slope.T @ weight @ apart.mean(axis=0), dtype=float)
        return self._centre + shift, covariance

    def _shares(self, labels: Labels) -> Float:
        return _one_hot(labels, self._known)


def slopes(places: Float, values: Float, labels: Labels, weights: Float) -> Float:
    """Slopes (n_values, n_parameters) of weighted straight lines, with a level for each label."""
    levels = _one_hot(labels, np.unique(labels))
    # Centred, for numerical accuracy.
    design = np.column_stack([levels, places - places.mean(axis=0)])
    root = np.sqrt(weights)[:, None]
    coefficients = np.linalg.lstsq(root * design, root * values, rcond=None)[0]
    return np.asarray(coefficients[levels.shape[1] :].T)


def _one_hot(labels: Labels, known: Labels) -> Float:
    """Indicator of each known label by row."""
    return np.asarray(labels[:, None] == known[None, :], dtype=float)
