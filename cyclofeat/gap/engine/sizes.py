"""Sizes of a given set of effects: damped steps along simulated responses, from several starts."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.stats import qmc

from .problem import Array, Parameter, Session

DAMPING = (0.0, 0.1, 1.0, 10.0, 100.0)
STEPS = 20
SMALLEST_GAIN = 0.05
DRAWN = 64
"""Drawn sizes, of which the best are further starts."""
STARTS = 10
RESOLUTION = 0.5
"""Difference in nats up to which two losses are the same."""


class Axis(NamedTuple):
    """One parameter of one effect, in the coordinate in which responses are taken to be linear.

    The prior's range is 0 to 1. A strength keeps its own scale, because most effects are proportional to it.
    """

    effect: str
    name: str
    parameter: Parameter
    logarithm: bool

    def value(self, x: float) -> float:
        """Return the value at a coordinate."""
        low, high = self.parameter.low, self.parameter.high
        return float(low * (high / low) ** x if self.logarithm else low + x * (high - low))


def make_rig(axes: Sequence[Axis], x: Array) -> dict[str, dict[str, float]]:
    """Return the rig at coordinates."""
    rig: dict[str, dict[str, float]] = {}
    for axis, coordinate in zip(axes, x, strict=True):
        rig.setdefault(axis.effect, {})[axis.name] = axis.value(coordinate)
    return rig


class Fit(NamedTuple):
    """Effects with fitted sizes: coordinates `x` along `axes`, and the loss of each recording."""

    axes: tuple[Axis, ...]
    x: Array
    losses: Array

    @property
    def loss(self) -> float:
        """Loss of all recordings."""
        return float(self.losses.sum())


def solve_in_box(hessian: Array, gradient: Array, x: Array) -> Array:
    """Return the minimum of ``y H y / 2 - g y``, y from x, where x + y lies in 0 to 1: x + y."""
    y = np.clip(np.linalg.solve(hessian, gradient), -x, 1 - x)
    for _ in range(30):
        previous = y.copy()
        for k in range(len(y)):
            y[k] = np.clip(y[k] + (gradient[k] - hessian[k] @ y) / hessian[k, k], -x[k], 1 - x[k])
        if np.abs(y - previous).max() < 1e-6:
            break
    return np.asarray(x + y)


def descend(session: Session, axes: tuple[Axis, ...], x: Array) -> Fit:
    """Fit sizes from one start, until no step gains more than `SMALLEST_GAIN`.

    Each step takes the best, as simulated, of solutions of the linear model inside the priors at several
    dampings, or, if none gains (the motion sticks and slips), of points along each axis.
    """

    def simulate(points: Sequence[Array]) -> tuple[Array, Array]:
        deviations = session.deviations([make_rig(axes, point) for point in points])
        return deviations, session.losses(deviations)

    (deviations,), (losses,) = simulate([x])
    logarithm = np.array([axis.logarithm for axis in axes])
    for _ in range(STEPS if axes else 0):
        step = np.diag(np.where(logarithm, 0.01, np.maximum(0.06 * x, 0.005)))
        ends = np.clip([x + step, x - step], 0, 1)
        above, below = simulate(ends.reshape(-1, len(x)))[0].reshape(2, len(x), *deviations.shape)
        responses = (below - above) / np.ptp(ends, axis=0).sum(1)[:, None, None]
        weights = (1 / (1 + session.mean_squares(deviations)[0]))[:, session.problem.blocks]
        hessian = np.einsum("arc,brc,rc->ab", responses, responses, weights)
        gradient = np.einsum("arc,rc,rc->a", responses, deviations, weights)
        diagonal = np.diag(np.diag(hessian) + 1e-3)
        along = [np.clip(x + f * row, 0, 1) for row in step for f in (-2, -0.5, 0.5, 2)]
        for points in ([solve_in_box(hessian + (1e-9 + d) * diagonal, gradient, x) for d in DAMPING], along):
            tried = simulate(points)
            best = int(np.argmin(tried[1].sum(1)))
            gain = losses.sum() - tried[1][best].sum()
            if gain > 0:
                x, deviations, losses = points[best], tried[0][best], tried[1][best]
            if gain > SMALLEST_GAIN:
                break
        else:
            break
    return Fit(axes, x, losses)


def fit_sizes(session: Session, names: Sequence[str], near: Sequence[Fit] = ()) -> Fit:
    """Fit the sizes of a set of effects from several starts, until the best loss recurs.

    Starts are those of the nearby fits, with drawn sizes of other effects, then the best of drawn sizes.
    """
    axes = tuple(
        Axis(name, key, parameter, parameter.log and k > 0)
        for name in names
        for k, (key, parameter) in enumerate(session.problem.effects[name].parameters.items())
    )
    if not axes:
        return descend(session, axes, np.zeros(0))
    drawn = qmc.Sobol(len(axes), rng=session.random_state).random(DRAWN)
    starts = []
    for fit in near:
        known = {axis[:2]: x for axis, x in zip(fit.axes, fit.x, strict=True)}
        starts.append(drawn[: DRAWN // 2].copy())
        for k, axis in enumerate(axes):
            starts[-1][:, k] = known.get(axis[:2], starts[-1][:, k])
    points = np.concatenate([*starts, drawn])
    losses = session.losses(session.deviations([make_rig(axes, x) for x in points])).sum(1)
    firsts = [
        begin + int(np.argmin(losses[begin:][: DRAWN // 2]))
        for begin in range(0, len(points) - DRAWN, DRAWN // 2)
    ]
    fits: list[Fit] = []
    for k in [*firsts, *(k for k in np.argsort(losses) if k not in firsts)][:STARTS]:
        fits.append(descend(session, axes, points[k]))
        best = sorted(fit.loss for fit in fits)[:2]
        if len(fits) > max(len(near), 1) and best[1] - best[0] <= RESOLUTION:
            break
    return min(fits, key=lambda fit: fit.loss)
