"""Search for the parameters of effects, by straight lines through noisy summaries."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from cyclofeat.gap.size._model import PER_STEP, FitModel
from cyclofeat.gap.summaries import Cell, smallest_spreads, uncorrelating
from cyclofeat.simulators import SimulationFailed

Float = NDArray[np.float64]

_OUTLIER = 3.0  # whitened residual from which the weight of a cell falls
_ROUNDS = 4
_PER_ROUND = 3
_WIDEST = 0.25  # radius of the first round, in widths of the prior
_NEAR = 0.01  # distance, in widths of the prior, below which weights level off
_LEAST_SCATTER = 0.3  # least scatter of a cell, as a share of its scatter without the effect
_LEAST_LEFT = 0.5  # least variance after whitening: few recordings cannot show a smaller one
_FAILED = 50.0  # whitened residual of every cell if the simulation fails


class Whitener:
    """Conversion of deviations to uncorrelated ones, in standard deviations of one recording."""

    def __init__(self, correlated: Float, scatter: Float, cells: list[Cell]) -> None:
        smallest = smallest_spreads(cells)
        # A filter may make a cell almost constant: without a limit, rounding errors would be significant.
        least = _LEAST_SCATTER**2 * correlated.var(axis=0)
        self._scale = np.sqrt(np.maximum(scatter.var(axis=0), least) + smallest**2)
        self._turn = uncorrelating(correlated / np.sqrt(correlated.var(axis=0) + smallest**2))
        # With the effect the correlations may differ.
        left = np.mean(self(scatter) ** 2, axis=0)
        self._turn = self._turn / np.sqrt(np.maximum(left, _LEAST_LEFT))

    def __call__(self, values: Float) -> Float:
        """Whiten along the last axis, that of the cells."""
        return np.asarray((values / self._scale) @ self._turn)


class Estimate:
    """Gauss-Newton step with its standard deviation."""

    def __init__(
        self, whitener: Whitener, derivative: Float, difference: Float, scatter: Float, variance: float
    ) -> None:
        jacobian = whitener(derivative.T).T
        residuals = whitener(difference)
        self._whitener, self.weights = whitener, _weights(residuals / math.sqrt(variance))
        inverse = np.linalg.pinv(self.weights[:, None] * jacobian)
        self.step = inverse @ (self.weights * residuals)
        spread = inverse @ self.weighted(scatter).T
        covariance = spread @ spread.T / len(scatter) * variance
        self.deviation = np.sqrt(np.diag(covariance))
        left = residuals - jacobian @ self.step
        self.loss = float(np.mean(left**2) / variance)

    def weighted(self, values: Float) -> Float:
        """Summaries of recordings, whitened, with the weights of least squares."""
        return self._whitener(values) * self.weights


def _weights(residuals: Float) -> Float:
    """Return weights with which least squares has a loss that is linear for outliers."""
    return np.asarray((1 + (residuals / _OUTLIER) ** 2) ** -0.25)


class Search:
    """Search in rounds: places around the best one so far, and a straight line through their mean summaries.

    Contacts make the summaries noisy on the scale of a finite difference, so the slope comes from a line
    through several places instead of a difference of two.
    """

    def __init__(self, model: FitModel, target: Float, random: np.random.Generator) -> None:
        self.model, self.space, self.target, self.random = model, model.space, target, random
        self.radius = _WIDEST * self.space.widths
        self._places: list[Float] = []
        self._means: list[Float] = []

    def visit(self, place: Float) -> None:
        """Simulate at a place, unless it is known."""
        place = self.space.clipped(place)
        if not any(np.array_equal(place, known) for known in self._places):
            self._places.append(place)
            self._means.append(self.model.mean(place))

    def within(self, low: Float, high: Float) -> tuple[Float, Float]:
        """Places in a box, and their mean summaries."""
        inside = [
            k
            for k, place in enumerate(self._places)
            if np.all((low <= place) & (place <= high)) and np.all(np.isfinite(self._means[k]))
        ]
        return (
            np.array([self._places[k] for k in inside]).reshape(-1, low.size),
            np.array([self._means[k] for k in inside]).reshape(-1, self.target.size),
        )

    def best(self, whitener: Whitener) -> Float:
        """Return the known place with the smallest loss."""
        losses = [_loss(whitener(self.target - mean) * math.sqrt(PER_STEP)) for mean in self._means]
        return self._places[int(np.argmin(losses))]

    def run(self, whitener: Whitener, n_sims: int) -> Float:
        """Search in rounds of decreasing radius, and return the best place."""
        self.radius = _WIDEST * self.space.widths
        size = self.space.widths.size
        for _ in range(_ROUNDS):
            centre = self.best(whitener)
            offsets = qmc.Halton(size, seed=self.random).random(_PER_ROUND + 2 * size) * 2 - 1
            for offset in offsets:
                self.visit(centre + offset * self.radius)
            centre = self.best(whitener)
            mean, slope = self.line(centre)
            residuals = whitener(self.target - mean)
            weights = _weights(residuals * math.sqrt(PER_STEP))
            step = np.linalg.pinv(weights[:, None] * whitener(slope.T).T) @ (weights * residuals)
            self.visit(centre + np.clip(step, -self.radius, self.radius))
            self.radius = self.radius / 2
            if self.model.n_asked >= n_sims:
                break
        return self.best(whitener)

    def line(self, centre: Float) -> tuple[Float, Float]:
        """Mean summary at a place and its slope there, (n_cells,) and (n_cells, n_parameters)."""
        usable = [k for k, mean in enumerate(self._means) if np.all(np.isfinite(mean))]
        if len(usable) < 2:
            raise SimulationFailed("the simulations fail: the effect's size cannot be searched for")
        offsets = (np.array([self._places[k] for k in usable]) - centre) / self.space.widths
        distance = np.linalg.norm(offsets, axis=1)
        nearest = np.argsort(distance)[: 3 * offsets.shape[1] + 3]
        weights = 1 / (distance[nearest] + _NEAR)
        design = np.column_stack([np.ones(nearest.size), offsets[nearest]]) * weights[:, None]
        values = np.array([self._means[usable[k]] for k in nearest]) * weights[:, None]
        line = np.linalg.lstsq(design, values, rcond=1e-6)[0]
        return line[0], line[1:].T / self.space.widths


def _loss(residuals: Float) -> float:
    """Sum of a loss that is linear for outliers; failed simulations count as large residuals."""
    usable = np.where(np.isfinite(residuals), residuals, _FAILED)
    return float(np.sum(2 * (np.sqrt(1 + (usable / _OUTLIER) ** 2) - 1)))
