"""Test of whether a session differs from simulated ones of the corrected rig."""

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
class RemainderTest:
    """Test of whether a session differs from simulated ones of the corrected rig.

    ``p`` is the share of sessions of the corrected rig that lie as far, ``z`` (n_summaries,) are the
    differences in standard deviations of a session, ``excess`` is the squared distance over that of a typical
    session of the corrected rig. ``p_undecided`` is the p if undecided effects may explain the differences.
    """

    p: float
    z: Float
    excess: float
    p_undecided: float = float("nan")


def judge_remainder(simulated: Float, observed: Float) -> RemainderTest:
    """Compare what a fit leaves of a session with what it leaves of simulated sessions.

    Squared Mahalanobis distances have their covariance from other sessions, shrunk; the p is that of
    Student's t in their logarithm. ``simulated`` is (n_sessions, n_summaries), ``observed`` (n_summaries,).
    """
    centre, spread = simulated.mean(axis=0), np.hypot(simulated.std(axis=0, ddof=1), _SMALLEST)
    left, z = (simulated - centre) / spread, (observed - centre) / spread
    distances, of_folds = np.empty(len(left)), []
    for rest, held in KFold(_FOLDS).split(left):
        model = LedoitWolf().fit(left[rest])
        distances[held] = model.mahalanobis(left[held])
        of_folds.append(model.mahalanobis(z[None])[0])
    above = float(np.log(np.mean(of_folds)) - np.log(distances).mean())
    error = np.log(distances).std(ddof=1) * np.sqrt(1 + 1 / len(left))
    return RemainderTest(float(stats.t.sf(above / error, len(left) - 1)), z, float(np.exp(above)))
