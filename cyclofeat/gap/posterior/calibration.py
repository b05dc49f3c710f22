"""What the mean torque of a session's recordings says of its gain, its offset and a friction."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar
from scipy.special import expit, logit, softmax
from sklearn.linear_model import LogisticRegression

from cyclofeat.simulators import known_effects

Float = NDArray[np.float64]
Flags = NDArray[np.bool_]

# Prior spreads of the fit of gain and offset: share of the load, Nm, and what recordings differ by.
_GAIN, _OFFSET_NM = 0.06, 1.0
_LOAD_SHARE, _MEAN_NM = 0.003, 0.05
_SMALL = 0.003, 0.05  # gain, and offset in Nm, from which their logarithm counts
# Assumed chance and spread of a gain (or scale of the load), an offset in Nm and a friction in Nm, and the
# degrees of freedom of what recordings differ by.
_CHANCES, _SPREADS = (0.18, 0.09, 0.09), (0.03, 0.5, 0.15)
_FREEDOM = 6.0
_SUREST = 8.0  # logit


def _mean_causes(mean_torque: Float, conditions: Float, shown: Flags) -> tuple[Float, Float]:
    """Return causes and deviation of the mean torque over its error; 0 for recordings that are not shown."""
    load, direction = conditions[:, :, 1], conditions[:, :, 2]
    error = np.hypot(_LOAD_SHARE * load, _MEAN_NM)
    causes = np.stack([load, direction, np.ones_like(load)], axis=2) * (shown / error)[:, :, None]
    return causes, (mean_torque - load) / error * shown


def gain_and_offset(mean_torque: Float, conditions: Float, shown: Flags) -> Float:
    """Explain the deviation of the mean torque by a gain, an offset and a friction, for each session.

    A gain grows with the load, an offset keeps its sign when the rig reverses, and a friction changes it.
    Each is fitted alone, then gain and offset together; a Gaussian prior holds these where one load and
    direction cannot tell them apart. Mean torque and ``shown`` have the shape (n_sessions, n_recordings),
    conditions one axis of 3 more.

    Returns, (n_sessions, 14): the three alone, over their standard errors; gain and offset together, then
    over their standard errors (all these by arcsinh); the logarithms of these errors; and the logarithms of
    the mean squares that each of the three leaves alone, that there are without any, and that both leave
    together.
    """
    n = shown.sum(axis=1, keepdims=True)
    causes, deviation = _mean_causes(mean_torque, conditions, shown)
    total = np.sum(deviation**2, axis=1, keepdims=True)
    alone = np.sum(causes * deviation[:, :, None], axis=1) / np.sqrt(np.sum(causes**2, axis=1))
    both = causes[:, :, :2]
    information = np.swapaxes(both, 1, 2) @ both + np.diag([_GAIN**-2, _OFFSET_NM**-2])
    covariance = np.linalg.inv(information)
    fitted = (covariance @ np.swapaxes(both, 1, 2) @ deviation[:, :, None])[:, :, 0]
    errors = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    left = deviation - (both @ fitted[:, :, None])[:, :, 0]
    squares = [np.maximum(total - alone**2, 0), total, np.sum(left**2, axis=1, keepdims=True)]
    return np.concatenate(
        [
            np.arcsinh(np.concatenate([alone, fitted / _SMALL, fitted / errors], axis=1)),
            np.log(errors), *(np.log(square / n + 0.1) for square in squares),
        ],
        axis=1,
    )  # fmt: skip


def cause_logits(mean_torque: Float, conditions: Float, shown: Flags) -> Float:
    """Return the logit of the probability that each of three causes moves the mean torque of a session.

    The causes are those of :func:`gain_and_offset`. Each of their eight sets is a linear model with a
    normal-inverse-gamma prior, whose evidence is exact (O'Hagan and Forster 2004, "Kendall's Advanced Theory
    of Statistics 2B: Bayesian Inference", ch. 11): the spread of the errors is uncertain, so that an odd
    recording does not decide. The logits, (n_sessions, 3), lie between -8 and 8.
    """
    causes, deviation = _mean_causes(mean_torque, conditions, shown)
    products = np.swapaxes(causes, 1, 2) @ causes
    moments = (np.swapaxes(causes, 1, 2) @ deviation[:, :, None])[:, :, 0]
    total, freedom = np.sum(deviation**2, axis=1), shown.sum(axis=1) + _FREEDOM
    chances, spreads = np.array(_CHANCES), np.array(_SPREADS)
    sets = np.array(list(itertools.product((False, True), repeat=3)))
    evidence = []
    for chosen in sets:
        information = products[:, chosen][:, :, chosen] + np.diag(spreads[chosen] ** -2)
        fitted = np.linalg.solve(information, moments[:, chosen, None])[:, :, 0]
        left = np.maximum(total - np.sum(moments[:, chosen] * fitted, axis=1), 0.0)
        occam = np.linalg.slogdet(information)[1] / 2 + np.log(spreads[chosen]).sum()
        prior = np.log(np.where(chosen, chances, 1 - chances)).sum()
        evidence.append(prior - occam - freedom / 2 * np.log1p(left / _FREEDOM))
    probabilities = softmax(np.transpose(evidence), axis=1) @ sets
    return np.asarray(np.clip(logit(np.minimum(probabilities, 1.0)), -_SUREST, _SUREST))


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


def mean_predictors(logits: Float, causes: Float, names: Sequence[str]) -> Float:
    """Return predictors of effects that only shift the mean torque, shape (n_rigs, n_predictors).

    The network, with noise on its inputs, is never sure of them; :func:`cause_logits` is, but wrong where
    something else moves the mean. So both are given, the latter also times the probability that nothing does.
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


def mean_coefficients(predictors: Float, present: NDArray[np.bool_], names: Sequence[str]) -> Float:
    """Return coefficients of logistic regressions on :func:`mean_predictors`; NaN where there is none."""
    coefficients = np.full((len(names), predictors.shape[1] + 1), np.nan)
    centre, spread = predictors.mean(axis=0), predictors.std(axis=0) + 1e-9
    of_mean_alone = {name for name, effect in known_effects().items() if effect.shows_as == _MEAN}
    for k, (name, with_it) in enumerate(zip(names, present.T, strict=True)):
        if name in of_mean_alone and min(with_it.sum(), (~with_it).sum()) >= _MANY:
            line = LogisticRegression(max_iter=1000).fit((predictors - centre) / spread, with_it)
            weights = line.coef_[0] / spread
            coefficients[k] = np.r_[weights, line.intercept_ - centre @ weights]
    return coefficients


def spread_power(errors: Float, spreads: Float) -> float:
    """Return the power of the stated spreads to which the errors' spreads are proportional, mostly above 1.

    By maximum likelihood of normal errors (n_rigs, n_sizes), NaN where absent, with a factor for each size.
    """
    enough = np.isfinite(errors).sum(axis=0) >= FEWEST_LEARNED
    if not enough.any():
        return 1.0
    errors, logarithms = errors[:, enough], np.log(spreads[:, enough])
    logarithms = np.where(np.isfinite(errors), logarithms, np.nan)
    n = np.isfinite(errors).sum(axis=0)

    def negative_likelihood(power: float) -> float:
        squares = np.nanmean((errors * np.exp(-power * logarithms)) ** 2, axis=0)
        return float(n @ np.log(squares) / 2 + power * np.nansum(logarithms))

    return float(minimize_scalar(negative_likelihood, bounds=_POWERS, method="bounded").x)


def quantiles_of(residuals: Float) -> Float:
    """Return quantiles of standardised errors, shape (n_sizes, 5), for few of them those of all together."""
    known = [z[np.isfinite(z)] for z in residuals.T]
    samples = [z if z.size >= FEWEST_LEARNED else np.concatenate(known) for z in known]
    return np.array([np.quantile(z, np.array(QUANTILES), method="weibull") for z in samples])
