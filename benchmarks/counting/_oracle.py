"""Reference for the best possible count: likelihood of a window among simulated twins."""

from __future__ import annotations

from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from benchmarks.counting._data import N_LOBES
from cyclofeat.signal import lobes

Complex = NDArray[np.complex128]
Float = NDArray[np.float64]

_LOWEST_LINE = 3  # lower lines hold the brake's drift
_POOLED = 0.3
_RIDGE = 1e-3


class Twins:
    """Normal distribution of the complex lobe lines per count and wheels, with the pose marginalised.

    The distribution of each cell (count, wheels) has mean and covariance of simulated twins: assemblies of
    the same rig and noise with known true pose (passage of lobe 0, first worn lobe). The oracle therefore
    knows rig, tolerances and noise; the twins integrate over pin errors, contacts, speed and drift. The pose
    of a test window is unknown: the mesh line gives the start of the slots, and the likelihood is summed over
    the 15 possible first lobes and over one or both wheels.

    It is the best result from means and covariances of the 42 lines, with the share ``_POOLED`` of each
    covariance taken from the mean over the cells. Another distribution or other lines could do better.
    """

    def fit(self, lines: Complex, y: Any, wheels: Any, worn: Any, passage: Float) -> Self:
        mesh = lobes.shift(lines, passage)[y > 0, N_LOBES - 1].sum()
        self.phase_ = float(np.angle(mesh) / (2 * np.pi))
        begins = self._begins(lines)
        first = np.argmax(worn & ~np.roll(worn, 1, axis=1), axis=1)
        slots = np.round((passage - begins) * N_LOBES) + first
        posed = lobes.shift(lines, begins + slots / N_LOBES)
        cells = sorted(set(zip(y.tolist(), wheels.tolist(), strict=True)))
        points = {}
        for cell in cells:
            own = posed[(y == cell[0]) & (wheels == cell[1])]
            if cell[0] == 0:
                # a healthy disc has no first worn lobe
                own = np.concatenate(
                    [lobes.shift(own, np.full(len(own), k / N_LOBES)) for k in range(N_LOBES)]
                )
            points[cell] = _real(own)
        self.scale_ = np.sqrt(np.mean([values.var(axis=0) for values in points.values()], axis=0))
        scatter = {cell: np.cov(values.T / self.scale_[:, np.newaxis]) for cell, values in points.items()}
        common = np.mean([found for (count, _), found in scatter.items() if count > 0], axis=0)
        self.laws_: dict[Any, tuple[Float, Float, float]] = {}
        for cell, found in scatter.items():
            if cell[0] > 0:
                found = (1 - _POOLED) * found + _POOLED * common
            root = np.linalg.cholesky(found + _RIDGE * np.eye(len(found)))
            mean = (points[cell] / self.scale_).mean(axis=0)
            self.laws_[cell] = mean, np.linalg.inv(root), float(np.log(np.diag(root)).sum())
        self.classes_ = np.unique(y)
        return self

    def predict(self, lines: Complex) -> NDArray[np.int64]:
        return np.asarray(self.classes_[np.argmax(self.scores(lines), axis=1)])

    def scores(self, lines: Complex) -> Float:
        """Log-likelihood of each count, shape (n_windows, n_classes)."""
        begins = self._begins(lines)
        poses = np.stack(
            [_real(lobes.shift(lines, begins + k / N_LOBES)) / self.scale_ for k in range(N_LOBES)], axis=1
        )
        by_cell: dict[int, list[Float]] = {}
        for (count, _), (mean, whitening, log_root) in self.laws_.items():
            distance = ((poses - mean) @ whitening.T) ** 2
            by_cell.setdefault(count, []).append(logsumexp(-distance.sum(axis=2) / 2 - log_root, axis=1))
        return np.stack(
            [logsumexp(by_cell[int(c)], axis=0) - np.log(len(by_cell[int(c)])) for c in self.classes_], axis=1
        )

    def _begins(self, lines: Complex) -> Float:
        phase = np.angle(lines[:, N_LOBES - 1]) / (2 * np.pi)
        return np.asarray((self.phase_ - phase) % 1.0 / N_LOBES)


def _real(lines: Complex) -> Float:
    kept = lines[:, _LOWEST_LINE - 1 :]
    return np.concatenate([kept.real, kept.imag], axis=1)
