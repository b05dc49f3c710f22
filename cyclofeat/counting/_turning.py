"""How the input shaft turned during a recording: by its tachometer, or by the lines of its torque."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cyclofeat._base.arguments import ArgumentError
from cyclofeat.recordings import Recording
from cyclofeat.signal.orders import mean_speed, samples_at
from cyclofeat.signal.speed import FOLLOWED_TOLERANCE, follow_speed
from cyclofeat.signal.windows import Float


@dataclass(frozen=True)
class Turning:
    """Angle of the input shaft during a recording.

    Attributes
    ----------
    angle : ndarray, shape (n,)
        In rad, at the samples.
    speed_hz : float
        Mean speed in turns per second.
    note : str
        How the angle is known; empty for a tachometer.
    doubt : str
        Why the speed is not to be trusted, else empty.
    """

    angle: Float
    speed_hz: float
    note: str = ""
    doubt: str = ""

    def times(self, angle: Float, sampling_rate: float) -> Float:
        """Return when the shaft passed angles, in s from the first sample."""
        return samples_at(angle, self.angle) / sampling_rate


def turning_of(recording: Recording, n_lobes: int) -> Turning:
    """Return how the shaft turned.

    Raises
    ------
    ArgumentError
        If the recording has neither an angle nor a nominal speed.
    """
    rate = recording.sampling_rate
    angle = recording.input_angle(n_lobes)
    if angle is not None:
        return Turning(angle, float(mean_speed(angle, rate)))
    stated = recording.input_speed_hz
    if stated is None:
        raise ArgumentError(
            "the recording has neither a tachometer's angle nor a speed: give {speed_rpm:=} (nominal speed "
            "of the input in RPM)"
        )
    followed = follow_speed(recording.torque, rate, stated, n_lobes)
    rpm = f"{60 * stated:.5g} RPM"
    if followed.evidence > 0:
        speed = float(mean_speed(followed.angle, rate))
        doubt = ""
        if not followed.fits:
            doubt = f"its lines are not those of a disc at the stated {rpm}, but of another speed"
        return Turning(
            followed.angle, speed, f"no tachometer: {60 * speed:.5g} RPM found in the torque", doubt
        )
    return Turning(
        2 * np.pi * stated / rate * np.arange(recording.n_samples, dtype=float),
        stated,
        f"no tachometer: taken to turn steadily at the stated {rpm}",
        f"no lobe, mesh or shaft lines stand out within {100 * FOLLOWED_TOLERANCE:.2g} % of the stated "
        f"{rpm}: its speed is not confirmed",
    )
