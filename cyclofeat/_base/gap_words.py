"""Names and differences of the gap in words, for pictures and pages."""

from __future__ import annotations

import re
from typing import Any

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
    "features": "features used for counting",
    "modulation": "modulation of the mesh lines",
    "mains": "mains lines",
    "slow bands": "slow fluctuation by bands",
    "course": "course over the recording",
    "decays": "exponential decays",
    "slips": "slow climbs and quick falls",
    "codes": "values that repeat, end or stand still",
}
# Names that say too little alone.
_OF_FAMILY = ("modulation", "course", "decays", "slips", "codes", "mains", "slow bands")
AFTER = "after"  # the correction itself among the alternatives
_ALTERNATIVES = {AFTER: "named effects added", "nothing": "nothing changed", "oracle": "the true simulator"}
# Which counts of the recordings held out a row is about (``ProofRow.condition``).
COUNT_GROUPS = {
    "all": "all recordings held out",
    "seen": "counts of worn lobes seen in the fit",
    "unseen": "counts never seen in the fit",
}


def family_name(family: str) -> str:
    """Name of a family of cells in plain words."""
    return _FAMILY_NAMES.get(family, family)


def alternative_name(alternative: str) -> str:
    """Name of an alternative of the proof in plain words."""
    return _ALTERNATIVES.get(alternative, alternative.replace("_", " "))


def cell_name(cell: Any) -> str:
    """Name of a cell without powers of ten: ``third octave at 1000 Hz``."""
    name = re.sub(r"\d(?:\.\d+)?e\+\d+", lambda match: f"{float(match[0]):.0f}", cell.name)
    if cell.family == "floor":
        return f"floor {name}"
    if cell.family in _OF_FAMILY:
        return f"{family_name(cell.family)}: {name}"
    return "mean torque" if (cell.family, name) == ("amplitudes", "mean") else name


def short_name(cell: Any) -> str:
    """Short name of a cell for a picture."""
    name = cell_name(cell).replace("third octave at ", "")
    return re.sub(r"lobe line (\d+) \(order (.+)\)", r"order \2 (lobe line \1)", name)


def difference_words(row: Any) -> str:
    """The difference in words: ``6.0 dB less``."""
    if row.of == "spread":
        return (
            f"varies {_size_text(10 ** (row.difference / 20))} times as much from one recording to the next"
        )
    return mean_difference_words(row.difference, row.cell.unit)


def mean_difference_words(difference: float, unit: str) -> str:
    """A difference of means in words, with its unit."""
    if unit == "1":
        return f"{_size_text(abs(difference))} {'lower' if difference < 0 else 'higher'}"
    return f"{_size_text(abs(difference))} {unit} {'less' if difference < 0 else 'more'}"


def row_words(row: Any) -> str:
    """Cell and difference in words: ``third octave at 400 Hz: 6.0 dB less``."""
    return f"{cell_name(row.cell)}: {difference_words(row)}"


def p_words(p: float) -> str:
    """``p = 0.008``."""
    return f"p = {p:.2g}" if p >= 0.001 else "p < 0.001"


def _size_text(size: float) -> str:
    if size >= 10:
        return f"{size:.0f}"
    return f"{size:.1f}" if size >= 1 else f"{size:.2g}"
