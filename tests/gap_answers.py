"""A result of the gap with everything in it, for the tests of what shows it."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np

from cyclofeat.gap import Condition, GapResult
from cyclofeat.gap.overlays import Band, Overlay
from cyclofeat.gap.proof.prove import DistanceRow, Proof, ProofRow
from cyclofeat.gap.result import FoundEffect, NextMeasurement, Remainder, RemainderRow, Size, VisibleFrom
from cyclofeat.gap.where.locate import where_of
from cyclofeat.simulators import Gain, Hum, PinErrors, Rig

FIRST, SECOND = Condition(500.0, 22.0), Condition(400.0, 12.0, -1)

EFFECTS = (
    FoundEffect("hum", 0.999, "missing", (Size("amplitude_nm", "Nm", 1.987, 1.91, 2.06),)),
    FoundEffect("pin_errors", 0.96, "missing", (Size("rms", "m", 1.2e-5, 2e-6, 5e-5),)),
    FoundEffect("gain", 0.61, "probably missing", (Size("factor", "1", 1.05, 1.01, 1.09),), ("offset",)),
    FoundEffect("offset", 0.36, "undecided", (), ("gain",)),
    FoundEffect("clearance", 0.3, "undecided", (Size("clearance", "m", 1e-5, math.nan, math.nan),)),
    FoundEffect(
        "run_out",
        0.12,
        "too small to matter",
        visible=0.01,
        visible_from=VisibleFrom("runout", "m", math.nan, 2.5e-5),
    ),
    FoundEffect("noise", 0.02, "not missing"),
)

REMAINDER = Remainder(
    0.0004,
    unexplained=True,
    rows=(
        RemainderRow("spectrum", "third octave at 631 Hz", "dB", 562.0, 708.0, difference=2.31, z=6.1),
        RemainderRow("codes", "share of the largest value", "1", difference=-0.4, z=-4.2),
    ),
)


def compared(**alternatives: Any) -> tuple[ProofRow, ...]:
    """Rows of a proof: for each alternative its shares over all, seen and unseen counts."""
    return tuple(
        ProofRow(name, condition, grr, grr - 0.05, grr + 0.04)
        for name, ratios in alternatives.items()
        for condition, grr in zip(("all", "seen", "unseen"), ratios, strict=False)
    )


def proof_of(rows: Any = None, condition: Condition | None = FIRST) -> Proof:
    distances = [
        DistanceRow(name, "all", family, distance)
        for name, distance in (("nothing", 4.25), ("after", 1.5), ("floor", 1.125))
        for family in ("spectrum", "overall")
    ]
    if rows is None:
        rows = compared(after=(0.91, 0.93, 0.88), nothing=(0, 0, 0))
    return Proof(tuple(rows), tuple(distances), 6, condition)


def overlay(kind: str = "spectrum", condition: Condition = FIRST, n: int = 5) -> Overlay:
    x = np.arange(1.0, n + 1)
    bands = [Band(level * x, 0.9 * level * x, 1.2 * level * x) for level in (1.0, 2.0, 1.5)]
    return Overlay(kind, x, *bands, condition)


def answered(located: Any, **changes: Any) -> GapResult:
    """A result at two conditions, of which the first is ``located``."""
    where = where_of(located)
    both = (
        dataclasses.replace(where, condition=FIRST),
        dataclasses.replace(where, condition=SECOND, phase={}),
    )
    whole: dict[str, Any] = {
        "where": both,
        "rig": Rig(effects=[Hum(2.0)]),
        "effects": EFFECTS,
        "named": (Hum(1.987), PinErrors(1.2e-5), Gain(1.05)),
        "remainder": Remainder(0.31, unexplained=False),
        "next_measurements": (
            NextMeasurement("a record at 44 Nm", ("gain", "offset")),
            NextMeasurement("dead weights on the meter", ("gain", "offset")),
        ),
        "overlays": tuple(
            overlay(kind, condition)
            for condition in (FIRST, SECOND)
            for kind in ("spectrum", "orders", "distribution")
        ),
        "proof": (proof_of(), proof_of(compared(after=(0.97,)), SECOND)),
        "warnings": ("No tachometer.", "No tachometer.", "One record was clipped."),
        "seconds": 83.4,
    }
    return GapResult(**whole | changes)
