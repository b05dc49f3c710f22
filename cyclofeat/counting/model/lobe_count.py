"""Answers of a model: the count of a recording and of each of its windows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from cyclofeat._base import displays, draw_plot
from cyclofeat._base.displays import Card, WithCard, data_frame
from cyclofeat._base.quantities import from_1, lobes_text, number_of, probability_text
from cyclofeat.counting.model._verdicts import most_frequent
from cyclofeat.counting.model.radial_wear import WearDepth
from cyclofeat.recordings import WindowSet
from cyclofeat.signal.windows import Float

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes

OUTSIDE = "outside the training data"
DENIED = "lobe lines stand out as those of a worn disc do, but no worn lobe is counted"
# Distance from which a window is left out although most of its recording is inside.
_FAR_OUTSIDE = 1.25


@dataclass(frozen=True)
class WindowCount:
    """Answer of a model for one window of a recording."""

    start_s: float  # the window in s from the recording's first sample
    stop_s: float
    defect_count: int  # most probable number of worn lobes in this window alone
    probability: float  # of that count
    distance: float  # from the training windows, in units of the largest inside; NaN without a domain
    reason: str  # why the window is refused, else empty

    def to_dict(self) -> dict[str, Any]:
        """Return the answer in plain types, for JSON; ``distance`` is None where there is none."""
        return asdict(self) | {"distance": None if np.isnan(self.distance) else self.distance}


@dataclass(frozen=True)
class LobeCount(WithCard):
    """Answer of a model for one recording.

    Attributes
    ----------
    defect_count : int
        Most probable number of worn lobes.
    probability : dict
        Probability of each count.
    lobes : tuple of int
        The ``defect_count`` lobes most probably worn, counted from 0; empty where the model has no locator,
        and of blocks of a stream.
    lobe_probability : tuple of float
        Probability of each lobe of being worn; empty where ``lobes`` are not known.
    absolute : bool
        Whether lobes are numbered as on the disc. Otherwise lobe 0 is the one under load at the recording's
        first sample.
    n_windows : int
        Windows that were combined.
    warnings : tuple of str
        What the reader should know.
    refused : bool
        Whether the count is not reliable, see :meth:`LobeModel.count`.
    reason : str
        Why refused, else empty.
    distance : float
        Median over windows of the distance from the training windows, in units of the largest distance
        inside; NaN where the model has no domain.
    windows : tuple of WindowCount
        The answer of each window.
    wear_um : WearDepth or None
        Depth of the wear, where the model learned it (``wear_um`` of :class:`LobeModel`), the recording holds
        as many output turns as that takes, and it is not refused.
    """

    defect_count: int
    probability: dict[int, float]
    lobes: tuple[int, ...]
    lobe_probability: tuple[float, ...] = field(repr=False)
    absolute: bool
    n_windows: int
    warnings: tuple[str, ...] = ()
    refused: bool = False
    reason: str = ""
    distance: float = float("nan")
    windows: tuple[WindowCount, ...] = ()
    wear_um: WearDepth | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return the answer of the whole recording in plain types, for JSON; lobes count from 1.

        Returns
        -------
        dict
            A refused recording has no ``defect_count``; ``refused_defect_count`` is what it would be. The
            depth of the wear is there where the model states it (:meth:`WearDepth.to_dict`).
        """
        depth = {} if self.wear_um is None else self.wear_um.to_dict()
        return {
            "defect_count": None if self.refused else self.defect_count,
            "refused_defect_count": self.defect_count if self.refused else None,
            "probability": {str(count): value for count, value in self.probability.items()},
            "worn_lobes_from_1": from_1(self.lobes),
            "lobe_probability": list(self.lobe_probability),
            "lobes_absolute": self.absolute,
            "n_windows": self.n_windows,
            "refused": self.refused,
            "reason": self.reason,
            # JSON has no NaN
            "distance": None if np.isnan(self.distance) else self.distance,
            **depth,
            "warnings": list(self.warnings),
        }

    def plot(
        self, kind: Literal["counts", "lobes"] = "counts", ax: Axes | None = None, **options: Any
    ) -> Any:
        """Draw the probabilities.

        Parameters
        ----------
        kind : {"counts", "lobes"}, default="counts"
            Probability of each number of worn lobes, or of each lobe of being worn.
        ax : matplotlib.axes.Axes, optional
            Axes to draw on; default, new ones.
        **options
            Passed on to ``Axes.bar``.

        Returns
        -------
        cyclofeat.plotting.CountDisplay
        """
        return draw_plot(self, kind, ax, **options)

    def _card(self) -> Card:
        answer = number_of(self.defect_count, "worn lobe") if self.defect_count else "No worn lobe"
        numbered = "as on the disc, from 1" if self.absolute else "from 1, the lobe under load at the start"
        distance = None if np.isnan(self.distance) else f"{self.distance:.2f} (1: edge of the training)"
        rows = {
            "probability": probability_text(self.probability[self.defect_count]),
            "lobes": f"{lobes_text(self.lobes, len(self.lobe_probability))} (numbered {numbered})"
            if self.lobes
            else None,
            "depth of wear": None if self.wear_um is None else str(self.wear_um),
            "combined": number_of(self.n_windows, "window"),
            "distance": distance,
            "refused": self.reason,
        }
        title = f"Refused, not reliable: {answer}" if self.refused else answer
        code = 'count.plot("lobes")' if self.lobes else "count.plot()"
        return Card(title, rows, self._draw_probabilities, self.warnings, code)

    def _draw_probabilities(self) -> list[str]:
        drawn = [
            displays.draw_columns(
                self.probability.values(), [*self.probability], "Probability of each number of worn lobes",
                marked={self.defect_count},
            )
        ]  # fmt: skip
        if self.lobe_probability:
            text = "Probability of each lobe of being worn"
            drawn.append(displays.draw_disc(self.lobe_probability, self.lobes, text))
        return drawn


