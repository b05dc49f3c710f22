"""How long to record to tell n worn lobes from n + 1: read from a table of simulated trials."""

from __future__ import annotations

import csv
import functools
import math
from dataclasses import asdict, dataclass
from importlib.resources import files
from numbers import Integral, Real
from typing import Any

_TABLE = "tables/detection.csv"
_LOBES = 15


@dataclass(frozen=True)
class Trial:
    """How often n and n + 1 worn lobes were told apart on simulated assemblies.

    Attributes
    ----------
    rig : str
    depth : float
        Of the wear, as a share of the lobe's width.
    noise_nm : float
        Standard deviation of the white noise in Nm.
    turns : int
        Output turns recorded.
    worn : int
        n.
    assemblies : int
        With n or n + 1 worn lobes.
    right : float
        Assemblies told right; one whose recordings are told right in part counts in part.
    """

    rig: str
    depth: float
    noise_nm: float
    turns: int
    worn: int
    assemblies: int
    right: float

    @property
    def probability(self) -> float:
        """Chance of telling the next assembly right by Laplace's rule of succession, never quite 0 or 1."""
        return (self.right + 1) / (self.assemblies + 2)


@dataclass(frozen=True)
class RecordingPlan:
    """Answer of :func:`plan_recording`.

    Attributes
    ----------
    worn : int
        n, to be told from n + 1.
    confidence : float
        Asked for.
    noise_nm, depth : float
        Asked for.
    tabulated_noise_nm, tabulated_depth : float
        Entry of the table that answers: the next worse one.
    turns : int or None
        Least number of output turns; None where the table's longest recording is not enough.
    seconds : float or None
        The same at the input speed.
    probability : float
        Reached with ``turns``; where that is None, with the longest recording.
    assemblies : int
        Simulated assemblies on which that stands.
    largest_noise_nm : float or None
        Largest noise of the table at which the longest recording is enough at this depth; None if at none.
    reachable : float
        Largest confidence that as many assemblies could show, all told right.
    longest_turns : int
        Output turns of the table's longest recording.
    longest_seconds : float
        The same at the input speed.
    """

    worn: int
    confidence: float
    noise_nm: float
    depth: float
    tabulated_noise_nm: float
    tabulated_depth: float
    turns: int | None
    seconds: float | None
    probability: float
    assemblies: int
    largest_noise_nm: float | None
    reachable: float
    longest_turns: int
    longest_seconds: float

    def to_dict(self) -> dict[str, Any]:
        """In plain types, for JSON."""
        return asdict(self)


@functools.cache
def detection_table() -> tuple[Trial, ...]:
    """The trials that plans are made from, written by ``make bench-counting`` (``tables/README.md``)."""
    text = files("cyclofeat.counting").joinpath(_TABLE).read_text(encoding="utf-8")
    return tuple(
        Trial(
            row["rig"], float(row["depth"]), float(row["noise_nm"]), int(row["turns"]), int(row["worn"]),
            int(row["assemblies"]), float(row["right"]),
        )
        for row in csv.DictReader(text.splitlines())
    )  # fmt: skip


def plan_recording(
    worn: int,
    *,
    noise_nm: float,
    confidence: float = 0.95,
    depth: float = 1.0,
    input_speed_hz: float = 500 / 60,
) -> RecordingPlan:
    """How many output turns to record to tell ``worn`` lobes from one more.

    Parameters
    ----------
    worn : int
        n, from 0 to 6.
    noise_nm : float
        Standard deviation of the torque meter's white noise at 25.6 kHz, in Nm.
    confidence : float
        Wanted probability of naming the right one of n and n + 1, above 0.5 and below 1.
    depth : float
        Of the wear, as a share of the lobe's width (1: the papers' worn lobe).
    input_speed_hz : float
        Input turns per second.

    Returns
    -------
    RecordingPlan

    Raises
    ------
    TypeError, ValueError
        Where an argument is no number or lies outside the table; the message names it.

    Notes
    -----
    *What it stands on.* Simulated assemblies of rig R1 (an assumption: brake rotor 0.02 kg m2 behind 10
    kNm/rad, 3 Nm rms drift below 1.5 Hz, 22 Nm, 500 RPM), neighbouring worn lobes, a counter trained on the
    same rig at the same noise and all depths. On a rig that was not trained on, expect less. Of noise and
    depth the next worse entry of the table answers, nothing is interpolated. Another speed is taken to need
    as many turns.

    *Probability.* (right + 1)/(assemblies + 2), Laplace's rule of succession: few assemblies, all told right,
    do not promise certainty, and a confidence above ``reachable`` cannot be shown with them.

    Examples
    --------
    >>> plan = plan_recording(3, noise_nm=0.5, confidence=0.9)
    >>> plan.turns, round(plan.seconds, 3)
    (1, 1.8)
    """
    n = _worn(worn)
    trials = [trial for trial in detection_table() if trial.worn == n]
    given: dict[str, Any] = {
        "noise_nm": noise_nm,
        "confidence": confidence,
        "depth": depth,
        "input_speed_hz": input_speed_hz,
    }
    for name, value in given.items():
        if isinstance(value, bool) or not isinstance(value, Real):
            raise TypeError(f"{name} must be a number, got {value!r}")
        number = float(value)
        if not (math.isfinite(number) and number > 0):
            raise ValueError(f"{name} must be positive and finite, got {value!r}")
    if not 0.5 < confidence < 1:
        raise ValueError(f"confidence must lie above 0.5 (guessing) and below 1, got {confidence!r}")
    noises, depths = sorted({t.noise_nm for t in trials}), sorted({t.depth for t in trials})
    if noise_nm > noises[-1]:
        raise ValueError(f"noise_nm must be at most {noises[-1]:g}, the table's largest, got {noise_nm!r}")
    if not depths[0] <= depth <= 1:
        raise ValueError(f"depth must lie between {depths[0]:g}, the table's least, and 1, got {depth!r}")
    noise = next(value for value in noises if value >= noise_nm)
    shallow = max(value for value in depths if value <= depth)
    at_depth = [trial for trial in trials if trial.depth == shallow]
    chosen = sorted((t for t in at_depth if t.noise_nm == noise), key=lambda trial: trial.turns)
    enough = next((trial for trial in chosen if trial.probability >= confidence), None)
    answer = chosen[-1] if enough is None else enough
    longest = max(trial.turns for trial in at_depth)
    fine = [t.noise_nm for t in at_depth if t.turns == longest and t.probability >= confidence]

    def seconds(turns: int) -> float:
        # Rounded: the speed in turns per second is no round number.
        return round(turns * _LOBES / float(input_speed_hz), 9)

    return RecordingPlan(
        worn=n,
        confidence=float(confidence),
        noise_nm=float(noise_nm),
        depth=float(depth),
        tabulated_noise_nm=noise,
        tabulated_depth=shallow,
        turns=None if enough is None else enough.turns,
        seconds=None if enough is None else seconds(enough.turns),
        probability=answer.probability,
        assemblies=answer.assemblies,
        largest_noise_nm=max(fine, default=None),
        reachable=(answer.assemblies + 1) / (answer.assemblies + 2),
        longest_turns=longest,
        longest_seconds=seconds(longest),
    )


def _worn(worn: Any) -> int:
    if isinstance(worn, bool) or not isinstance(worn, Integral):
        raise TypeError(f"worn must be a whole number of lobes, got {worn!r}")
    most = max(trial.worn for trial in detection_table())
    number = int(worn)
    if not 0 <= number <= most:
        raise ValueError(f"worn must lie between 0 and {most}, the table's largest n, got {worn!r}")
    return number
