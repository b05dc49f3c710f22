"""What results show in a notebook: a card with small pictures, and data frames.

The card takes its colours from the notebook, light or dark. Text is escaped here and nowhere else: names and
notes come from files of others.
"""

from __future__ import annotations

import html
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import pandas as pd


_ROW = "text-align:left;vertical-align:top;padding:.1em .9em .1em 0;background:none;border:0"
_TABLE = "border:0;margin:0;width:auto"
_TITLE = "font-weight:600;font-size:1.1em;margin-bottom:.3em"
_NAME = "font-weight:normal;opacity:.75"
_NOTE = "border-left:3px solid #c98a00;padding-left:.6em;margin:.4em 0"


@dataclass(frozen=True)
class Card:
    """What an object prints, and shows in a notebook: a title, rows of numbers with units, and warnings.

    Rows whose value is None or empty text are left out. ``draw`` returns pictures of this module, which alone
    are not escaped. ``code`` is one line that shows what to do next.

    Examples
    --------
    >>> card = Card("Recording", {"run": "<b>", "load": None})
    >>> print(card)
    Recording
      run: <b>
    >>> "&lt;b&gt;" in card.to_html()
    True
    """

    title: str
    rows: Mapping[str, object]
    draw: Callable[[], Sequence[str]] = tuple
    notes: Sequence[str] = ()
    code: str = ""

    def texts(self) -> dict[str, str]:
        """Return the rows that say something."""
        return {name: str(value) for name, value in self.rows.items() if value is not None and value != ""}

    def __str__(self) -> str:
        rows = [f"{name}: {text}" for name, text in self.texts().items()]
        return "\n  ".join([self.title, *rows, *(f"note: {note}" for note in dict.fromkeys(self.notes))])

    def to_html(self) -> str:
        """Return the card for a notebook."""
        cells = "".join(
            f'<tr style="background:none"><th style="{_ROW};{_NAME}">{html.escape(name)}</th>'
            f'<td style="{_ROW}">{html.escape(text)}</td></tr>'
            for name, text in self.texts().items()
        )
        parts = [
            f'<div style="{_TITLE}">{html.escape(self.title)}</div>',
            '<div style="display:flex;flex-wrap:wrap;gap:1em 1.5em;align-items:flex-start">',
            *self.draw(),
            f'<div style="flex:1 1 20em;min-width:0"><table style="{_TABLE}">{cells}</table></div>',
            "</div>",
            *(f'<div style="{_NOTE}">{html.escape(note)}</div>' for note in dict.fromkeys(self.notes)),
        ]
        if self.code:
            # Pages, whose readers run nothing, hide it.
            parts.append(
                f'<div class="next" style="margin-top:.4em">Next: <code>{html.escape(self.code)}</code></div>'
            )
        return f'<div style="line-height:1.45">{"".join(parts)}</div>'


class WithCard:
    """Base of objects that print, and show in a notebook, their :class:`Card`."""

    def _card(self) -> Card:
        raise NotImplementedError

    def __str__(self) -> str:
        return str(self._card())

    def _repr_html_(self) -> str:
        return self._card().to_html()


Float = NDArray[np.float64]

ACCENT, SECOND = "#2f7fc4", "#2a9134"
_INK = "currentColor"
_POINTS = 500
_WIDTH, _HEIGHT = 260, 96


class Curve(NamedTuple):
    """Values at equal steps, and how they are drawn."""

    values: Float
    colour: str = ACCENT
    width: float = 1.0
    dashes: str = ""


