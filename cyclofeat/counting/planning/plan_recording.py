"""Length of a recording that tells n worn lobes from n + 1, from a table of simulated trials."""

from __future__ import annotations

import csv
import functools
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from importlib.resources import files
from typing import Any

from cyclofeat._base.checks import positive, whole

_LOBES = 15


@dataclass(frozen=True)
class Trial:
    """Simulated assemblies with n or n + 1 worn lobes, and how many were identified correctly.

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
        Assemblies identified correctly; an assembly counts in part if some of its recordings are correct.
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
        """Probability of the right answer for the next assembly, by Laplace's rule of succession."""
        return (self.right + 1) / (self.assemblies + 2)


@dataclass(frozen=True)
class RecordingPlan:
    """Answer of :func:`plan_recording`.

    Attributes
    ----------
    worn : int
        n, to be distinguished from n + 1.
    confidence, noise_nm, depth : float
        Requested values.
    tabulated_noise_nm, tabulated_depth : float
        Entry of the table that answers: the next worse one.
    turns, seconds : int, float or None
        Shortest recording in output turns, and in s; None where the table's longest is not enough.
    probability : float
        Reached with ``turns``; where that is None, with the longest recording.
    assemblies : int
        Simulated assemblies on which that stands.
    largest_noise_nm : float or None
        Largest noise of the table at which the longest recording is enough at this depth; None if at none.
    reachable : float
        Largest confidence that as many assemblies could show, all identified correctly.
    longest_turns, longest_seconds : int, float
        The table's longest recording in output turns, and in s.
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
        """Return the plan in plain types, for JSON."""
        return asdict(self)


@functools.cache
def detection_table() -> tuple[Trial, ...]:
    """The trials that plans are made from, written by ``make bench-counting`` (``tables/README.md``)."""
    text = files("cyclofeat.counting").joinpath("tables/detection.csv").read_text(encoding="utf-8")
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
    trials: Sequence[Trial] | None = None,
) -> RecordingPlan:
    """Plan how many output turns to record to tell ``worn`` lobes from one more.

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
    trials : sequence of Trial, optional
        Trials to plan from. Default: the table of the package, :func:`detection_table`.

    Returns
    -------
    RecordingPlan

    Raises
    ------
    TypeError, ValueError
        Where an argument is no number or lies outside the table; the message names it.

    Notes
    -----
    *Basis.* Simulated assemblies of rig R1 (an assumption: brake rotor 0.02 kg m2 behind 10
    kNm/rad, 3 Nm rms drift below 1.5 Hz, 22 Nm, 500 RPM), neighbouring worn lobes, a counter trained on the
    same rig at the same noise and all depths. On a rig that was not trained on, expect less. Of noise and
    depth the next worse entry of the table answers, nothing is interpolated. Another speed is taken to need
    as many turns.

    *Probability.* (right + 1)/(assemblies + 2), Laplace's rule of succession: a confidence above
    ``reachable`` cannot be shown with so few assemblies.

    Examples
    --------
    >>> plan = plan_recording(3, noise_nm=0.5, confidence=0.9)
    >>> plan.turns, round(plan.seconds, 3)
    (1, 1.8)
    """
    table = detection_table() if trials is None else trials
    n, most = whole("worn", worn), max(trial.worn for trial in table)
    if not 0 <= n <= most:
        raise ValueError(f"worn must lie between 0 and {most}, the table's largest n, got {worn!r}")
    trials = [trial for trial in table if trial.worn == n]
    positive("noise_nm", noise_nm)
    positive("confidence", confidence)
    positive("depth", depth)
    positive("input_speed_hz", input_speed_hz)
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
        # Rounded, because the speed in turns per second is not a round number.
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
