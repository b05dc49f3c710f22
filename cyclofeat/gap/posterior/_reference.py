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
_SMALLEST_SHARE = 0.02  # least spread of a cell, as a share of its spread over all rigs


class Reference(BaseEstimator):
    """Mean and spread of each summary of recordings without a missing effect, by condition and count.

    Ridge regressions on speed, load and count, once with the count and once without it.

    Attributes
    ----------
    spread_ : ndarray, shape (n_cells,)
    uncorrelating_ : ndarray, shape (n_cells, n_cells)
        Matrix that makes the deviations of such recordings uncorrelated: combinations of summaries that
        hardly vary show what no summary shows alone.
    known_, unknown_ : Ridge
        With the count and without it.
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
        self.known_ = Ridge(1.0).fit(self._inputs(conditions, counts), values)
        self.unknown_ = Ridge(1.0).fit(self._inputs(conditions, None), values)
        residuals = values - self.known_.predict(self._inputs(conditions, counts))
        overall = np.nanstd(rigs.values, axis=(0, 1), dtype=np.float64)
        self.spread_ = np.maximum(residuals.std(axis=0), _SMALLEST_SHARE * overall) + 1e-6
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

    def deviations(self, session: Session) -> Float:
        """Return the summaries less their reference, in units of its spread: (n_recordings, n_cells).

        On a scale that is linear for small deviations and logarithmic for large ones.
        """
        model = self.unknown_ if session.counts is None else self.known_
        expected = model.predict(self._inputs(session.conditions, session.counts))
        return np.asarray(np.arcsinh((session.values - expected) / self.spread_))

    def _inputs(self, conditions: Float, counts: NDArray[np.int64] | None) -> Float:
        speed, load = (
            (2 * conditions[:, k] - low - high) / max(high - low, 1e-9)
            for k, (low, high) in enumerate((self.speed_, self.load_))
        )
        waves = np.arange(1, _WAVES + 1) * np.pi / 2 * speed[:, None]
        of_speed = np.column_stack([speed, speed**2, np.sin(waves), np.cos(waves)])
        columns = [of_speed, load, load**2, 1 / conditions[:, 1], of_speed * load[:, None]]
        if counts is not None:
            each = (counts[:, None] == self.counts_).astype(float)
            columns += [each, each * speed[:, None], each * load[:, None]]
        return np.column_stack(columns)