def thin_samples(time: Float, values: Float, max_points: int) -> tuple[Float, Float]:
    """Return first and last sample, and the extremes of equal parts: ``max_points`` at most, or all."""
    if max_points < 4:
        raise ValueError(f"max_points must be at least 4, got {max_points!r}")
    if values.size <= max_points:
        return time, values
    length = -(-values.size // (max_points // 2 - 1))
    parts = np.pad(values, (0, -values.size % length), mode="edge").reshape(-1, length)
    starts = length * np.arange(len(parts))
    extremes = [[0], starts + parts.argmin(axis=1), starts + parts.argmax(axis=1), [values.size - 1]]
    kept = np.unique(np.minimum(np.concatenate(extremes), values.size - 1))
    return time[kept], values[kept]


def draw_curves(drawn: Sequence[Curve], label: str) -> str:
    """Return curves on one scale that fills the picture."""
    low = min(float(curve.values.min()) for curve in drawn)
    high = max(float(curve.values.max()) for curve in drawn)
    scale = (_HEIGHT - 4) / (high - low if high > low else 1.0)
    parts = []
    for curve in drawn:
        x, y = thin_samples(np.linspace(1, _WIDTH - 1, curve.values.size), curve.values - low, _POINTS)
        points = _points_text(x, _HEIGHT - 2 - scale * y)
        parts.append(
            f'<polyline points="{points}" fill="none" stroke="{curve.colour}" stroke-width="{curve.width:g}" '
            f'stroke-dasharray="{curve.dashes}"/>'
        )
    return _svg_figure(parts, _WIDTH, _HEIGHT, label)


def draw_columns(
    values: Iterable[float], names: Sequence[object], label: str, *, marked: Collection[object] = ()
) -> str:
    """Return columns of shares from 0 to 1, with their names below; those marked have the accent."""
    step, top = min(_WIDTH / max(len(names), 1), 30.0), _HEIGHT - 16
    width = step * len(names)
    parts = [f'<line x1="0" x2="{width:g}" y1="{top}" y2="{top}" stroke="{_INK}" stroke-opacity=".5"/>']
    for k, (name, value) in enumerate(zip(names, values, strict=True)):
        height = max(top * value, 0.8)
        look = f'fill="{ACCENT}"' if name in marked else f'fill="{_INK}" fill-opacity=".35"'
        parts.append(
            f'<rect x="{k * step + 2:.1f}" y="{top - height:.1f}" width="{step - 4:.1f}" '
            f'height="{height:.1f}" {look}><title>{html.escape(str(name))}: {value:.3g}</title></rect>'
        )
        if step >= 7 * len(str(name)):
            parts.append(_text_element((k + 0.5) * step, _HEIGHT - 3, str(name)))
    return _svg_figure(parts, width, _HEIGHT, label)


def draw_confusion(table: NDArray[Any], names: Sequence[object]) -> str:
    """Return a confusion matrix, true classes in rows, as shares of its rows."""
    shares = table / np.maximum(table.sum(axis=1, keepdims=True), 1)
    label = "Share of each true count (row) that was predicted as each count (column)"
    side, edge = min(150 / len(names), 18.0), 16
    parts = []
    for row, column in np.ndindex(shares.shape):
        colour = ACCENT if row == column else _INK
        parts.append(
            f'<rect x="{edge + column * side:.1f}" y="{row * side:.1f}" width="{side - 1:.1f}" '
            f'height="{side - 1:.1f}" fill="{colour}" fill-opacity="{0.06 + 0.9 * shares[row, column]:.2f}">'
            f"<title>{shares[row, column]:.3g}</title></rect>"
        )
    for k, name in enumerate(map(str, names)):
        parts.append(_text_element(edge / 2, (k + 0.5) * side + 4, name))
        parts.append(_text_element(edge + (k + 0.5) * side, len(names) * side + 12, name))
    size = edge + len(names) * side
    return _svg_figure(parts, size, size, label)


def draw_disc(shares: Sequence[float], counted: Collection[int], label: str) -> str:
    """Return a ring of lobes, numbered from 1 and counter-clockwise, as dark as their shares from 0 to 1."""
    n, inner, outer = len(shares), 34.0, 58.0
    ends = np.exp(-2j * np.pi * (np.arange(n + 1) - 0.5) / n)
    parts: list[str] = []
    for lobe, (begin, end) in enumerate(pairwise(ends.tolist())):
        corners = np.array([inner * begin, outer * begin, outer * end, inner * end]) + 60 * (1 + 1j)
        worn = lobe in counted
        look = f'stroke="{ACCENT}" stroke-width="2"' if worn else f'stroke="{_INK}" stroke-opacity=".3"'
        parts.insert(
            len(parts) if worn else 0,
            f'<polygon points="{_points_text(corners.real, corners.imag)}" fill="{ACCENT}" '
            f'fill-opacity="{shares[lobe]:.2f}" {look}><title>lobe {lobe + 1}: {shares[lobe]:.3g}</title>'
            "</polygon>",
        )
        middle = 60 * (1 + 1j) + 27.5 * np.exp(-2j * np.pi * lobe / n)
        parts.append(_text_element(middle.real, middle.imag + 3, str(lobe + 1), bold=worn))
    return _svg_figure(parts, 120, 120, label)


def _points_text(x: NDArray[Any], y: NDArray[Any]) -> str:
    return " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x.tolist(), y.tolist(), strict=True))


def _text_element(x: float, y: float, text: str, *, bold: bool = False) -> str:
    weight = ' font-weight="bold"' if bold else ""
    return (
        f'<text x="{x:.1f}" y="{y:.1f}" font-size="8.5"{weight} text-anchor="middle" fill="{_INK}">'
        f"{html.escape(text)}</text>"
    )


def _svg_figure(parts: Iterable[str], width: float, height: float, label: str) -> str:
    """Return a picture with its label below it."""
    return (
        f'<figure style="margin:0;width:{max(width, 150):g}px;max-width:100%"><svg aria-hidden="true" '
        f'width="{width:g}" height="{height:g}" viewBox="0 0 {width:g} {height:g}" style="max-width:100%">'
        f'{"".join(parts)}</svg><figcaption style="font-size:.8em;line-height:1.25;opacity:.75">'
        f"{html.escape(label)}</figcaption></figure>"
    )


def data_frame(rows: Any) -> pd.DataFrame:
    """Return dicts by row, arrays by column or a structured array as a data frame."""
    try:
        import pandas as pd
    except ImportError as error:
        raise ImportError("data frames need pandas: pip install pandas") from error
    return pd.DataFrame(rows)
