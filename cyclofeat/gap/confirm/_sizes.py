"""Sizes of effects by synthetic likelihood: summaries linear in the sizes, with Gaussian residuals.

After Wood (2010), "Statistical inference for noisy nonlinear ecological dynamic systems", Nature 466, and
Fearnhead and Prangle (2012), "Constructing summary statistics for approximate Bayesian computation", J. R.
Stat. Soc. B 74: the summaries are estimates of the sizes themselves.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from sklearn.covariance import LedoitWolf
from sklearn.linear_model import RidgeCV
from sklearn.model_selection import KFold, cross_val_predict
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

Float = NDArray[np.float64]

_FOLDS = 5
_ALPHAS = np.logspace(0, 5, 11)


@dataclass(frozen=True)
class Gaussian:
    """Distribution of sizes on the scale of their fit: mean (n_sizes,), covariance (n_sizes, n_sizes)."""

    mean: Float
    covariance: Float

    @property
    def spread(self) -> Float:
        """Standard deviation of each size."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    def without_last(self) -> Gaussian:
        """Return the distribution of all sizes but the last."""
        return Gaussian(self.mean[:-1], self.covariance[:-1, :-1])

    def draw(self, random: np.random.Generator) -> Float:
        """Draw sizes."""
        return np.asarray(
            self.mean + np.linalg.cholesky(self.covariance) @ random.normal(size=self.mean.size)
        )


def size_posterior(
    sizes: Float, features: Float, estimates: Float, observed: tuple[Float, Float], prior: Gaussian
) -> tuple[Gaussian, Float, Callable[[Float, Float], Float]]:
    """Return the posterior of sizes given one session's summaries.

    Parameters
    ----------
    sizes : ndarray, shape (n_sessions, n_sizes)
        Of the simulated sessions.
    features : ndarray, shape (n_sessions, n_features)
        Their summaries, from which a ridge regression estimates the sizes.
    estimates : ndarray, shape (n_sessions, n_estimates)
        Other estimates of their sizes.
    observed : (ndarray, ndarray)
        Features and estimates of the session in question, shapes (n_features,) and (n_estimates,).
    prior : Gaussian
        Of the sizes, before any recording.

    Returns
    -------
    posterior : Gaussian
    fitted : ndarray, shape (n_sessions, n_sizes)
        Means of the posteriors of the simulated sessions.
    fit : callable
        Returns these means for the features and estimates of other sessions.
    """
    regression = make_pipeline(StandardScaler(), RidgeCV(_ALPHAS))
    # A session must not estimate its own sizes: the residuals would be too small.
    crossed = cross_val_predict(regression, features, sizes, cv=KFold(_FOLDS)).reshape(sizes.shape)
    regression.fit(features, sizes)
    statistics = np.hstack([crossed, estimates])
    inputs = np.column_stack([np.ones(len(sizes)), sizes])
    coefficients, *_ = np.linalg.lstsq(inputs, statistics, rcond=None)
    residuals = statistics - inputs @ coefficients
    scale = residuals.std(axis=0) + 1e-9
    freedom = len(sizes) / max(len(sizes) - inputs.shape[1], 1)
    precision = np.linalg.inv(LedoitWolf().fit(residuals / scale).covariance_ * freedom)
    slopes = coefficients[1:] / scale
    weighted = slopes @ precision
    before = np.linalg.inv(prior.covariance)
    covariance = np.linalg.inv(weighted @ slopes.T + before)

    def mean(some: Float) -> Float:
        found = (some - coefficients[0]) / scale @ weighted.T + before @ prior.mean
        return np.asarray(found @ covariance)

    def fit(features: Float, estimates: Float) -> Float:
        own = regression.predict(features).reshape(len(features), -1)
        return mean(np.hstack([own, estimates]))

    of_observed = fit(*(part[None] for part in observed))[0]
    return Gaussian(of_observed, covariance), mean(statistics), fit