def counts_frame(counts: Mapping[str, LobeCount] | Sequence[LobeCount]) -> pd.DataFrame:
    """Return the answers for many recordings as a data frame.

    Parameters
    ----------
    counts : mapping from str to LobeCount, or sequence of LobeCount
        Answers, by the names of their recordings.

    Returns
    -------
    pandas.DataFrame
        One row per recording, its name as the index: ``defect_count`` and ``refused_defect_count`` (one of
        them missing, see :meth:`LobeCount.to_dict`), ``probability`` (of that count),
        ``lobes`` (counted from 0), ``lobes_absolute``, ``n_windows``, ``refused``, ``reason``, ``distance``,
        ``warnings``, ``probability_<count>`` of each count, and the depth of the wear
        (:meth:`WearDepth.to_dict`) where a model states it.

    Examples
    --------
    >>> answer = LobeCount(1, {0: 0.1, 1: 0.9}, (3,), (), False, 2)
    >>> counts_frame({"a.csv": answer})[["defect_count", "probability", "lobes"]]
               defect_count  probability lobes
    recording
    a.csv                 1          0.9  (3,)
    """
    given = counts if isinstance(counts, Mapping) else dict(enumerate(counts))
    rows = []
    for recording, one in given.items():
        row = {"recording": recording} | one.to_dict() | {"lobes": one.lobes}
        del row["lobe_probability"]
        row["probability"] = one.probability[one.defect_count]
        rows.append(row | {f"probability_{count}": p for count, p in one.probability.items()})
    frame: pd.DataFrame = data_frame(rows or {"recording": []}).set_index("recording")
    return frame.astype(dict.fromkeys(frame.columns[:2], "Int64"))  # counts may be missing


