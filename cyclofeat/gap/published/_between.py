"""Statistics of rigs between those that were simulated, by a Gaussian process."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc
from sklearn.exceptions import ConvergenceWarning
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

from cyclofeat.gap.published._rigs import RigTable

Float = NDArray[np.float64]

_DENSE = 512  # interpolated rigs, a power of two
_NEAR = 4  # simulated rigs from which the noise of an interpolated rig is taken


@dataclass(frozen=True)
class DenseRigs:
    """Many rigs interpolated between the simulated ones.

    ``theta`` (n, n_parameters); ``middle`` (n, n_counts, 4) the expected statistics; ``noise`` (n, m, 4) the
    deviations of single records of nearby rigs; ``nearest`` (n, k) those rigs; ``log_weight`` (n, n_discs).
    """

    theta: Float
    middle: Float
    noise: Float
    nearest: NDArray[np.intp]
    log_weight: Float


def interpolated(table: RigTable, bounds: Sequence[tuple[float, float, bool]], seed: int) -> DenseRigs:
    """Statistics between the simulated rigs, by a Gaussian process over their parameters.

    The process is fitted to means over the replicates; all statistics and counts share its length scales.
    The noise is the residual of the records of the nearest rigs.
    """
    values = table.values
    n, n_replicates, n_counts, n_statistics = values.shape
    none = np.zeros((0, 0))
    if table.theta.shape[1] == 0:
        middle = values.mean(axis=(0, 1))[np.newaxis]
        noise = (values - middle).reshape(1, -1, n_statistics)
        return DenseRigs(np.zeros((1, 0)), middle, noise, np.arange(n)[np.newaxis], none)

    def place(theta: Float) -> Float:
        columns = []
        for column, (low, high, log) in zip(theta.T, bounds, strict=True):
            ends = (np.log(low), np.log(high)) if log else (low, high)
            columns.append(((np.log(column) if log else column) - ends[0]) / (ends[1] - ends[0]))
        return np.column_stack(columns)

    at = place(table.theta)
    means = values.mean(axis=1).reshape(n, -1)
    spread = np.maximum(means.std(axis=0), 1e-9)
    scaled = (means - means.mean(axis=0)) / spread
    kernel = ConstantKernel(1.0, (0.1, 100.0)) * RBF(np.full(at.shape[1], 0.5), (0.05, 20.0))
    process = GaussianProcessRegressor(kernel + WhiteKernel(0.1, (1e-4, 2.0)))
    with warnings.catch_warnings():
        # A length scale at its upper bound belongs to a parameter without influence.
        warnings.simplefilter("ignore", ConvergenceWarning)
        process.fit(at, scaled)

    def expected(places: Float) -> Float:
        found = np.asarray(process.predict(places)) * spread + means.mean(axis=0)
        return np.asarray(found.reshape(len(places), n_counts, n_statistics))

    left = (values - expected(at)[:, np.newaxis]).reshape(n, n_replicates * n_counts, n_statistics)
    # Within the simulated values: nothing is extrapolated.
    low, high = at.min(axis=0), at.max(axis=0)
    shares = qmc.Sobol(at.shape[1], seed=seed).random(_DENSE)
    places = low + (high - low) * shares
    nearest = np.argsort(((places[:, np.newaxis] - at) ** 2).sum(axis=-1), axis=1)[:, :_NEAR]
    theta = np.column_stack(
        [
            np.exp(np.log(a) + (np.log(b) - np.log(a)) * x) if log else a + (b - a) * x
            for x, (a, b, log) in zip(places.T, bounds, strict=True)
        ]
    )
    return DenseRigs(theta, expected(places), left[nearest].reshape(_DENSE, -1, n_statistics), nearest, none)
