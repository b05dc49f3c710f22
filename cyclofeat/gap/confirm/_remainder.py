"""Differences that a corrected rig leaves unexplained."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats
from sklearn.covariance import LedoitWolf
from sklearn.model_selection import KFold

Float = NDArray[np.float64]

_FOLDS = 5
SMALLEST = 0.05  # differences far below the spread of a recording, which is about 1, have no consequence


@dataclass(frozen=True)
class Unexplained:
    """Distance of a session from simulated ones of the corrected rig.

    Attributes
    ----------
    p : float
        Share of sessions of the corrected rig that lie as far.
    p_open : float
        Share of sessions with open effects besides that lie as far; NaN without any.
    z : ndarray, shape (n_summaries,)
        Difference in each summary, in standard deviations of a session.
    """

    p: float
    p_open: float
    z: Float


def unexplained(
    simulated: Float,
    sizes: Float,
    fitted: Float,
    observed: Float,
    size: Float,
    others: tuple[Float, Float] | None = None,
) -> Unexplained:
    """Compare the summaries of a session with those of simulated sessions, each at its own fitted sizes.

    Parameters
    ----------
    simulated : ndarray, shape (n_sessions, n_summaries)
    sizes, fitted : ndarray, shape (n_sessions, n_sizes)
        True sizes of the simulated sessions, and those fitted to them.
    observed : ndarray, shape (n_summaries,)
    size : ndarray, shape (n_sizes,)
        Fitted to the observed session.
    others : (ndarray, ndarray), optional
        Summaries of simulated sessions that have open effects too, shape (n_others, n_summaries), and sizes
        fitted to them, shape (n_others, n_sizes).

    Returns
    -------
    Unexplained
        Squared Mahalanobis distances have their covariance from other sessions, shrunk; the p is that of
        Student's t in their logarithm.
    """
    inputs = np.column_stack([np.ones(len(sizes)), sizes])
    coefficients, *_ = np.linalg.lstsq(inputs, simulated, rcond=None)

    def residuals(some: Float, at: Float) -> Float:
        return np.asarray(some - np.column_stack([np.ones(len(at)), at]) @ coefficients)

    left, of_observed = residuals(simulated, fitted), residuals(observed[None], size[None])
    of_others = np.empty((0, left.shape[1])) if others is None else residuals(*others)
    centre, spread = left.mean(axis=0), np.hypot(left.std(axis=0, ddof=1), SMALLEST)
    z, far = (of_observed - centre) / spread, np.vstack([of_observed, of_others])
    left, far = left / spread, (far - centre) / spread
    distances, of_folds = np.empty(len(left)), []
    for rest, held in KFold(_FOLDS).split(left):
        model = LedoitWolf().fit(left[rest])
        distances[held] = model.mahalanobis(left[held])
        of_folds.append(model.mahalanobis(far))
    logs = np.log(np.mean(of_folds, axis=0))
    return Unexplained(_tail(logs[0], np.log(distances)), _tail(logs[0], logs[1:]), z[0])


def _tail(value: float, sample: Float) -> float:
    """Return the chance of a value as large, by Student's t; NaN for a sample of fewer than two."""
    if sample.size < 2:
        return float("nan")
    error = sample.std(ddof=1) * np.sqrt(1 + 1 / sample.size)
    return float(stats.t.sf((value - sample.mean()) / error, sample.size - 1))
