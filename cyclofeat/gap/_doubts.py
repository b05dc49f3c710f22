"""Properties of recordings that limit what can be concluded from them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cyclofeat.gap.summaries import recordings_of

_FEW_RECORDINGS = 4
_CLIPPED = 1e-3  # share of samples at one extreme value from which a recording counts as clipped
_FLAT = 5  # samples on end


def doubts_about(
    windows: NDArray[Any], y: ArrayLike | None, groups: ArrayLike | None, angle: ArrayLike | None
) -> list[str]:
    """Return a sentence on each property of the recordings that limits the conclusions."""
    of_window, counts = recordings_of(len(windows), y, groups)
    n = int(of_window.max()) + 1
    doubts = []
    if n < _FEW_RECORDINGS:
        doubts.append(
            f"{n} recordings: how much they vary from one to the next is hardly known, and only large "
            "differences are found"
        )
    if counts is None:
        doubts.append("the counts of worn lobes are not known: differences between classes hide smaller ones")
    if counts is not None and n > 1 and len(set(counts.tolist())) == n:
        doubts.append(
            "one recording per class: exact tests between recordings of one class cannot reject at all; "
            "what is compared is each recording with simulated ones of its class"
        )
    if angle is None:
        doubts.append(
            "no tachometer: an error of the speed and one of the converter's clock cannot be told apart"
        )
    for extreme, word in ((windows.max(axis=1), "largest"), (windows.min(axis=1), "smallest")):
        share = np.mean(windows == extreme[:, None], axis=1)
        flat = np.array([_longest_run(x == e) for x, e in zip(windows, extreme, strict=True)])
        clipped = np.unique(of_window[(share > _CLIPPED) & (flat >= _FLAT)])
        if clipped.size:
            doubts.append(
                f"{clipped.size} of {n} recordings seem clipped: they stay at their {word} value for samples "
                "on end"
            )
    return doubts


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
        clipped = sum(np.mean(flags) > _CLIPPED and _longest_run(flags) >= _FLAT for flags in at_end)
        if clipped:
            doubts.append(
                f"{clipped} of {n} recordings seem clipped: they stay at their {word} value for samples on "
                "end"
            )
    return doubts


def _longest_run(inside: NDArray[np.bool_]) -> int:
    """Length of the longest run of true values."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], inside.astype(np.int8), [0]])))
    return int(np.max(edges[1::2] - edges[::2], initial=0))
