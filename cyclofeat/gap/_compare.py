"""Measured recordings against those of any simulator."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence

from cyclofeat.gap._measured import Condition, MeasuredRig
from cyclofeat.gap._overlays import overlays
from cyclofeat.gap._result import GapResult
from cyclofeat.gap._settings import GapSettings
from cyclofeat.gap._where import where_of
from cyclofeat.gap.where import LocatedGap, locate_all
from cyclofeat.gap.world import World
from cyclofeat.recordings import Recording
from cyclofeat.recordings.recording import common_n_lobes
from cyclofeat.simulators import Rig

_FEW_SIMULATED = 40  # below it "disagree" is said too often where nothing differs


def compare_recordings(
    measured: Sequence[Recording], simulated: Sequence[Recording], *, settings: GapSettings | None = None
) -> GapResult:
    """Find where measured recordings differ from those of any simulator.

    Nothing is named, as the simulator is not known. Conditions, counts and tachometers are used as far as
    both sets state them.

    Parameters
    ----------
    measured, simulated : sequence of Recording
    settings : GapSettings, optional
        ``alpha``, ``n_permutations``, ``pictures`` and ``random_state`` are used.

    Returns
    -------
    GapResult
        Without effects.

    Raises
    ------
    ValueError
        If the two sets have no condition in common at which each has two recordings, or do not fit together.

    Notes
    -----
    In 60 comparisons each of 6 recordings without a difference and alpha = 0.05, "disagree" was said of 3 %
    with 48 simulated recordings or more, of 17 % with 12 to 24 and of 65 % with 6: simulate 40 or more of
    each condition.

    Examples
    --------
    >>> import numpy as np
    >>> random, time = np.random.default_rng(0), np.arange(12_000) / 6400
    >>> def recorded(hum_nm):
    ...     torque = 22 + hum_nm * np.sin(100 * np.pi * time) + random.normal(0, 0.1, time.size)
    ...     return Recording(torque, 6400, speed_rpm=500, load_nm=22)
    >>> measured, simulated = [recorded(0.2) for _ in range(6)], [recorded(0) for _ in range(40)]
    >>> compare_recordings(measured, simulated, settings=GapSettings(pictures=False)).verdict
    'disagree'
    """
    began = time.monotonic()
    settings = GapSettings() if settings is None else settings
    given = [*measured, *simulated]
    gearbox = Rig().gearbox.replace(n_pins=common_n_lobes(given) + 1)
    rig = Rig(gearbox)
    both = MeasuredRig.of(given, rig)
    numbers = range(len(given))
    parts = both.part(numbers[: len(measured)]), both.part(numbers[len(measured) :])
    located = locate_all(parts[0], World(rig=rig), settings, simulated=parts[1])
    pictures = settings.pictures
    return GapResult(
        where=tuple(where_of(one, pictures=pictures) for one in located),
        rig=rig,
        quantity=both.quantity,
        overlays=tuple(
            overlay
            for one in located
            if pictures
            for overlay in overlays(one.comparison, one.measured.windows, one.bank.X)
        ),
        warnings=(*both.warnings, *parts[0].doubts, *_limits(*parts, located)),
        seconds=time.monotonic() - began,
    )


def _limits(measured: MeasuredRig, simulated: MeasuredRig, located: Sequence[LocatedGap]) -> Iterator[str]:
    """Yield a sentence on what these sets of recordings cannot tell."""
    compared = [Condition.of(one.comparison) for one in located]
    left_out = [condition.text for condition in measured.conditions if condition not in compared]
    if left_out:
        yield f"not compared, as each set needs two recordings there: {'; '.join(left_out)}"
    fewest = min(len(one.bank.X) for one in located)
    if fewest < _FEW_SIMULATED:
        yield (
            f"{fewest} simulated recordings of a condition: with fewer than {_FEW_SIMULATED} differences "
            "look surer than they are"
        )
    if any(measured.of_one_assembly(condition) for condition in compared):
        yield (
            "all recordings of a condition are of one assembly: what is peculiar to it counts as a difference"
        )
