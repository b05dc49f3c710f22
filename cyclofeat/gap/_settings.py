"""Settings of the gap."""

from __future__ import annotations

import os
from dataclasses import dataclass

from cyclofeat._base import checks


@dataclass(frozen=True)
class GapSettings:
    """Settings of :func:`find_gap`.

    Attributes
    ----------
    alpha : float
        Chance of a false "disagree".
    pictures : bool
        Whether to fold torque over the turn and to test all numbers at once, as the page shows them.
    n_after, n_report : int
        Simulated recordings of the corrected model in the overlays, and of each model that is judged by the
        recordings held out.
    n_permutations : int
        Relabellings of the comparison.
    n_bank : int
        Simulated recordings that those of each condition are compared with.
    random_state, n_jobs : int
        Of all simulations; number of worker processes.
    cache : path or None
        Folder in which simulations are kept.
    one_assembly : bool
        Whether all recordings are of one gearbox that was not taken apart between them.

    Raises
    ------
    ValueError, TypeError
        If a value is out of range.
    """

    alpha: float = 0.03
    pictures: bool = True
    n_after: int = 96
    n_report: int = 64
    n_permutations: int = 999
    n_bank: int = 200
    random_state: int = 0
    n_jobs: int = 1
    cache: str | os.PathLike[str] | None = None
    one_assembly: bool = False

    def __post_init__(self) -> None:
        if not 0 < checks.number("alpha", self.alpha) < 1:
            raise ValueError(f"alpha must be between 0 and 1, got {self.alpha!r}")
        least = {
            "n_after": 10,
            "n_report": 10,
            "n_permutations": 19,
            "n_bank": 10,
            "random_state": 0,
        }
        for name, low in least.items():
            checks.whole(name, getattr(self, name), low)
