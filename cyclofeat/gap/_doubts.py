"""Properties of recordings that limit what can be concluded from them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cyclofeat.signal.faults import runs

_FEW_RECORDINGS = 4
_CLIPPED = 1e-3  # share of samples at one extreme value from which a recording counts as clipped
_FLAT = 5  # samples on end


def doubts_of(torques: Sequence[NDArray[Any]], *, has_counts: bool, has_tachometer: bool) -> list[str]:
    """Return a sentence on each property of a rig's recordings that limits the conclusions."""
    n = len(torques)
    doubts = []
    if n < _FEW_RECORDINGS:
        doubts.append(
            f"{n} recordings: how much they vary from one to the next is hardly known, and only large "
            "differences are found"
        )
    if not has_counts:
        doubts.append("the counts of worn lobes are not known: differences between classes hide smaller ones")
    if not has_tachometer:
        doubts.append(
            "no tachometer: an error of the speed and one of the converter's clock cannot be told apart"
        )
    for extreme, word in ((np.max, "largest"), (np.min, "smallest")):
        at_end = [torque == extreme(torque) for torque in torques]
        clipped = sum(np.mean(flags) > _CLIPPED and runs(flags)[1].max() >= _FLAT for flags in at_end)
        if clipped:
            doubts.append(
                f"{clipped} of {n} recordings seem clipped: they stay at their {word} value for samples on "
                "end"
            )
    return doubts
