"""Data of plots that can be zoomed, as ``templates/plot.js`` draws them."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

# Values below this share of the largest are rounding errors, and would stretch a logarithmic axis.
_DYNAMIC_RANGE = 1e-8


@dataclass(frozen=True)
class Axis:
    """Quantity of an axis, in singular and without unit, its unit, and its scale; whole: of whole numbers."""

    quantity: str
    unit: str
    log: bool = False
    whole: bool = False


@dataclass(frozen=True, eq=False)
class Line:
    """Values over the plot's x, NaN where there are none, with an optional band.

    Parameters
    ----------
    name : str
    values : array-like, shape (n,)
    colour : {"accent", "second", "third", "ink", "faint", "wrong"}, default="accent"
        A colour of the page.
    style : {"line", "dashed", "wide", "stems", "strokes", "points"}, default="line"
    band : tuple of array-like, optional
        Lower and upper end, each of shape (n,).
    """

    name: str
    values: ArrayLike
    colour: str = "accent"
    style: Literal["line", "dashed", "wide", "stems", "strokes", "points"] = "line"
    band: tuple[ArrayLike, ArrayLike] | None = None


@dataclass(frozen=True, eq=False)
class Marks:
    """Vertical lines at multiples: ``at[k]`` is "``name`` k + 1". Short ones are strokes at the bottom."""

    name: str
    legend: str
    at: ArrayLike
    colour: str
    short: bool = False


@dataclass(frozen=True)
class Span:
    """Part of x with a short label in the plot, and words for the read-out."""

    start: float
    stop: float
    label: str
    text: str
    amiss: bool = False


@dataclass(frozen=True, eq=False)
class Plot:
    """Lines over one x, with what marks places on it.

    Parameters
    ----------
    x : array-like, shape (n,)
        Increasing.
    lines : sequence of Line
    axes : tuple of Axis
        Of x and of y.
    view : tuple of float, optional
        Part of x that is shown at first; default, all.
    marks : sequence of Marks
    spans : sequence of Span
    note : str
        How the data were reduced.
    """

    x: ArrayLike
    lines: Sequence[Line]
    axes: tuple[Axis, Axis]
    view: tuple[float, float] | None = None
    marks: Sequence[Marks] = ()
    spans: Sequence[Span] = ()
    note: str = ""

    def to_dict(self) -> dict[str, Any]:
        """Return plain values that JSON can hold: long columns as text."""
        x = np.asarray(self.x, dtype=np.float64)
        return {
            "x": _pack_values(x),
            "lines": [self._line_data(line) for line in self.lines],
            "axes": [vars(axis) for axis in self.axes],
            "view": [float(end) for end in self.view or (x[0], x[-1])],
            "marks": [vars(marks) | {"at": np.asarray(marks.at).tolist()} for marks in self.marks],
            "spans": [vars(span) for span in self.spans],
            "note": self.note,
        }

    def _line_data(self, line: Line) -> dict[str, Any]:
        values = np.asarray(line.values, dtype=np.float64)
        least = -np.inf
        if self.axes[1].log:
            least = (np.nanmax(values) or 1.0) * _DYNAMIC_RANGE
        columns = [_pack_values(np.maximum(ends, least)) for ends in (values, *(line.band or ()))]
        return {"name": line.name, "colour": line.colour, "style": line.style, "columns": columns}


def _pack_values(values: NDArray[np.float64]) -> dict[str, Any]:
    """Return equal steps as two numbers, and other values as little-endian float32 in base64."""
    steps = np.diff(values)
    if steps.size and np.allclose(steps, steps[0], rtol=1e-6, atol=0):
        return {"first": float(values[0]), "last": float(values[-1]), "n": values.size}
    return {"base64": base64.b64encode(values.astype("<f4").tobytes()).decode("ascii")}