@dataclass(frozen=True)
class PreparedWindows:
    """Windows of a recording, or of a part of it, and what is known of them before they are counted."""

    windows: WindowSet
    stop_s: Float  # ends of the windows in s
    faults: tuple[str, ...]  # what would spoil the count of each window
    doubt: str  # why the speed is doubted, else empty
    notes: tuple[str, ...]  # what the reader should know
    first_angle: float  # of the input at the recording's first window in rad
    is_sure: bool  # whether a sound disc's lines cannot be those of a worn one at another speed

    @property
    def absolute(self) -> bool:
        """Whether lobes of the recording are numbered as on the disc."""
        return bool(self.windows.absolute.all())


@dataclass(frozen=True)
class AnsweredWindows:
    """Answers for windows of one recording, in order of time."""

    start_s: Float
    stop_s: Float
    proba: Float  # (n_windows, n_classes)
    distance: Float  # from the training windows, in units of the largest inside; NaN without a domain
    faults: tuple[str, ...]
    unlike: tuple[
        str, ...
    ]  # in which features each window lies outside the training, where it does; or DENIED
    # Probability of each lobe of being worn, (n_places, n_windows, n_lobes), for each place at which the
    # recording may begin between two lobes; None where positions are not known.
    lobe_proba: Float | None
    # What the runs of windows without a fault tell (RadialWear.answers), (n_runs, n_classes + n_features);
    # None where the model learned no depth of wear, or there is no run.
    runs: Float | None = None

    @classmethod
    def join_parts(cls, parts: Sequence[AnsweredWindows]) -> AnsweredWindows:
        """Return the answers of parts of one recording, one after the other."""
        located = [part.lobe_proba for part in parts if part.lobe_proba is not None]
        runs = [part.runs for part in parts if part.runs is not None]
        names = "start_s", "stop_s", "proba", "distance"
        return cls(
            **{name: np.concatenate([getattr(part, name) for part in parts]) for name in names},
            faults=tuple(fault for part in parts for fault in part.faults),
            unlike=tuple(one for part in parts for one in part.unlike),
            lobe_proba=np.concatenate(located, axis=1) if len(located) == len(parts) else None,
            runs=np.concatenate(runs) if runs else None,
        )

    def find_refusals(self, doubt: str) -> tuple[str, list[str]]:
        """Return why the recording is refused, and why each window is; empty where it is not."""
        # A faulty signal explains that the speed is not found, a wrong speed that windows lie outside.
        if doubt and sum(map(bool, self.faults)) <= len(self.proba) / 2:
            return doubt, [doubt] * len(self.proba)
        reasons = self.window_reasons()
        return most_frequent(reasons) if sum(map(bool, reasons)) > len(self.proba) / 2 else "", reasons

    def window_reasons(self) -> list[str]:
        """Return why each window is left out; empty where it is not.

        Of a recording that lies within the training by its median, only windows far outside are.
        """
        limit = 1.0 if np.median(self.distance) > 1 else _FAR_OUTSIDE
        unlike = np.where((self.distance > limit) | np.isin(self.unlike, DENIED), self.unlike, "").tolist()
        return [fault or reason for fault, reason in zip(self.faults, unlike, strict=True)]

    def window_counts(self, classes: NDArray[np.int64], reasons: Sequence[str]) -> tuple[WindowCount, ...]:
        """Return the answer of each window."""
        counts = classes[self.proba.argmax(axis=1)]
        columns = self.start_s, self.stop_s, counts, self.proba.max(axis=1), self.distance
        return tuple(map(WindowCount, *(column.tolist() for column in columns), reasons))

    def mean_lobe_proba(self, used: NDArray[np.bool_]) -> Float:
        """Return the probability of each lobe of being worn, by some windows; empty if it is not known.

        Among the places between two lobes at which the recording may begin, the one with the most decided
        answer counts.
        """
        if self.lobe_proba is None:
            return np.zeros(0)
        places = self.lobe_proba[:, used].mean(axis=1)
        return np.asarray(places[np.abs(places - 0.5).sum(axis=1).argmax()])
