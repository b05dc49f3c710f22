"""Kinds of features in plain words, for pictures and pages."""

from __future__ import annotations

from dataclasses import dataclass, replace

from cyclofeat.features.registry import REGISTRY


@dataclass(frozen=True)
class Words:
    """Words for a kind of features."""

    title: str
    axis: str  # label of the vertical axis, with unit
    places: str = "number within its kind, from 1"  # label of the horizontal axis: what orders the features
    text: str = ""  # meaning, and the influence of wear
    formula: str = ""  # and where it is from


_LINES = "multiple of the rate at which lobes pass"
_OF_LOBE_MAP = {
    "lobe_slot_rms": Words(
        "Roughness of the torque, lobe by lobe",
        "roughness while it passes\n(1 = std of the torque)",
        "slot, from 1",
        "How unsteady the torque is while each lobe passes the load. Worn lobes raise it, often most at the "
        "ends of their row.",
    ),
    "lobe_slot_mean": Words(
        "Mean of the torque, lobe by lobe",
        "mean while it passes\n(1 = std of the torque)",
        "slot, from 1",
        "How far the torque lies above or below its mean while each lobe passes the load. Worn lobes lift "
        "and lower it.",
    ),
    "lobe_line_prominence": Words(
        "Strength of the lobe lines",
        "level over the spectrum\naround it (dB)",
        _LINES,
        "How far each multiple of the rate at which lobes pass stands out of the spectrum around it. Wear "
        "lifts them.",
    ),
    "lobe_line_contrast": Words(
        "Pattern of the lobe lines",
        "level over its\nneighbours (dB)",
        _LINES,
        "How each multiple of the rate at which lobes pass compares with the multiples around it. The gaps "
        "tell how many neighbouring lobes are worn.",
    ),
}


def words_of(kind: str) -> Words:
    """Return a kind of columns in words, by default the registry's name and unit.

    Examples
    --------
    >>> words_of("amplitude_nm").axis
    'amplitude (Nm)'
    """
    row = next((row for row in REGISTRY.values() if row.column().split("(")[0] == kind), None)
    if row is None:
        return Words(kind, kind)
    name = row.name.replace("_", " ")
    words = _OF_LOBE_MAP.get(row.name, Words(name.capitalize(), f"{name} ({row.unit})"))
    return replace(words, formula=f"{row.formula} ({row.source})")
