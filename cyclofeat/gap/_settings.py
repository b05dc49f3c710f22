"""Settings of the gap, and recordings as it takes them."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from sklearn.utils.validation import check_array

from cyclofeat._base import checks
from cyclofeat.gap.comparison import Comparison
from cyclofeat.gap.summaries import Measured
from cyclofeat.simulators import CycloidalGearbox, Rig


@dataclass(frozen=True, eq=False)
class Windows:
    """Windows of recordings, with what is known of them.

    Attributes
    ----------
    X : array-like, shape (n_windows, n_samples)
        Torque in Nm, at least one output turn per window.
    y : array-like of int, shape (n_windows,), optional
        Known counts of worn lobes.
    groups : array-like, shape (n_windows,), optional
        Recording of each window. Default: each window is a recording of its own.
    angle : array-like, shape (n_windows, n_samples), optional
        Angle of the input shaft in rad, by a tachometer.
    """

    X: ArrayLike
    y: ArrayLike | None = None
    groups: ArrayLike | None = None
    angle: ArrayLike | None = None

    @property
    def data(self) -> dict[str, Any]:
        """Everything but the torque, as keyword arguments."""
        return {"y": self.y, "groups": self.groups, "angle": self.angle}


@dataclass(frozen=True)
class GapSettings:
    """Settings of :func:`find_gap`.

    Attributes
    ----------
    alpha : float
        Chance of a false "disagree".
    baselines : sequence of str
        Alternatives to the corrected model: ``"nothing"``, ``"retuned"`` (left out for a user's simulator),
        ``"equaliser"``, ``"gaussian_process"``.
    oracle : Rig, CycloidalGearbox or None
        The truth, where it is known (in a benchmark); compared in the last stage and not used before.
    pictures : bool
        Whether to fold torque over the turn and to test all numbers at once, as the page shows them.
    n_after, n_report : int
        Simulated recordings of the comparison with the corrected model, and of each alternative on the
        recordings held out.
    n_sessions : int
        Simulated sessions of each of the two rounds of the confirmation.
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
    baselines: Sequence[str] = ("nothing", "retuned", "equaliser", "gaussian_process")
    oracle: Rig | CycloidalGearbox | None = None
    pictures: bool = True
    n_after: int = 96
    n_report: int = 64
    n_sessions: int = 96
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
            "n_sessions": 32,
            "n_permutations": 19,
            "n_bank": 10,
            "random_state": 0,
        }
        for name, low in least.items():
            checks.whole(name, getattr(self, name), low)


def checked(comparison: Comparison, windows: Windows) -> tuple[Comparison, Measured]:
    """Check windows, and give the comparison their length and whether they have a tachometer."""
    X = check_array(windows.X, dtype=[np.float64, np.float32], input_name="X")
    of_windows = comparison.replace(
        duration=X.shape[1] / comparison.sampling_rate, tachometer=windows.angle is not None
    )
    return of_windows, of_windows.measured(X, **windows.data)
