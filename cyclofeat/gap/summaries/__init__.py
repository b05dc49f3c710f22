"""Numbers by which recordings are compared.

A recording is reduced to numbers, the cells, which form families (:func:`summarise`). Measured windows are
checked, cut to output turns and collected by recording (:class:`MeasuredTurns`). Torque is folded over the
turn for pictures (:func:`phase_maps`).
"""

from cyclofeat.gap.summaries._phase import PhaseMap, phase_maps
from cyclofeat.gap.summaries._summarise import (
    FAMILIES,
    HANN_POWER,
    RESOLUTION_NM,
    SPEED_TOLERANCE,
    Cell,
    Conditions,
    block_means,
    box_means,
    hann_lines,
    level,
    signed_log,
    smallest_spreads,
    summarise,
)
from cyclofeat.gap.summaries._windows import (
    MeasuredTurns,
    class_means,
    less_class_means,
    mixed,
    per_recording,
    read_measured,
    uncorrelating,
)

__all__ = [
    "FAMILIES",
    "HANN_POWER",
    "RESOLUTION_NM",
    "SPEED_TOLERANCE",
    "Cell",
    "Conditions",
    "Measured",
    "PhaseMap",
    "block_means",
    "box_means",
    "class_means",
    "hann_lines",
    "less_class_means",
    "level",
    "mixed",
    "per_recording",
    "phase_maps",
    "read_measured",
    "signed_log",
    "smallest_spreads",
    "summarise",
    "uncorrelating",
]
