"""Kinds of features in plain words, for pictures and pages."""

from __future__ import annotations

from dataclasses import dataclass

from cyclofeat.features._registry import REGISTRY, Feature


@dataclass(frozen=True)
class Words:
    """A kind of features as a reader should meet it.

    Parameters
    ----------
    title : str
    axis : str
        What is drawn upwards, with its unit.
    places : str
        What the features of the kind follow one another by.
    text : str, default=""
        What it is, and what wear does to it.
    """

    title: str
    axis: str
    places: str = "number within its kind, from 1"
    text: str = ""


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


def feature_of(kind: str) -> Feature | None:
    """The registry's row of a kind of columns; None for features that are not ours.

    Examples
    --------
    >>> feature_of("lobe_slot_rms").unit, feature_of("mine")
    ('1', None)
    """
    return next((row for row in REGISTRY.values() if row.column().split("(")[0] == kind), None)


def words_of(kind: str) -> Words:
    """A kind of columns in words: its own where it has some, else the name and unit of the registry.

    Examples
    --------
    >>> words_of("lobe_line_contrast_db").title
    'Pattern of the lobe lines'
    >>> words_of("amplitude_nm").axis
    'amplitude (Nm)'
    """
    row = feature_of(kind)
    if row is None:
        return Words(kind, kind)
    name = row.name.replace("_", " ")
    return _OF_LOBE_MAP.get(row.name, Words(name.capitalize(), f"{name} ({row.unit})"))
