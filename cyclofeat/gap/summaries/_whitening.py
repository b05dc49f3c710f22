"""Decorrelation of cells."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from sklearn.covariance import LedoitWolf

Float = NDArray[np.float64]

# Added to every eigenvalue: an assumed share of uncorrelated variance, so that no combination is too certain.
_RIDGE = 0.05


def uncorrelating(deviations: Float) -> Float:
    """Matrix W (n_cells, n_cells) for which ``deviations @ W`` has about the identity as covariance.

    The covariance is shrunk (Ledoit and Wolf 2004); deviations have about unit variance and zero mean.
    """
    covariance = LedoitWolf(store_precision=False, assume_centered=True).fit(deviations).covariance_
    power, directions = np.linalg.eigh(covariance)
    return np.asarray(directions / np.sqrt(np.maximum(power, 0.0) + _RIDGE))
