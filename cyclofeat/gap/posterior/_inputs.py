"""Sessions as the arrays that the network takes, whatever the number of their recordings."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cyclofeat.gap.posterior._mean_torque import cause_logits, gain_and_offset
from cyclofeat.gap.posterior._reference import Reference
from cyclofeat.gap.world import Rigs, Session

Float = NDArray[np.float64]
Single = NDArray[np.float32]
Flags = NDArray[np.bool_]

_LOW_COUNTS = 2  # counts up to it are pooled apart from larger ones
_SPEED_SCALES = 0.1, 0.005  # %: what the speed by the tachometer varies by, and that by the mesh from it
_SPEED_CELL = "speed: input speed by the mesh lines"
_MEAN_CELL = "amplitudes: mean"


@dataclass(frozen=True)
class Recordings:
    """Recordings of several sessions, padded to an equal number.

    Attributes
    ----------
    known, unknown : ndarray of float32, shape (n_sessions, n_recordings, 2 * n_cells)
        Deviations from the reference with the count and without it; 0 for padding.
    conditions : ndarray, shape (n_sessions, n_recordings, 3)
        Speed in RPM, load in Nm, direction.
    counts : ndarray of int, shape (n_sessions, n_recordings)
    speeds : ndarray, shape (n_sessions, n_recordings, 2)
        Deviation of the speed by the tachometer, and of that by the mesh lines from it, on a scale that is
        linear for small ones and logarithmic for large ones.
    mean_torque : ndarray, shape (n_sessions, n_recordings)
        In Nm.
    made : ndarray of bool, shape (n_sessions, n_recordings)
        False for padding.
    """

    known: Single
    unknown: Single
    conditions: Float
    counts: NDArray[np.int64]
    speeds: Float
    mean_torque: Float
    made: Flags

    def of(self, rows: NDArray[np.intp]) -> Recordings:
        """Return some of the sessions."""
        return dataclasses.replace(self, **{name: values[rows] for name, values in vars(self).items()})


@dataclass(frozen=True)
class Inputs:
    """Arrays that the network takes, and what the mean torque alone says.

    Attributes
    ----------
    recordings : ndarray of float32, shape (n_sessions, n_recordings, n_columns)
        Deviations, then conditions, count and tachometer of each recording.
    shown : ndarray of float32, shape (n_sessions, n_recordings)
        1, or 0 for recordings that are not shown.
    many : ndarray of float32, shape (n_sessions, n_recordings)
        1 for shown recordings with a known count above 2.
    whole : ndarray of float32, shape (n_sessions, n_facts)
        Fit of gain and offset, and what is known of the session.
    causes : ndarray, shape (n_sessions, 3)
        Not for the network: :func:`cause_logits`.
    """

    recordings: Single
    shown: Single
    many: Single
    whole: Single
    causes: Float

    @property
    def of_network(self) -> dict[str, Single]:
        """Arguments of the network."""
        return {name: value for name, value in vars(self).items() if name != "causes"}


class _Padded(NamedTuple):
    """Columns of :class:`Rigs`, or of sessions padded to equal numbers of recordings with NaN."""

    values: NDArray[np.floating]
    conditions: Float
    counts: NDArray[np.int64]
    speeds: Float


def recordings_of_rigs(rigs: Rigs, reference: Reference) -> Recordings:
    """Return all recordings of simulated rigs."""
    padded = _Padded(rigs.values, rigs.conditions, rigs.counts, rigs.speeds)
    return _recordings(padded, reference, rigs.cells, (True, True))


def inputs_of_sessions(sessions: Sequence[Session], reference: Reference, cells: tuple[str, ...]) -> Inputs:
    """Return the inputs of sessions with what is known of each."""
    shape = len(sessions), max(len(session.values) for session in sessions)
    values = np.full((*shape, len(cells)), np.nan)
    conditions, speeds = np.ones((*shape, 3)), np.ones(shape)
    counts = np.full(shape, reference.counts_[0])
    for k, session in enumerate(sessions):
        n = len(session.values)
        values[k, :n], conditions[k, :n] = session.values, session.conditions
        conditions[k, n:] = session.conditions[0]
        if session.counts is not None:
            counts[k, :n] = session.counts
        if session.speeds_rpm is not None:
            speeds[k, :n] = session.speeds_rpm
    with_counts = np.array([session.counts is not None for session in sessions])
    tachometer = np.array([session.speeds_rpm is not None for session in sessions])
    needed = bool(with_counts.any()), not with_counts.all()
    made = _recordings(_Padded(values, conditions, counts, speeds), reference, cells, needed)
    return assembled(made, made.made, with_counts, tachometer, reference)


def _recordings(
    padded: _Padded, reference: Reference, cells: tuple[str, ...], needed: tuple[bool, bool]
) -> Recordings:
    values, conditions, counts, speeds = padded
    made = np.isfinite(values[:, :, 0])
    shape = (*made.shape, 2 * values.shape[2])
    deviations = [np.zeros(shape, dtype=np.float32) for _ in needed]
    for part, known, wanted in zip(deviations, (True, False), needed, strict=True):
        if wanted:
            part[made] = reference.deviations(values[made], conditions[made], counts[made] if known else None)
    by_tachometer = 100 * (np.nan_to_num(speeds) / conditions[:, :, 0] - 1)
    by_mesh = np.nan_to_num(values[:, :, cells.index(_SPEED_CELL)])
    by_both = np.stack([by_tachometer, by_mesh - by_tachometer], axis=2)
    return Recordings(
        known=deviations[0],
        unknown=deviations[1],
        conditions=conditions,
        counts=counts,
        speeds=np.arcsinh(by_both / _SPEED_SCALES),
        mean_torque=np.nan_to_num(values[:, :, cells.index(_MEAN_CELL)]).astype(np.float64),
        made=made,
    )


def assembled(
    made: Recordings, shown: Flags, with_counts: Flags, tachometer: Flags, reference: Reference
) -> Inputs:
    """Return the inputs of sessions of which some recordings are shown, with counts and tachometer or not."""
    known, turned = with_counts[:, None, None], tachometer[:, None, None]
    at = reference.scaled(made.conditions)
    counts = (made.counts[:, :, None] == reference.counts_) & known
    speeds = np.where(turned, made.speeds, 0.0)
    flags = np.broadcast_to(np.concatenate([known, turned], axis=2), (*shown.shape, 2))
    facts = np.concatenate([at, counts, speeds, flags], axis=2)
    deviations = np.where(known, made.known, made.unknown)
    recordings = np.concatenate([deviations, facts], axis=2, dtype=np.float32) * shown[:, :, None]
    n = shown.sum(axis=1, keepdims=True)
    weights = (shown / n)[:, :, None]
    mean_at = np.sum(at * weights, axis=1)
    spread_at = np.sqrt(np.sum((at - mean_at[:, None]) ** 2 * weights, axis=1))
    whole = np.concatenate(
        [
            gain_and_offset(made.mean_torque, made.conditions, shown), mean_at, spread_at, np.log(n),
            known[:, 0], turned[:, 0], np.sum(speeds * weights, axis=1),
        ],
        axis=1, dtype=np.float32,
    )  # fmt: skip
    many = shown & known[:, 0] & (made.counts > _LOW_COUNTS)
    causes = cause_logits(made.mean_torque, made.conditions, shown)
    return Inputs(recordings, shown.astype(np.float32), many.astype(np.float32), whole, causes)
