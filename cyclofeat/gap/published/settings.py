"""Settings of the gap in published statistics."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass

from cyclofeat._base import checks


@dataclass(frozen=True)
class PublishedSettings:
    """Settings of :func:`find_published_gap`.

    Attributes
    ----------
    library : sequence of str or None
        Effects that are considered, of ``known_effects(proposed=True)``
        (:func:`cyclofeat.simulators.known_effects`) and ``"load_scale"``. None: all but ``"clock_error"``,
        which does not change these statistics.
    max_effects : int
    max_simulated : int
        Largest number of named effects that change the gearbox's motion: each set of those needs simulations
        of its own, while effects of the meter are applied to stored records.
    duration : float
        Length of the records in s. *Assumption* where the source does not state it.
    n_draws : int
        Simulated rigs per effect of one parameter; with p parameters p^2 times as many.
    alpha : float
        One-sided sign-flip p over discs left out up to which an effect is added.
    table : path or None
        File of simulated statistics that :meth:`PublishedGap.save_table` wrote for the same comparison and
        settings. Sets of effects that it does not hold are simulated.

    Raises
    ------
    TypeError, ValueError
        If a value is out of range.
    """

    library: Sequence[str] | None = None
    max_effects: int = 3
    max_simulated: int = 1
    duration: float = 1.8
    n_draws: int = 6
    alpha: float = 0.05
    table: str | os.PathLike[str] | None = None

    def __post_init__(self) -> None:
        checks.whole("max_effects", self.max_effects, 1)
        checks.whole("max_simulated", self.max_simulated, 0)
        checks.positive("duration", self.duration, "a number of s")
        checks.whole("n_draws", self.n_draws, 1)
        if not 0 < checks.number("alpha", self.alpha) < 1:
            raise ValueError(f"alpha must be between 0 and 1, got {self.alpha!r}")
