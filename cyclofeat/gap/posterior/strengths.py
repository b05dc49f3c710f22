"""Sizes from which an effect is detected."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.special import logit
from scipy.stats import norm
from sklearn.linear_model import LogisticRegression

from cyclofeat.simulators.effects import EffectParameter

Float = NDArray[np.float64]

_FEWEST = 5  # cases from which a size is stated
_C = 100.0  # hardly shrinks a slope, and keeps that of separable cases finite


def detection_limit(strengths: Float, detected: NDArray[np.bool_], share: float) -> float:
    """Return the strength from which a share of the cases is detected, by logistic regression.

    Parameters
    ----------
    strengths : ndarray, shape (n,)
    detected : ndarray of bool, shape (n,)
    share : float
        Between 0 and 1.

    Returns
    -------
    float
        The smallest of the strengths if it suffices; NaN if the largest does not, or there are fewer than
        five cases.

    Examples
    --------
    >>> strengths = np.linspace(0, 1, 101)
    >>> round(detection_limit(strengths, strengths > 0.4, 0.5), 1)
    0.4
    """
    if detected.size < _FEWEST or not detected.any():
        return math.nan
    if detected.all():
        return float(strengths.min())
    centre, spread = strengths.mean(), strengths.std() + 1e-12
    line = LogisticRegression(C=_C).fit((strengths - centre)[:, None] / spread, detected)
    slope, level = float(line.coef_[0, 0]), float(line.intercept_[0])
    if slope <= 0:  # as if the size made no difference
        return float(strengths.min()) if detected.mean() >= share else math.nan
    needed = float(centre + spread * (logit(share) - level) / slope)
    return math.nan if needed > strengths.max() else max(needed, float(strengths.min()))


def strengths_of(parameter: EffectParameter, sizes: Float) -> Float:
    """Return the distance of sizes from the neutral value, all on the scale of the fit.

    Where the neutral value is infinitely far, the strength rises towards the other side.
    """
    neutral = _neutral_value(parameter)
    if math.isinf(neutral):
        return sizes if neutral < 0 else -sizes
    return np.asarray(np.abs(sizes - neutral))


def visible_ends(parameter: EffectParameter, strength: float) -> tuple[float, float]:
    """Return the values below and above which an effect is stronger; NaN where there are none."""
    neutral = _neutral_value(parameter)
    if math.isinf(neutral):
        scaled = (math.nan, strength) if neutral < 0 else (-strength, math.nan)
    else:
        scaled = neutral - strength, neutral + strength
    low, high = (math.exp(end) if parameter.log else float(end) for end in scaled)
    return low, high


def reach_beyond(parameter: EffectParameter, strength: float, middle: Float, spread: Float) -> Float:
    """Return the probability that normally distributed sizes are stronger; NaN where ``strength`` is.

    Parameters
    ----------
    parameter : EffectParameter
    strength : float
    middle, spread : ndarray
        Mean and standard deviation of the sizes on the scale of the fit.
    """
    neutral = _neutral_value(parameter)
    if math.isinf(neutral):
        away = middle if neutral < 0 else -middle
        return np.asarray(norm.sf(strength, away, spread))
    above, below = norm.sf(neutral + strength, middle, spread), norm.cdf(neutral - strength, middle, spread)
    return np.asarray(above + below)


def _neutral_value(parameter: EffectParameter) -> float:
    value = parameter.neutral or 0.0  # None: another parameter switches the effect off
    if not parameter.log:
        return value
    return math.log(value) if value > 0 else -math.inf
