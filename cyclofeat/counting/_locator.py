"""Which lobes are worn: a probability per lobe from the lobe map's slots."""

from __future__ import annotations

from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.base import BaseEstimator
from sklearn.ensemble import ExtraTreesClassifier
from sklearn.utils.validation import check_is_fitted, validate_data

from cyclofeat.features import LobeMap


def slot_of_lobe_zero(start_angle: ArrayLike, n_lobes: int = 15) -> NDArray[np.int64]:
    """Slot in which lobe 0 passes the load, for windows that start at an absolute input angle.

    The cam's direction in the wheel's frame is (z_k phi + pi)/z_s: it reaches the tip of lobe l, at
    2 pi l/z_s, after l slots and a fraction.

    Parameters
    ----------
    start_angle : array-like, shape (n_windows,)
        Input angle phi in rad at the first sample.
    n_lobes : int
        Number of lobes z_s.

    Returns
    -------
    ndarray of int, shape (n_windows,)
    """
    phi = np.asarray(start_angle, dtype=float)
    cam_in_wheel = ((n_lobes + 1) * phi + np.pi) / n_lobes
    return np.floor(-cam_in_wheel * n_lobes / (2 * np.pi)).astype(int) % n_lobes


class LobeLocator(BaseEstimator):
    """Probability that each lobe of a disc is worn.

    Every slot of the lobe map, seen with its neighbours (the map turned until that slot comes first), is one
    example of a worn or a sound lobe: what is learned about one lobe holds for all.

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

    Attributes
    ----------
    lobe_map_ : LobeMap
    trees_ : ExtraTreesClassifier
    """

    def __init__(
        self,
        sampling_rate: float,
        input_speed_hz: float = 500 / 60,
        n_lobes: int = 15,
        n_trees: int = 200,
        random_state: int | None = 0,
    ) -> None:
        self.sampling_rate = sampling_rate
        self.input_speed_hz = input_speed_hz
        self.n_lobes = n_lobes
        self.n_trees = n_trees
        self.random_state = random_state

    def fit(self, X: ArrayLike, worn: ArrayLike) -> Self:
        """Learn from windows whose worn lobes are known.

        Parameters
        ----------
        X : array-like, shape (n_windows, n_samples)
            Windows of torque in Nm.
        worn : array-like of bool, shape (n_windows, n_lobes)
            Whether the lobe in each slot is worn; slot 0 begins at the window's first sample, see
            :func:`slot_of_lobe_zero`.

        Returns
        -------
        self
        """
        X = validate_data(self, X, dtype=[np.float64, np.float32])
        target = np.asarray(worn, dtype=bool)
        if target.shape != (len(X), self.n_lobes):
            raise ValueError(
                f"worn must have shape (n_windows, n_lobes) = ({len(X)}, {self.n_lobes}), got {target.shape}"
            )
        if target.all() or not target.any():
            raise ValueError("worn must hold both worn and sound lobes, got one kind only")
        self.lobe_map_ = LobeMap(
            self.sampling_rate, input_speed_hz=self.input_speed_hz, n_lobes=self.n_lobes, align="start"
        ).fit(X)
        self.trees_ = ExtraTreesClassifier(
            self.n_trees, min_samples_leaf=3, max_features=0.5, random_state=self.random_state
        )
        self.trees_.fit(self._views(X), target.ravel())
        return self

    def predict_proba(self, X: ArrayLike) -> NDArray[np.float64]:
        """Probability that the lobe in each slot is worn.

        Parameters
        ----------
        X : array-like, shape (n_windows, n_samples)

        Returns
        -------
        ndarray, shape (n_windows, n_lobes)
        """
        check_is_fitted(self)
        X = validate_data(self, X, reset=False, dtype=[np.float64, np.float32])
        return np.asarray(self.trees_.predict_proba(self._views(X))[:, 1].reshape(len(X), self.n_lobes))

    def _views(self, X: NDArray[Any]) -> NDArray[np.float64]:
        """The map seen from each slot, shape (n_windows * n_lobes, 2 * n_lobes)."""
        slots = self.lobe_map_.transform(X)[:, : 2 * self.n_lobes].reshape(len(X), 2, self.n_lobes)
        turn = (np.arange(self.n_lobes) + np.arange(self.n_lobes)[:, np.newaxis]) % self.n_lobes
        return np.ascontiguousarray(slots[:, :, turn].transpose(0, 2, 1, 3)).reshape(-1, 2 * self.n_lobes)
