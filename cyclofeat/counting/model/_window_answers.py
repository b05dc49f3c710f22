"""Windows of recordings before and after they are counted."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cyclofeat.counting.model._verdicts import most_frequent
from cyclofeat.counting.model.lobe_count import WindowCount
from cyclofeat.recordings import WindowSet
from cyclofeat.signal.windows import Float

OUTSIDE = "outside the training data"


@dataclass(frozen=True)
class PreparedWindows:
    """Windows of a recording, or of a part of it, and what is known of them before they are counted.

    Attributes
    ----------
    windows : WindowSet
    stop_s : ndarray, shape (n_windows,)
        Ends of the windows in s.
    faults : tuple of str
        What would spoil the count of each window, see :func:`window_faults`.
    doubt : str
        Why the speed is doubted, else empty.
    notes : tuple of str
        What the reader should know.
    first_angle : float
        Input angle at the recording's first window in rad; NaN where it is not known.
    """

    windows: WindowSet
    stop_s: Float
    faults: tuple[str, ...]
    doubt: str
    notes: tuple[str, ...]
    first_angle: float


@dataclass(frozen=True)
class AnsweredWindows:
    """Answers for windows of one recording, in order of time.

    Attributes
    ----------
    start_s, stop_s : ndarray, shape (n_windows,)
    proba : ndarray, shape (n_windows, n_classes)
    distance : ndarray, shape (n_windows,)
        From the training windows, in units of the largest inside; NaN without a domain.
    faults : tuple of str
    lobe_proba : ndarray, shape (n_places, n_windows, n_lobes), or None
        Probability of each lobe of being worn, for each place at which the recording may begin between two
        lobes; None where positions are not known.
    wear : ndarray, shape (n_runs, n_classes + n_features), or None
        What the runs of windows without a fault tell (:meth:`RadialWear.answers`); None where the model
        learned no depth of wear, or there is no run.
    """

    start_s: Float
    stop_s: Float
    proba: Float
    distance: Float
    faults: tuple[str, ...]
    lobe_proba: Float | None
    wear: Float | None = None

    def __len__(self) -> int:
        """Number of windows."""
        return len(self.proba)

    @classmethod
    def join_parts(cls, parts: Sequence[AnsweredWindows]) -> AnsweredWindows:
        """Return the answers of parts of one recording, one after the other."""
        if len(parts) == 1:
            return parts[0]
        located = [part.lobe_proba for part in parts if part.lobe_proba is not None]
        runs = [part.wear for part in parts if part.wear is not None]

        def column(name: str) -> Any:
            return np.concatenate([getattr(part, name) for part in parts])

        return cls(
            column("start_s"), column("stop_s"), column("proba"), column("distance"),
            faults=tuple(fault for part in parts for fault in part.faults),
            lobe_proba=np.concatenate(located, axis=1) if len(located) == len(parts) else None,
            wear=np.concatenate(runs) if runs else None,
        )  # fmt: skip

    def find_refusals(self, doubt: str) -> tuple[str, list[str]]:
        """Return why the recording is refused, and why each window is; empty where it is not."""
        # A faulty signal explains that the speed is not found, a wrong speed that windows lie outside.
        if doubt and sum(map(bool, self.faults)) <= len(self) / 2:
            return doubt, [doubt] * len(self)
        reasons = self.window_reasons()
        return most_frequent(reasons) if sum(map(bool, reasons)) > len(self) / 2 else "", reasons

    def window_reasons(self) -> list[str]:
        """Return why each window is left out; empty where it is not."""
        outside = np.where(self.distance > 1, OUTSIDE, "").tolist()
        return [fault or reason for fault, reason in zip(self.faults, outside, strict=True)]

    def window_counts(self, classes: NDArray[np.int64], reasons: Sequence[str]) -> tuple[WindowCount, ...]:
        """Return the answer of each window."""
        columns = (
            self.start_s.tolist(),
            self.stop_s.tolist(),
            classes[self.proba.argmax(axis=1)].tolist(),
            self.proba.max(axis=1).tolist(),
            self.distance.tolist(),
            reasons,
        )
        return tuple(WindowCount(*answer) for answer in zip(*columns, strict=True))

    def mean_lobe_proba(self, used: NDArray[np.bool_]) -> Float:
        """Return the probability of each lobe of being worn, by some windows; empty if it is not known.

        Of the places at which the recording may begin between two lobes, that with the most decided answer
        counts.
        """
        if self.lobe_proba is None:
            return np.zeros(0)
        places = self.lobe_proba[:, used].mean(axis=1)
        return np.asarray(places[np.abs(places - 0.5).sum(axis=1).argmax()])

    def shift_time(self, seconds: float) -> AnsweredWindows:
        """Return the same answers at a later time."""
        return dataclasses.replace(self, start_s=self.start_s + seconds, stop_s=self.stop_s + seconds)
