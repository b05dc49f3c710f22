"""What a corrected rig leaves unexplained."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats
from sklearn.covariance import LedoitWolf
from sklearn.model_selection import KFold

Float = NDArray[np.float64]

_FOLDS = 5
_SMALLEST = 0.05  # differences far below the spread of a recording, which is about 1, have no consequence


@dataclass(frozen=True)
class Unexplained:
    """Distance of a session from simulated ones of the corrected rig.

    Attributes
    ----------
    p : float
        Share of sessions of the corrected rig that lie as far.
    z : ndarray, shape (n_summaries,)
        Difference in each summary, in standard deviations of a session.
    """

    p: float
    z: Float


def unexplained(simulated: Float, sizes: Float, fitted: Float, observed: Float, size: Float) -> Unexplained:
    """Compare the summaries of a session with those of simulated sessions, each at its own fitted sizes.

    Parameters
    ----------
    simulated : ndarray, shape (n_sessions, n_summaries)
    sizes, fitted : ndarray, shape (n_sessions, n_sizes)
        True sizes of the simulated sessions, and those fitted to them.
    observed : ndarray, shape (n_summaries,)
    size : ndarray, shape (n_sizes,)
        Fitted to the observed session.

    Returns
    -------
    Unexplained
        Squared Mahalanobis distances have their covariance from other sessions, shrunk; the p is that of
        Student's t in their logarithm.
    """
    inputs = np.column_stack([np.ones(len(sizes)), sizes])
    coefficients, *_ = np.linalg.lstsq(inputs, simulated, rcond=None)
    left = simulated - np.column_stack([np.ones(len(fitted)), fitted]) @ coefficients
    of_observed = observed - np.r_[1.0, size] @ coefficients
    spread = np.hypot(left.std(axis=0, ddof=1), _SMALLEST)
    left, of_observed = left / spread, (of_observed - left.mean(axis=0)) / spread
    distances, of_folds = np.empty(len(left)), []
    for others, held in KFold(_FOLDS).split(left):
        model = LedoitWolf().fit(left[others])
        distances[held] = model.mahalanobis(left[held])
        of_folds.append(model.mahalanobis(of_observed[None])[0])
    logs = np.log(distances)
    z = (np.log(np.mean(of_folds)) - logs.mean()) / (logs.std(ddof=1) * np.sqrt(1 + 1 / len(logs)))
    return Unexplained(float(stats.t.sf(z, len(logs) - 1)), of_observed)
