"""Features of a session: whatever the number and the order of its recordings, equally many."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from cyclofeat.gap.posterior._reference import Reference
from cyclofeat.gap.world import Session

Float = NDArray[np.float64]

# Prior spreads of the fit of gain and offset: share of the load, Nm, and what recordings differ by.
_GAIN, _OFFSET_NM = 0.06, 1.0
_LOAD_SHARE, _MEAN_NM = 0.003, 0.05
_LOW_COUNTS = 2  # counts up to it are pooled apart from larger ones
_SPEED_CELL = "speed: input speed by the mesh lines"
_MEAN_CELL = "amplitudes: mean"


def pooled(sessions: Iterable[Session], reference: Reference, cells: tuple[str, ...]) -> Float:
    """Return the features of sessions, shape (n_sessions, n_features)."""
    return np.array([_of_session(session, reference, cells) for session in sessions])


def _of_session(session: Session, reference: Reference, cells: tuple[str, ...]) -> Float:
    deviations = reference.deviations(session)
    uncorrelated = deviations.mean(axis=0) @ reference.uncorrelating_
    deviations = np.column_stack([deviations, _of_tachometer(session, cells.index(_SPEED_CELL))])
    mean = deviations.mean(axis=0)
    mean_torque = session.values[:, cells.index(_MEAN_CELL)]
    return np.concatenate(
        [
            mean, uncorrelated, deviations.std(axis=0),
            deviations.min(axis=0) - mean, deviations.max(axis=0) - mean,
            _difference_by_count(deviations, session.counts),
            gain_and_offset(mean_torque, session.conditions), _of_conditions(session),
        ]
    )  # fmt: skip


def _of_tachometer(session: Session, speed_cell: int) -> Float:
    """Return the speed by the tachometer and that by the mesh lines against it, in %; 0 without one."""
    if session.speeds_rpm is None:
        return np.zeros((len(session.values), 2))
    deviation = 100 * (session.speeds_rpm / session.conditions[:, 0] - 1)
    return np.column_stack([deviation, session.values[:, speed_cell] - deviation])


def _difference_by_count(deviations: Float, counts: NDArray[np.int64] | None) -> Float:
    """Return the mean over recordings with many worn lobes less that with few; 0 where one is missing."""
    many = np.zeros(len(deviations), dtype=bool) if counts is None else counts > _LOW_COUNTS
    if not many.any() or many.all():
        return np.zeros(deviations.shape[1])
    return np.asarray(deviations[many].mean(axis=0) - deviations[~many].mean(axis=0))


def gain_and_offset(mean_torque: Float, conditions: Float) -> Float:
    """Fit the deviation of the mean torque as gain times load plus offset.

    The offset keeps its sign when the rig reverses. A Gaussian prior holds both where one load and direction
    cannot tell them apart.

    Returns
    -------
    ndarray, shape (7,)
        Gain and offset, both over their standard errors, the logarithms of these errors, and that of the mean
        square of what the fit leaves.
    """
    _, load, direction = conditions.T
    error = np.hypot(_LOAD_SHARE * load, _MEAN_NM)
    inputs = np.column_stack([load, direction]) / error[:, None]
    deviation = (mean_torque - load) / error
    covariance = np.linalg.inv(inputs.T @ inputs + np.diag([_GAIN**-2, _OFFSET_NM**-2]))
    fitted = covariance @ inputs.T @ deviation
    errors = np.sqrt(np.diag(covariance))
    remainder = np.mean((deviation - inputs @ fitted) ** 2)
    return np.concatenate([fitted, fitted / errors, np.log(errors), [np.log(remainder + 0.1)]])


def _of_conditions(session: Session) -> Float:
    speed, load, direction = session.conditions.T
    return np.array(
        [
            len(session.values), session.counts is not None, session.speeds_rpm is not None,
            speed.mean(), np.ptp(speed), load.mean(), np.ptp(load), direction.mean(),
        ]
    )  # fmt: skip
