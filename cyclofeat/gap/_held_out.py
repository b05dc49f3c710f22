"""Recordings held out: checked before anything is simulated, without a look at their torque."""

from __future__ import annotations

from typing import Any

from numpy.typing import ArrayLike

from cyclofeat.gap._recordings import in_whole_turns, mean_speeds, recordings_of

_OF = "_hold"  # ends the arguments' names


def check_held_out(
    X: Any,
    y: ArrayLike | None,
    groups: ArrayLike | None,
    angle: ArrayLike | None,
    *,
    with_counts: bool,
    sampling_rate: float,
    input_speed_hz: float,
    n_lobes: int,
) -> None:
    """Refuse what the last stage could not use, by the shape of ``X`` and by what goes with it.

    No value of ``X`` is read, and nothing is kept of the others. What does not say its shape is left to the
    last stage, which reads it.

    Parameters
    ----------
    X : array-like, shape (n_windows, n_samples)
        Torque in Nm of the recordings held out.
    y, groups, angle : array-like, optional
        As :meth:`cyclofeat.gap.DiscrepancyWorkflow.fit` takes them.
    with_counts : bool
        Whether counts are known of the recordings to be fitted.
    sampling_rate, input_speed_hz : float
        In Hz.
    n_lobes : int

    Raises
    ------
    ValueError
        Where they do not fit together, or not to the recordings to be fitted.
    """
    if with_counts != (y is not None):
        given, not_given = ("y_fit", "y_hold") if with_counts else ("y_hold", "y_fit")
        raise ValueError(f"y_fit and y_hold must be given both or neither, got {given} without {not_given}")
    shape = _shape_of(X)
    if shape is None:
        return
    if len(shape) != 2 or shape[0] < 1:
        raise ValueError(f"X_hold must have the shape (n_windows, n_samples), got {shape}")
    kind = getattr(getattr(X, "dtype", None), "kind", "f")
    if kind not in "fiu":
        raise ValueError(f"X_hold must hold real numbers, got dtype {X.dtype}")
    in_whole_turns(shape[1], sampling_rate, input_speed_hz, n_lobes, _OF)
    told_y, told_groups = (None if _shape_of(values) is None else values for values in (y, groups))
    _, counts = recordings_of(shape[0], told_y, told_groups, _OF)
    if counts is not None and counts.max() > n_lobes:
        raise ValueError(f"y_hold must hold counts from 0 to the {n_lobes} lobes, got {counts.max()}")
    if angle is not None and _shape_of(angle) is not None:
        mean_speeds(angle, shape, sampling_rate, _OF)


def _shape_of(values: Any) -> tuple[int, ...] | None:
    """Shape, where it is told without a look at the values."""
    if hasattr(values, "shape"):
        return tuple(int(n) for n in values.shape)
    if isinstance(values, (list, tuple, range)):
        return (len(values), *((_shape_of(values[0]) or ()) if values else ()))
    return None
