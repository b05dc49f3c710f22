"""Summaries that recordings without a missing effect have at a speed, load and count."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from sklearn.base import BaseEstimator
from sklearn.linear_model import Ridge

from cyclofeat.gap.summaries import uncorrelating
from cyclofeat.gap.world import Rigs, Session

Float = NDArray[np.float64]

_WAVES = 6  # lines in orders pass the bands in Hz as the speed changes
_BEYOND = 0.03  # share by which a session may lie outside of the speeds and loads that were learned
_FARTHEST = 8.0
_SMALLEST_SHARE = 0.02  # least spread of a cell, as a share of its spread over all rigs


def _ridge(inputs: Float, values: Float) -> Float:
    """Coefficients of a ridge regression; the first column of the inputs, a constant, is not shrunk."""
    model = Ridge(1.0).fit(inputs[:, 1:], values)
    return np.vstack([model.intercept_, model.coef_.T])


class Reference(BaseEstimator):
    """Mean and spread of each summary of recordings without a missing effect, by condition and count.

    Ridge regressions on speed, load and count, once with the count and once without it.

    Attributes
    ----------
    spread_, overall_ : ndarray, shape (n_cells,)
        Over such recordings, and over all rigs.
    uncorrelating_ : ndarray, shape (n_cells, n_cells)
        Matrix that makes the deviations of such recordings uncorrelated: combinations of summaries that
        hardly vary show what no summary shows alone.
    known_, unknown_ : ndarray, shape (n_inputs, n_cells)
        Coefficients with the count and without it.
    """

    def fit(self, rigs: Rigs) -> Reference:
        """Learn from the rigs without effects."""
        healthy = rigs.of(np.flatnonzero(~rigs.present.any(axis=1)))
        made = np.isfinite(healthy.values[:, :, 0])
        if made.sum() < 100:
            raise ValueError(
                f"rigs must hold at least 100 recordings of rigs without an effect, got {made.sum()}"
            )
        self.speed_ = rigs.conditions[:, :, 0].min(), rigs.conditions[:, :, 0].max()
        self.load_ = rigs.conditions[:, :, 1].min(), rigs.conditions[:, :, 1].max()
        self.counts_ = np.unique(rigs.counts)
        values = healthy.values[made].astype(np.float64)
        conditions, counts = healthy.conditions[made], healthy.counts[made]
        self.known_, self.unknown_ = (
            _ridge(self._inputs(conditions, given), values) for given in (counts, None)
        )
        residuals = values - self._inputs(conditions, counts) @ self.known_
        self.overall_ = np.nanstd(rigs.values, axis=(0, 1), dtype=np.float64) + 1e-6
        self.spread_ = np.maximum(residuals.std(axis=0), _SMALLEST_SHARE * self.overall_) + 1e-6
        self.uncorrelating_ = uncorrelating(np.arcsinh(residuals / self.spread_))
        return self

    def check(self, session: Session) -> None:
        """Raise ValueError unless conditions and counts are like those of the rigs that it learned from."""
        named = (("speeds in RPM", self.speed_), ("loads in Nm", self.load_))
        for k, (what, (low, high)) in enumerate(named):
            least, most = session.conditions[:, k].min(), session.conditions[:, k].max()
            if not low * (1 - _BEYOND) <= least <= most <= high * (1 + _BEYOND):
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

        First in units of the reference's spread, on a scale that is linear for small deviations and
        logarithmic for large ones; then in units of the spread over all rigs, up to 8.
        """
        weights = self.unknown_ if counts is None else self.known_
        deviations = values - self._inputs(conditions, counts) @ weights
        return np.hstack(
            [
                np.arcsinh(deviations / self.spread_),
                np.clip(deviations / self.overall_, -_FARTHEST, _FARTHEST),
            ]
        )

    def scaled(self, conditions: Float) -> Float:
        """Return speed and load on a scale from -1 to 1 over what was learned, and the direction."""
        (slow, fast), (light, heavy) = self.speed_, self.load_
        speed, load, direction = np.moveaxis(conditions, -1, 0)
        return np.stack(
            [(2 * speed - slow - fast) / max(fast - slow, 1e-9),
             (2 * load - light - heavy) / max(heavy - light, 1e-9), direction], axis=-1,
        )  # fmt: skip

    def _inputs(self, conditions: Float, counts: NDArray[np.int64] | None) -> Float:
        speed, load, _ = self.scaled(conditions).T
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
