"""Summaries that recordings without a missing effect have at a speed, load and count."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from sklearn.base import BaseEstimator
from sklearn.linear_model import Ridge

from cyclofeat.gap.posterior.calibration import cause_logits, gain_and_offset
from cyclofeat.gap.summaries.turns import uncorrelating_matrix
from cyclofeat.gap.world.world import Rigs, Session

Float = NDArray[np.float64]

_WAVES = 6  # lines in orders pass the bands in Hz as the speed changes
BEYOND = 0.03  # share by which a session may lie outside of the speeds and loads that were learned
_FARTHEST = 8.0
_SMALLEST_SHARE = 0.02  # least spread of a cell, as a share of its spread over all rigs


class Reference(BaseEstimator):
    """Mean and spread of each summary of recordings without a missing effect, by condition and count.

    Ridge regressions on speed, load and count, once with the count and once without it. ``uncorrelating_``
    makes the deviations uncorrelated: combinations of summaries that hardly vary show what none shows alone.
    """

    def fit(self, rigs: Rigs) -> Reference:
        """Learn from the rigs without effects."""
        healthy = rigs.of(np.flatnonzero(~rigs.present.any(axis=1)))
        is_real = np.isfinite(healthy.values[:, :, 0])
        if is_real.sum() < 100:
            raise ValueError(
                f"rigs must hold at least 100 recordings of rigs without an effect, got {is_real.sum()}"
            )
        self.speed_ = rigs.conditions[:, :, 0].min(), rigs.conditions[:, :, 0].max()
        self.load_ = rigs.conditions[:, :, 1].min(), rigs.conditions[:, :, 1].max()
        self.counts_ = np.unique(rigs.counts)
        values = healthy.values[is_real].astype(np.float64)
        conditions, counts = healthy.conditions[is_real], healthy.counts[is_real]
        # The first column of the inputs, a constant, is not shrunk.
        models = [
            Ridge(1.0).fit(self._regression_inputs(conditions, given)[:, 1:], values)
            for given in (counts, None)
        ]
        self.known_, self.unknown_ = (np.vstack([model.intercept_, model.coef_.T]) for model in models)
        residuals = values - self._regression_inputs(conditions, counts) @ self.known_
        self.overall_ = np.nanstd(rigs.values, axis=(0, 1), dtype=np.float64) + 1e-6
        self.spread_ = np.maximum(residuals.std(axis=0), _SMALLEST_SHARE * self.overall_) + 1e-6
        self.uncorrelating_ = uncorrelating_matrix(np.arcsinh(residuals / self.spread_))
        return self

    def check(self, session: Session) -> None:
        """Raise ValueError unless conditions and counts are like those of the rigs that it learned from."""
        named = (("speeds in RPM", self.speed_), ("loads in Nm", self.load_))
        for k, (what, (low, high)) in enumerate(named):
            least, most = session.conditions[:, k].min(), session.conditions[:, k].max()
            if not low * (1 - BEYOND) <= least <= most <= high * (1 + BEYOND):
                raise ValueError(
                    f"session must have {what} from {low:.4g} to {high:.4g}, like the world that the "
                    f"posterior learned from, got {least:.4g} to {most:.4g}"
                )
        if session.counts is not None and not np.isin(session.counts, self.counts_).all():
            raise ValueError(
                f"session must have counts of {self.counts_.tolist()}, like the world that the posterior "
                f"learned from, got {np.unique(session.counts).tolist()}"
            )

    def deviations(self, values: Float, conditions: Float, counts: NDArray[np.int64] | None) -> Float:
        """Return summaries less their reference, shape (n_recordings, 2 * n_cells).

        First arcsinh of the reference's spreads; then in units of the spread over all rigs, up to 8.
        """
        weights = self.unknown_ if counts is None else self.known_
        deviations = values - self._regression_inputs(conditions, counts) @ weights
        return np.hstack(
            [
                np.arcsinh(deviations / self.spread_),
                np.clip(deviations / self.overall_, -_FARTHEST, _FARTHEST),
            ]
        )

    def scale_conditions(self, conditions: Float) -> Float:
        """Return speed and load on a scale from -1 to 1 over what was learned, and the direction."""
        (slow, fast), (light, heavy) = self.speed_, self.load_
        speed, load, direction = np.moveaxis(conditions, -1, 0)
        return np.stack(
            [(2 * speed - slow - fast) / max(fast - slow, 1e-9),
             (2 * load - light - heavy) / max(heavy - light, 1e-9), direction], axis=-1,
        )  # fmt: skip

    def _regression_inputs(self, conditions: Float, counts: NDArray[np.int64] | None) -> Float:
        speed, load, _ = self.scale_conditions(conditions).T
        waves = np.arange(1, _WAVES + 1) * np.pi / 2 * speed[:, None]
        of_speed = np.column_stack([speed, speed**2, np.sin(waves), np.cos(waves)])
        columns = [
            np.ones(len(load)),
            of_speed,
            load,
            load**2,
            1 / conditions[:, 1],
            of_speed * load[:, None],
        ]
        if counts is not None:
            each = (counts[:, None] == self.counts_).astype(float)
            columns += [each, each * speed[:, None], each * load[:, None]]
        return np.column_stack(columns)


Single = NDArray[np.float32]
Flags = NDArray[np.bool_]

_LOW_COUNTS = 2  # counts up to it are pooled apart from larger ones
_SPEED_SCALES = 0.1, 0.005  # %: what the speed by the tachometer varies by, and that by the mesh from it
_SPEED_CELL = "speed: input speed by the mesh lines"
_MEAN_CELL = "amplitudes: mean"


@dataclass(frozen=True)
class Recordings:
    """Recordings of several sessions, padded to an equal number: (n_sessions, n_recordings, ...).

    ``known`` and ``unknown`` (2 * n_cells): deviations from the reference with the count and without it; 0
    for padding. ``conditions`` (3): speed in RPM, load in Nm, direction. ``speeds`` (2): arcsinh of the
    deviation of the speed by the tachometer, and of that by the mesh lines from it. ``mean_torque`` is in Nm,
    ``is_real`` False for padding.
    """

    known: Single
    unknown: Single
    conditions: Float
    counts: NDArray[np.int64]
    speeds: Float
    mean_torque: Float
    is_real: Flags

    def of(self, rows: NDArray[np.intp]) -> Recordings:
        """Return some of the sessions."""
        return dataclasses.replace(self, **{name: values[rows] for name, values in vars(self).items()})


# Arrays of sessions by name, as the network takes them, and what the mean torque alone says.
Inputs = tuple[dict[str, Single], Float]


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
    padded = recording_arrays(values, conditions, counts, speeds, reference, cells)
    return assemble_inputs(padded, padded.is_real, with_counts, tachometer, reference)


def recording_arrays(
    values: NDArray[np.floating], conditions: Float, counts: NDArray[np.int64], speeds: Float,
    reference: Reference, cells: tuple[str, ...],
) -> Recordings:  # fmt: skip
    """Return all recordings of simulated rigs, or of sessions that are padded with NaN to equal numbers."""
    is_real = np.isfinite(values[:, :, 0])
    deviations = np.zeros((2, *is_real.shape, 2 * values.shape[2]), dtype=np.float32)
    for part, known in zip(deviations, (counts[is_real], None), strict=True):
        part[is_real] = reference.deviations(values[is_real], conditions[is_real], known)
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
        is_real=is_real,
    )


def assemble_inputs(
    padded: Recordings, shown: Flags, with_counts: Flags, tachometer: Flags, reference: Reference
) -> Inputs:
    """Return the inputs of sessions of which some recordings are shown, with counts and tachometer or not.

    ``recordings`` (n_sessions, n_recordings, n_columns): deviations, then conditions, count and tachometer.
    ``shown`` and ``many`` (n_sessions, n_recordings): 1 for recordings that are shown, and for those with a
    known count above 2. ``whole`` (n_sessions, n_facts): fit of gain and offset, and what is known of the
    session. Beside them, (n_sessions, 3): :func:`cause_logits`.
    """
    known, turned = with_counts[:, None, None], tachometer[:, None, None]
    at = reference.scale_conditions(padded.conditions)
    counts = (padded.counts[:, :, None] == reference.counts_) & known
    speeds = np.where(turned, padded.speeds, 0.0)
    flags = np.broadcast_to(np.concatenate([known, turned], axis=2), (*shown.shape, 2))
    facts = np.concatenate([at, counts, speeds, flags], axis=2)
    deviations = np.where(known, padded.known, padded.unknown)
    recordings = np.concatenate([deviations, facts], axis=2, dtype=np.float32) * shown[:, :, None]
    n = shown.sum(axis=1, keepdims=True)
    weights = (shown / n)[:, :, None]
    mean_at = np.sum(at * weights, axis=1)
    spread_at = np.sqrt(np.sum((at - mean_at[:, None]) ** 2 * weights, axis=1))
    whole = np.concatenate(
        [
            gain_and_offset(padded.mean_torque, padded.conditions, shown), mean_at, spread_at, np.log(n),
            known[:, 0], turned[:, 0], np.sum(speeds * weights, axis=1),
        ],
        axis=1, dtype=np.float32,
    )  # fmt: skip
    many = shown & known[:, 0] & (padded.counts > _LOW_COUNTS)
    single = {"shown": shown.astype(np.float32), "many": many.astype(np.float32)}
    causes = cause_logits(padded.mean_torque, padded.conditions, shown)
    return {"recordings": recordings, **single, "whole": whole}, causes
