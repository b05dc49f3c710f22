"""Angle of the input shaft during a recording, from its tachometer or from the lines of its torque."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cyclofeat._base.quantities import in_words
from cyclofeat.recordings import Recording
from cyclofeat.recordings.windower import WINDOW_TURNS
from cyclofeat.signal.speed import (
    FOLLOWED_TOLERANCE,
    SEARCHED_HZ,
    FollowedSpeed,
    follow_motor,
    follow_speed,
    search_speed,
)
from cyclofeat.signal.windows import Float


@dataclass(frozen=True)
class Turning:
    """Angle of the input shaft during a recording."""

    angle: Float  # in rad, at the samples
    speed_hz: float  # mean, in turns per second
    note: str = ""  # how the angle is known; empty for a tachometer
    doubt: str = ""  # why the speed is not to be trusted, else empty


def turning_of(recording: Recording, n_lobes: int, *, by_faint_lines: bool = True) -> Turning:
    """Return how the shaft turned.

    Lines that do not stand out tell the angle where a speed is stated, unless ``by_faint_lines`` is False:
    the shaft is then taken to turn steadily at that speed. ``ValueError`` where the recording has neither
    an angle nor a nominal speed, and its torque allows none or several.
    """
    recording, rate = recording.for_counting(), recording.sampling_rate
    angle, speed_hz = recording.input_angle(n_lobes), recording.mean_input_speed(n_lobes)
    if angle is not None and speed_hz is not None:
        return Turning(angle, speed_hz)
    stated = recording.input_speed_hz
    if stated is None:
        possible = search_speed(recording.torque, rate, n_lobes)
        # A motor's own lines may look like a disc's at another speed: its current proposes speeds only.
        if len(possible) == 1 and recording.quantity != "motor_current":
            rpm = f"{60 * possible[0].speed_hz:.5g} RPM"
            note = f"neither tachometer nor stated speed: {rpm} found in the torque"
            return Turning(possible[0].angle, possible[0].speed_hz, note)
        low, high = (f"{60 * end:,.0f}" for end in SEARCHED_HZ)
        speeds = " or ".join(f"{60 * other.speed_hz:.4g}" for other in possible)
        seen = f"allows {speeds} RPM" if possible else f"shows none from {low} to {high} RPM"
        raise ValueError(
            f"the recording has neither a tachometer's angle nor a speed, and its "
            f"{in_words(recording.quantity)} {seen}: give speed_rpm= (nominal speed of the input in RPM)"
        )
    followed = _follow_lines(recording, stated, n_lobes)
    rpm = f"{60 * stated:.5g} RPM"
    speed = f"{60 * followed.speed_hz:.5g} RPM"
    if followed.fits:
        return Turning(followed.angle, followed.speed_hz, f"no tachometer: {speed} found in the torque")
    doubt = f"its lines could as well be those of a disc at another speed than the stated {rpm}"
    stands_out = bool(np.isfinite(followed.margin))
    if not stands_out:
        doubt = (
            f"no lobe, mesh or shaft lines stand out within {100 * FOLLOWED_TOLERANCE:.2g} % of the stated "
            f"{rpm}: its speed is not confirmed"
        )
    if (stands_out or by_faint_lines) and _holds_a_window(followed.angle, n_lobes):
        note = f"no tachometer: {speed} is the likeliest speed in the torque"
        return Turning(followed.angle, followed.speed_hz, note, doubt)
    steady = 2 * np.pi * stated / rate * np.arange(recording.n_samples, dtype=float)
    return Turning(steady, stated, f"no tachometer: taken to turn steadily at the stated {rpm}", doubt)


def _holds_a_window(angle: Float, n_lobes: int) -> bool:
    return bool(np.ptp(angle) >= 2 * np.pi * WINDOW_TURNS * n_lobes)


def _follow_lines(recording: Recording, speed_hz: float, n_lobes: int) -> FollowedSpeed:
    follow = follow_motor if recording.quantity == "motor_current" else follow_speed
    return follow(recording.torque, recording.sampling_rate, speed_hz, n_lobes)


def angle_by_lines(recording: Recording, turning: Turning, n_lobes: int) -> Float | None:
    """Return the angle that the lines of a recording tell without its tachometer, numbered as the latter's.

    None where the lines would not be followed, err by more than a lobe, or tell less than a window.
    """
    try:
        followed = _follow_lines(recording.for_counting(), turning.speed_hz, n_lobes)
    except ValueError:  # too short, or too few samples
        return None
    beside = turning.angle - followed.angle
    one_lobe = 2 * np.pi * n_lobes / (n_lobes + 1)
    if not followed.fits or np.ptp(beside) > one_lobe or not _holds_a_window(followed.angle, n_lobes):
        return None
    return np.asarray(followed.angle + beside.mean())
