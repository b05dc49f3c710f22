"""What can be told at best: likelihood of a window among simulated twins."""

from __future__ import annotations

from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from benchmarks.counting._data import N_LOBES, Windows
from cyclofeat import lobes

Complex = NDArray[np.complex128]
Float = NDArray[np.float64]

_LOWEST_LINE = 3  # below, the brake drifts
_POOLED = 0.3
_RIDGE = 1e-3


class Twins:
    """Normal law of the complex lobe lines of each count on one or both wheels, the pose marginalised.

    The law of each cell (count, wheels) has mean and covariance of simulated twins: assemblies of the
    same rig and noise, whose true pose (when lobe 0 passes, which lobe is the first worn one) is known. So
    it knows rig, tolerances and noise, and pin errors, contacts, speed and drift are integrated over by the
    twins. A window judged is given no pose: the mesh line tells where slots begin, and the likelihood is
    summed over the 15 lobes that may come first and over one or both wheels.

    It is the best that means and covariances of the 42 lines can tell, with ``_POOLED`` of each covariance
    taken from the mean over the cells. A law that is not normal, or other lines, could tell more.
    """

    def fit(self, lines: Complex, windows: Windows) -> Self:
        mesh = lobes.shift(lines, windows.passage)[windows.y > 0, N_LOBES - 1].sum()
        self.phase_ = float(np.angle(mesh) / (2 * np.pi))
        begins = self._begins(lines)
        first = np.argmax(windows.worn & ~np.roll(windows.worn, 1, axis=1), axis=1)
        slots = np.round((windows.passage - begins) * N_LOBES) + first
        posed = lobes.shift(lines, begins + slots / N_LOBES)
        cells = sorted(set(zip(windows.y.tolist(), windows.wheels.tolist(), strict=True)))
        points = {}
        for cell in cells:
            own = posed[(windows.y == cell[0]) & (windows.wheels == cell[1])]
            if cell[0] == 0:
                # sound lobes have no first one
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
        self.classes_ = np.unique(windows.y)
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
