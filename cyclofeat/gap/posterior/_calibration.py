"""Calibration of the networks' answers on rigs that they have not seen."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar
from scipy.special import expit
from sklearn.linear_model import LogisticRegression

from cyclofeat.simulators import known_effects

Float = NDArray[np.float64]

FEWEST_LEARNED = 20  # machines with an effect, or rigs, from which something is learned of it
QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)
_POWERS = (0.5, 2.0)
_MEAN, _START = "mean torque", "start of the torque"  # what effects show as
_MANY = 100  # rigs with such an effect from which its coefficients are learned


def slopes_of(logits: Float, present: NDArray[np.bool_]) -> Float:
    """Return the slope of each effect's logit, shape (n_effects,) (Guo et al. 2017)."""
    slopes = np.ones(logits.shape[1])
    for k, with_it in enumerate(present.T):
        if min(with_it.sum(), (~with_it).sum()) >= FEWEST_LEARNED:
            line = LogisticRegression(C=10.0, fit_intercept=False).fit(logits[:, [k]], with_it)
            slopes[k] = max(line.coef_[0, 0], 0.1)
    return slopes


def of_mean(logits: Float, causes: Float, names: Sequence[str]) -> Float:
    """Return what tells of effects that change the mean torque alone.

    Noise on its inputs keeps the network from being sure of them even where loads and directions separate
    them. :func:`cause_logits` is sure, but wrong where something else moves the mean. So both are given, and
    the latter also times the probability that nothing else does.

    Parameters
    ----------
    logits : ndarray, shape (n_rigs, n_effects)
    causes : ndarray, shape (n_rigs, 3)
    names : sequence of str
        Of the effects.

    Returns
    -------
    ndarray, shape (n_rigs, n_numbers)
    """
    absent = 1 - expit(logits)
    known = known_effects()
    effects = [known.get(name) for name in names]
    parts = [logits[:, [effect is not None and effect.shows_as == _MEAN for effect in effects]], causes]
    moving = [effect is not None and effect.moves_mean for effect in effects]
    at_start = [effect is not None and effect.shows_as == _START for effect in effects]
    for hiding in (moving, at_start):
        plain = np.prod(absent[:, hiding], axis=1, keepdims=True)
        parts += [plain * causes, plain]
    return np.hstack(parts)


def mean_coefficients(told: Float, present: NDArray[np.bool_], names: Sequence[str]) -> Float:
    """Return coefficients of a logistic regression on :func:`of_mean`, and its constant, for each effect.

    NaN for effects that do not change the mean alone, and for those that fewer than 100 rigs have or lack.
    """
    found = np.full((len(names), told.shape[1] + 1), np.nan)
    centre, spread = told.mean(axis=0), told.std(axis=0) + 1e-9
    of_mean_alone = {name for name, effect in known_effects().items() if effect.shows_as == _MEAN}
    for k, (name, with_it) in enumerate(zip(names, present.T, strict=True)):
        if name in of_mean_alone and min(with_it.sum(), (~with_it).sum()) >= _MANY:
            line = LogisticRegression(max_iter=1000).fit((told - centre) / spread, with_it)
            weights = line.coef_[0] / spread
            found[k] = np.r_[weights, line.intercept_ - centre @ weights]
    return found


def spread_power(errors: Float, spreads: Float) -> float:
    """Return the power of the stated spreads to which the errors' spreads are proportional.

    By maximum likelihood of normal errors, with a factor of its own for each size. Noise on the inputs of the
    training blurs what is precise more than what is not, so that it is mostly above 1.

    Parameters
    ----------
    errors, spreads : ndarray, shape (n_rigs, n_sizes)
        Errors of sizes, NaN where an effect is absent, and their stated standard deviations.
    """
    enough = np.isfinite(errors).sum(axis=0) >= FEWEST_LEARNED
    if not enough.any():
        return 1.0
    errors, logarithms = errors[:, enough], np.log(spreads[:, enough])
    logarithms = np.where(np.isfinite(errors), logarithms, np.nan)
    n = np.isfinite(errors).sum(axis=0)

    def surprise(power: float) -> float:
        squares = np.nanmean((errors * np.exp(-power * logarithms)) ** 2, axis=0)
        return float(n @ np.log(squares) / 2 + power * np.nansum(logarithms))

    return float(minimize_scalar(surprise, bounds=_POWERS, method="bounded").x)


def quantiles_of(residuals: Float) -> Float:
    """Return quantiles of standardised errors, shape (n_sizes, 5), for few of them those of all together.

    Their expected coverage is nominal also for few residuals; NaN are left out.
    """
    found = np.tile(_quantiles(residuals), (residuals.shape[1], 1))
    for size, z in enumerate(residuals.T):
        if np.isfinite(z).sum() >= FEWEST_LEARNED:
            found[size] = _quantiles(z)
    return found


def _quantiles(residuals: Float) -> Float:
    found: Float = np.quantile(residuals[np.isfinite(residuals)], np.array(QUANTILES), method="weibull")
    return found
