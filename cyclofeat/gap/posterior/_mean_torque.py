"""What the mean torque of a session's recordings says of its gain, its offset and a friction."""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray
from scipy.special import logit, softmax

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


def _causes(mean_torque: Float, conditions: Float, shown: Flags) -> tuple[Float, Float]:
    """Return causes and deviation of the mean torque over its error; 0 for recordings that are not shown."""
    load, direction = conditions[:, :, 1], conditions[:, :, 2]
    error = np.hypot(_LOAD_SHARE * load, _MEAN_NM)
    causes = np.stack([load, direction, np.ones_like(load)], axis=2) * (shown / error)[:, :, None]
    return causes, (mean_torque - load) / error * shown


def gain_and_offset(mean_torque: Float, conditions: Float, shown: Flags) -> Float:
    """Explain the deviation of the mean torque by a gain, an offset and a friction, for each session.

    A gain grows with the load, an offset keeps its sign when the rig reverses, and a friction changes it.
    Each is fitted alone, then gain and offset together; a Gaussian prior holds these where one load and
    direction cannot tell them apart.

    Parameters
    ----------
    mean_torque : ndarray, shape (n_sessions, n_recordings)
    conditions : ndarray, shape (n_sessions, n_recordings, 3)
    shown : ndarray of bool, shape (n_sessions, n_recordings)

    Returns
    -------
    ndarray, shape (n_sessions, 14)
        The three alone, over their standard errors; gain and offset together, then over their standard
        errors; the logarithms of these errors; and the logarithms of the mean squares that each of the three
        leaves alone, that there are without any, and that gain and offset leave together. All but logarithms
        are on a scale that is linear for small values and logarithmic for large ones.
    """
    n = shown.sum(axis=1, keepdims=True)
    causes, deviation = _causes(mean_torque, conditions, shown)
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
            np.log(errors), *(np.log(some / n + 0.1) for some in squares),
        ],
        axis=1,
    )  # fmt: skip


def cause_logits(mean_torque: Float, conditions: Float, shown: Flags) -> Float:
    """Return the logit of the probability that each of three causes moves the mean torque of a session.

    The causes are those of :func:`gain_and_offset`. Each of their eight sets is a linear model with a
    normal-inverse-gamma prior, whose evidence is exact (O'Hagan and Forster 2004, "Kendall's Advanced Theory
    of Statistics 2B: Bayesian Inference", ch. 11): the spread of the errors is uncertain, so that an odd
    recording does not decide. What else moves the mean, like a warm-up, is taken for one of the causes.

    Parameters
    ----------
    mean_torque, conditions, shown
        As for :func:`gain_and_offset`.

    Returns
    -------
    ndarray, shape (n_sessions, 3)
        From -8 to 8.
    """
    causes, deviation = _causes(mean_torque, conditions, shown)
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
    there = softmax(np.transpose(evidence), axis=1) @ sets
    return np.asarray(np.clip(logit(np.minimum(there, 1.0)), -_SUREST, _SUREST))
