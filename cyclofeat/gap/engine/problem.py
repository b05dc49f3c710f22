"""What the engine asks of a simulator: effects with priors, and simulated cells of recordings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Rig = Mapping[str, Mapping[str, float]]
"""Effects of a simulated rig by name, each with the values of its parameters."""


@dataclass(frozen=True)
class Parameter:
    """Parameter with its prior, log-uniform or uniform; the low end of a strength is the least to matter."""

    unit: str
    low: float
    high: float
    log: bool = True


@dataclass(frozen=True)
class Effect:
    """Effect that a rig may have.

    `parameters` by name, the strength first; `always`: every rig has the effect and only its sizes are
    unknown; `refines`: effects of which at least one must be present; `excludes`: effects of which none may
    be present.
    """

    parameters: Mapping[str, Parameter]
    always: bool = False
    refines: tuple[str, ...] = ()
    excludes: tuple[str, ...] = ()


class Problem(Protocol):
    """Simulator with effects, and the smallest differences of its cells that matter.

    `floors`: smallest spread of each cell that matters, shape (n_cells,); `blocks`: number of the quantity
    that each cell belongs to, from 0, shape (n_cells,).
    """

    effects: Mapping[str, Effect]
    floors: Array
    blocks: NDArray[np.int64]

    def simulate(self, conditions: Sequence[Any], rigs: Sequence[Rig]) -> Array:
        """Return the cells of each recording of each rig, shape (n_rigs, n_recordings, n_cells)."""
        ...


@dataclass(frozen=True)
class Session:
    """Measured cells of a session, with what simulates them.

    `conditions`: that of each recording, as the simulator takes it; `measured`: cells, (n_recordings,
    n_cells); `random_state`: seed of the starts of fits.
    """

    problem: Problem
    conditions: Sequence[Any]
    measured: Array
    random_state: int = 0

    def without(self, recording: int) -> Session:
        """Return the session without one recording."""
        conditions = [c for k, c in enumerate(self.conditions) if k != recording]
        return replace(self, conditions=conditions, measured=np.delete(self.measured, recording, axis=0))

    def deviations(self, rigs: Sequence[Rig]) -> Array:
        """Return measured minus simulated cells over the floors, (n_rigs, n_recordings, n_cells)."""
        return (self.measured - self.problem.simulate(self.conditions, rigs)) / self.problem.floors

    def mean_squares(self, deviations: Array) -> tuple[Array, Array]:
        """Return mean squares by recording and quantity, (..., n_recordings, n_blocks), and cells of each."""
        members = self.problem.blocks[:, None] == np.arange(self.problem.blocks.max() + 1)
        return deviations**2 @ members / members.sum(0), members.sum(0)

    def losses(self, deviations: Array) -> Array:
        r"""Return the loss of each recording in nats: of deviations (..., n_cells), (...,).

        For n cells of a quantity :math:`\frac{n}{2} \ln(1 + \frac{1}{n} \sum d^2)`, the loss of normal errors
        whose variance is fitted and exceeds the floor's.
        """
        squares, counts = self.mean_squares(deviations)
        losses: Array = np.log1p(squares) @ counts / 2
        return losses
