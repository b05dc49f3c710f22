"""Split of recordings into those to fit and those on which a corrected model is judged."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from cyclofeat._base.arguments import ArgumentError
from cyclofeat._base.checks import is_number
from cyclofeat.gap._measured import SAME_LOAD, SAME_SPEED, set_points
from cyclofeat.recordings import Recording

_FEWEST = 3  # set-points, so that fitted ones lie on both sides of the one held out
_SET_POINTS = {"speed": ("speed_rpm", "RPM", SAME_SPEED), "load": ("load_nm", "Nm", SAME_LOAD)}

Parts = tuple[list[Recording], list[Recording]]


def hold_out(recordings: Sequence[Recording], by: float | str, *, random_state: int = 0) -> Parts:
    """Split recordings into those to fit and those to judge on.

    Parameters
    ----------
    recordings : sequence of Recording
    by : float, "speed" or "load"
        A share between 0 and 1: assemblies are held out as a whole, of every count and condition about this
        share. ``"speed"`` or ``"load"``: all recordings at the middle one of at least three speeds or loads,
        so that what is fitted surrounds it.
    random_state : int, default=0
        Of a share.

    Returns
    -------
    fitted, held_out : list of Recording

    Raises
    ------
    ValueError
        If ``by`` is something else, recordings state no speed or load, or there are too few of them.

    Examples
    --------
    >>> recordings = [Recording([22.0, 22.1], 25_600, speed_rpm=speed) for speed in (400, 500, 500, 600)]
    >>> fitted, held_out = hold_out(recordings, "speed")
    >>> [recording.speed_rpm for recording in held_out]
    [500.0, 500.0]
    """
    if by in _SET_POINTS:
        held = _at_the_middle(recordings, str(by))
    elif is_number(by) and 0 < float(by) < 1:
        held = _share(recordings, float(by), random_state)
    else:
        raise ArgumentError(
            "{argument} must be a share between 0 and 1, speed or load, got {got}", argument="by", got=by
        )
    parts = [[one for i, one in enumerate(recordings) if (i in held) == inside] for inside in (False, True)]
    return parts[0], parts[1]


def _at_the_middle(recordings: Sequence[Recording], by: str) -> set[int]:
    """Return the recordings at the middle speed or load."""
    label, unit, share = _SET_POINTS[by]
    stated = [getattr(recording, label) for recording in recordings]
    if None in stated:
        raise ArgumentError(
            "{argument} {by} needs {label} of every recording, {n} of {total} state none", argument="by",
            by=by, label=label, n=stated.count(None), total=len(stated),
        )  # fmt: skip
    of_recording = set_points(np.abs(stated), share)
    found = np.unique(of_recording)
    if found.size < _FEWEST:
        raise ArgumentError(
            "{argument} {by} needs recordings at {fewest} {by}s or more, so that fitted ones lie on both "
            "sides, got {n}: {got} {unit}", argument="by", by=by, fewest=_FEWEST, n=found.size,
            got=", ".join(f"{value:g}" for value in found), unit=unit,
        )  # fmt: skip
    return set(np.flatnonzero(of_recording == found[found.size // 2]).tolist())


def _share(recordings: Sequence[Recording], share: float, random_state: int) -> set[int]:
    """Return a share of the assemblies of every count and condition."""
    known = all(recording.assembly is not None for recording in recordings)
    assemblies: dict[Any, list[int]] = {}
    for i, recording in enumerate(recordings):
        assemblies.setdefault(recording.assembly if known else i, []).append(i)
    strata: dict[Any, list[list[int]]] = {}
    kinds = _kinds(recordings)
    members = list(assemblies.values())
    for k in np.random.default_rng(random_state).permutation(len(members)):
        # Both parts hold the same classes and conditions.
        stratum = frozenset(kinds[i] for i in members[k])
        strata.setdefault(stratum, []).append(members[k])
    order = [assembly for of_one_kind in strata.values() for assembly in of_one_kind]
    held = {i for k in range(int(share * len(order))) for i in order[int(k / share)]}
    if not held or len(held) == len(recordings):
        raise ArgumentError(
            "{argument} {share} leaves {left} of {n} recordings to fit, of {assemblies} assemblies each held "
            "out as a whole: more are needed", argument="by", share=f"{share:g}",
            left=len(recordings) - len(held), n=len(recordings), assemblies=len(assemblies),
        )  # fmt: skip
    return held


def _kinds(recordings: Sequence[Recording]) -> list[tuple[Any, ...]]:
    """Return the count and the condition of each recording; without a set-point that not all state."""
    columns: list[Sequence[Any]] = [
        [recording.defect_count for recording in recordings],
        [recording.torque.mean() < 0 for recording in recordings],
    ]
    for label, _, share in _SET_POINTS.values():
        stated = [getattr(recording, label) for recording in recordings]
        if None not in stated:
            columns.append(set_points(np.abs(stated), share).tolist())
    return list(zip(*columns, strict=True))
