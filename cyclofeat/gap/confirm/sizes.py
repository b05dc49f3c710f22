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
from scipy import stats
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

    Of simulated sessions, all (n_sessions, ...), ``features`` are the summaries from which a ridge regression
    estimates the ``sizes``, and ``estimates`` other estimates of them; ``observed`` holds the features and
    estimates of the session in question. Also returns the means of the posteriors of the simulated sessions,
    (n_sessions, n_sizes), and a function that gives these means for features and estimates of others.
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

    def mean(values: Float) -> Float:
        weighted_mean = (values - coefficients[0]) / scale @ weighted.T + before @ prior.mean
        return np.asarray(weighted_mean @ covariance)

    def fit(features: Float, estimates: Float) -> Float:
        own = regression.predict(features).reshape(len(features), -1)
        return mean(np.hstack([own, estimates]))

    of_observed = fit(*(part[None] for part in observed))[0]
    return Gaussian(of_observed, covariance), mean(statistics), fit


SMALLEST = 0.05  # differences far below the spread of a recording, which is about 1, have no consequence


@dataclass(frozen=True)
class RemainderTest:
    """Test of whether a session differs from simulated ones of the corrected rig.

    ``p`` is the share of sessions of the corrected rig that lie as far, ``p_open`` that of sessions with open
    effects besides (NaN without any), ``z`` (n_summaries,) the differences in standard deviations of a
    session.
    """

    p: float
    p_open: float
    z: Float


def judge_remainder(
    simulated: Float,
    sizes: Float,
    fitted: Float,
    observed: Float,
    size: Float,
    others: tuple[Float, Float] | None = None,
) -> RemainderTest:
    """Compare the summaries of a session with those of simulated sessions, each at its own fitted sizes.

    Squared Mahalanobis distances have their covariance from other sessions, shrunk; the p is that of
    Student's t in their logarithm.

    ``simulated`` is (n_sessions, n_summaries), with true ``sizes`` and ``fitted`` ones (n_sessions, n_sizes);
    ``observed`` (n_summaries,), with the fitted ``size`` (n_sizes,). ``others`` are summaries and fitted
    sizes of simulated sessions that have open effects too.
    """
    inputs = np.column_stack([np.ones(len(sizes)), sizes])
    coefficients, *_ = np.linalg.lstsq(inputs, simulated, rcond=None)

    def fit_residuals(summaries: Float, at: Float) -> Float:
        return np.asarray(summaries - np.column_stack([np.ones(len(at)), at]) @ coefficients)

    left, of_observed = fit_residuals(simulated, fitted), fit_residuals(observed[None], size[None])
    of_others = np.empty((0, left.shape[1])) if others is None else fit_residuals(*others)
    centre, spread = left.mean(axis=0), np.hypot(left.std(axis=0, ddof=1), SMALLEST)
    z, far = (of_observed - centre) / spread, np.vstack([of_observed, of_others])
    left, far = left / spread, (far - centre) / spread
    distances, of_folds = np.empty(len(left)), []
    for rest, held in KFold(_FOLDS).split(left):
        model = LedoitWolf().fit(left[rest])
        distances[held] = model.mahalanobis(left[held])
        of_folds.append(model.mahalanobis(far))
    logs = np.log(np.mean(of_folds, axis=0))
    return RemainderTest(_tail_chance(logs[0], np.log(distances)), _tail_chance(logs[0], logs[1:]), z[0])


def _tail_chance(value: float, sample: Float) -> float:
    """Return the chance of a value as large, by Student's t; NaN for a sample of fewer than two."""
    if sample.size < 2:
        return float("nan")
    error = sample.std(ddof=1) * np.sqrt(1 + 1 / sample.size)
    return float(stats.t.sf((value - sample.mean()) / error, sample.size - 1))
