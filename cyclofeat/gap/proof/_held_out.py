"""Checks of recordings held out before anything is simulated, without reading their torque."""

from __future__ import annotations

from typing import Any

from numpy.typing import ArrayLike

from cyclofeat.gap.summaries import Conditions, check_counts, checked_speeds, recordings_of

_SUFFIX = "_hold"  # end of the names of arguments in errors


def check_held_out(
    conditions: Conditions,
    X: Any,
    y: ArrayLike | None,
    groups: ArrayLike | None,
    angle: ArrayLike | None,
    with_counts: bool,
) -> None:
    """Refuse data that the last stage could not use, by the shape of ``X`` and by the other arguments.

    No value of ``X`` is read; data without a known shape are checked in the last stage only. ``with_counts``
    states that counts are known of the recordings to be fitted. Raises ValueError.
    """
    if with_counts != (y is not None):
        given, not_given = ("y_fit", "y_hold") if with_counts else ("y_hold", "y_fit")
        raise ValueError(f"y_fit and y_hold must be given both or neither, got {given} without {not_given}")
    shape = _shape_of(X)
    if shape is None:
        return
    if len(shape) != 2 or shape[0] < 1:
        raise ValueError(f"X_hold must have the shape (n_windows, n_samples), got {shape}")
    if getattr(getattr(X, "dtype", None), "kind", "f") not in "fiu":
        raise ValueError(f"X_hold must hold real numbers, got dtype {X.dtype}")
    n_samples = conditions.whole_turns(shape[1], _SUFFIX)
    shaped_y, shaped_groups = (None if _shape_of(values) is None else values for values in (y, groups))
    _, counts = recordings_of(shape[0], shaped_y, shaped_groups, _SUFFIX)
    check_counts(counts, conditions.n_lobes, _SUFFIX)
    if angle is not None and _shape_of(angle) is not None:
        checked_speeds(angle, shape, n_samples, conditions.sampling_rate, _SUFFIX)


def _shape_of(values: Any) -> tuple[int, ...] | None:
    """Shape, if it is known without reading the values."""
    if hasattr(values, "shape"):
        return tuple(int(n) for n in values.shape)
    if isinstance(values, (list, tuple, range)):
        return (len(values), *((_shape_of(values[0]) or ()) if values else ()))
    return None
