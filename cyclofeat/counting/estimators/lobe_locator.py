"""Locator of worn lobes: a probability per lobe from the folded torque."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.base import BaseEstimator
from sklearn.utils.validation import check_is_fitted, validate_data

from cyclofeat.counting.estimators._lobe_map import held_lobe_map
from cyclofeat.counting.estimators.trees import CountingTrees
from cyclofeat.counting.evaluation.assembly_folds import of_windows
from cyclofeat.signal import lobes


def passage_of_lobe_zero(start_angle: ArrayLike, n_lobes: int = 15) -> NDArray[np.float64]:
    """Return when lobe 0 passes the cam's direction, for windows that start at an absolute input angle.

    In the wheel's frame the cam points in direction (z_k phi + pi)/z_s, at the tip of lobe l at 2 pi l/z_s.

    Parameters
    ----------
    start_angle : array-like, shape (n_windows,)
        Input angle phi in rad at the first sample.
    n_lobes : int
        Number of lobes z_s.

    Returns
    -------
    ndarray, shape (n_windows,)
        Time from the first sample in periods of the lobe frequency, from 0 to 1.
    """
    phi = np.asarray(start_angle, dtype=float)
    cam_in_wheel = ((n_lobes + 1) * phi + np.pi) / n_lobes
    return np.asarray(-cam_in_wheel / (2 * np.pi) % 1.0)


def known_lobes(
    worn: ArrayLike, passage: ArrayLike | None, n_windows: int, n_lobes: int
) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
    """Return the table of worn lobes and when lobe 0 passes, checked."""
    if passage is None:
        raise ValueError("passage must be given together with worn: it says when the lobes pass, got None")
    known = np.asarray(worn, dtype=bool)
    if known.shape != (n_windows, n_lobes):
        expected = (n_windows, n_lobes)
        raise ValueError(f"worn must have shape (n_windows, n_lobes) = {expected}, got {known.shape}")
    return known, np.asarray(of_windows("passage", passage, n_windows), dtype=float)


@dataclass(eq=False, repr=False)
class LobeLocator(BaseEstimator):
    """Probability that each lobe of a disc is worn.

    The whitened torque is folded at the lobe frequency (``cyclofeat.signal.lobes``), from the passage of
    lobe 0 on. The fold turned until a slot comes first is one example of a worn or a sound lobe: what is
    learned about one lobe holds for all.

    Parameters
    ----------
    sampling_rate : float
        Samples per second of the windows, in Hz.
    input_speed_hz : float
        Nominal input speed in turns per second.
    n_lobes : int
        Number of lobes of a disc.
    n_trees : int
        Number of trees.
    random_state : int or None
        Seed of the trees.
    speed_tolerance : float
        As of :class:`~cyclofeat.features.LobeMap`.
    """

    sampling_rate: float
    input_speed_hz: float = 500 / 60
    n_lobes: int = 15
    n_trees: int = 200
    random_state: int | None = 0
    speed_tolerance: float = lobes.SPEED_TOLERANCE

    def fit(self, X: ArrayLike, worn: ArrayLike, passage: ArrayLike) -> Self:
        """Learn from windows whose worn lobes are known.

        Parameters
        ----------
        X : array-like, shape (n_windows, n_samples)
            Windows of torque in Nm.
        worn : array-like of bool, shape (n_windows, n_lobes)
            Whether each lobe is worn.
        passage : array-like, shape (n_windows,)
            When lobe 0 passes the cam's direction, see :func:`passage_of_lobe_zero`.

        Returns
        -------
        self

        Raises
        ------
        ValueError
            Where shapes do not match, or lobes are all worn or all sound.
        """
        windows: NDArray[Any] = validate_data(self, X, dtype=[np.float64, np.float32])
        target, _ = known_lobes(worn, passage, len(windows), self.n_lobes)
        if target.all() or not target.any():
            raise ValueError("worn must hold both worn and sound lobes, got one kind only")
        self.lobe_map_ = held_lobe_map(
            self.sampling_rate, self.input_speed_hz, self.n_lobes, self.speed_tolerance
        ).fit(windows)
        self.trees_ = CountingTrees(
            self.n_trees, min_samples_leaf=3, max_features=0.5, random_state=self.random_state
        )
        self.trees_.fit(self._views(self.lobe_map_.lines(windows), passage), target.ravel())
        return self

    def predict_proba(self, X: ArrayLike, passage: ArrayLike) -> NDArray[np.float64]:
        """Probability that each lobe is worn, shape (n_windows, n_lobes); arguments as for :meth:`fit`."""
        check_is_fitted(self)
        windows: NDArray[Any] = validate_data(self, X, reset=False, dtype=[np.float64, np.float32])
        return self._from_lines(self.lobe_map_.lines(windows), passage)

    def _from_lines(self, found: lobes.LobeLines, passage: ArrayLike) -> NDArray[np.float64]:
        """Return the probability of each lobe from given lobe lines."""
        proba = self.trees_.predict_proba(self._views(found, passage))[:, 1]
        return np.asarray(proba.reshape(len(found.lines), self.n_lobes))

    def _views(self, found: lobes.LobeLines, passage: ArrayLike) -> NDArray[np.float64]:
        """Return the fold rotated to each lobe, shape (n_windows * n_lobes, 2 * n_lobes)."""
        begins = np.asarray(of_windows("passage", passage, len(found.lines)), dtype=float)
        folded = lobes.fold(lobes.shift(found.lines, begins), self.n_lobes)
        slots = np.stack([folded.mean(axis=2), folded.std(axis=2)], axis=1)
        turn = (np.arange(self.n_lobes) + np.arange(self.n_lobes)[:, np.newaxis]) % self.n_lobes
        return np.ascontiguousarray(slots[:, :, turn].transpose(0, 2, 1, 3)).reshape(-1, 2 * self.n_lobes)
