"""Names and differences of the gap in words that people read."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from cyclofeat.gap import Cell, Row

_FAMILY_NAMES = {
    "speed": "input speed",
    "slow part": "slow fluctuation (below 4 Hz)",
    "amplitudes": "mean, size and shape of the ripple",
    "spectrum": "spectrum in third octaves",
    "orders": "lines of lobes and input shaft",
    "overall": "all together",
    "lobe lines": "lines of the lobes",
    "shaft lines": "lines of the input shaft",
    "floor": "floor between the lines",
    "averages": "averages over turns and lobes",
    "features": "features that are counted by",
}
OURS = "after"  # the correction itself among the alternatives
_ALTERNATIVES = {
    OURS: "the named effect, added",
    "nothing": "nothing changed",
    "retuned": "contacts retuned only",
    "equaliser": "equaliser and shaped noise (black box)",
    "gaussian_process": "Gaussian process (black box)",
    "placebo": "best wrong effect",
    "oracle": "the true simulator",
}
CONDITIONS = {
    "all": "all recordings held out",
    "seen": "counts of worn lobes seen in the fit",
    "unseen": "counts never seen in the fit",
}


def family_name(family: str) -> str:
    """What a family of cells is called to people."""
    return _FAMILY_NAMES.get(family, family)


def alternative_name(alternative: str) -> str:
    """What an alternative of a report is called to people."""
    return _ALTERNATIVES.get(alternative, alternative.replace("_", " "))


def cell_name(cell: Cell) -> str:
    """The cell's name as it stands alone, without powers of ten: ``third octave at 1000 Hz``."""
    name = re.sub(r"\d(?:\.\d+)?e\+\d+", lambda found: f"{float(found[0]):.0f}", cell.name)
    if cell.family == "floor":
        return f"floor {name}"
    return "mean torque" if (cell.family, name) == ("amplitudes", "mean") else name


def short_name(cell: Cell) -> str:
    """The cell's name as room in a picture allows."""
    name = cell_name(cell).replace("third octave at ", "")
    return re.sub(r"lobe line (\d+) \(order (.+)\)", r"order \2 (lobe line \1)", name)


def difference_words(row: Row) -> str:
    """The difference in words: ``6.0 dB less``."""
    size = abs(row.effect)
    if row.of == "spread":
        return f"varies {_rounded(10 ** (row.effect / 20))} times as much from one recording to the next"
    if row.cell.unit == "1":
        return f"{_rounded(size)} {'lower' if row.effect < 0 else 'higher'}"
    return f"{_rounded(size)} {row.cell.unit} {'less' if row.effect < 0 else 'more'}"


def in_words(row: Row) -> str:
    """Cell and difference in words: ``third octave at 400 Hz: 6.0 dB less``."""
    return f"{cell_name(row.cell)}: {difference_words(row)}"


def clarity(row: Row) -> float:
    """Size of the difference over the least that would most likely have been found."""
    return abs(row.effect) / row.detectable if row.detectable > 0 else 0.0


def p_words(p: float) -> str:
    """``p = 0.008``."""
    return f"p = {p:.2g}" if p >= 0.001 else "p < 0.001"


def _rounded(size: float) -> str:
    if size >= 10:
        return f"{size:.0f}"
    return f"{size:.1f}" if size >= 1 else f"{size:.2g}"
