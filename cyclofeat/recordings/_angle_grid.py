"""Torque on equal steps of the input shaft's angle."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.signal import resample_poly

from cyclofeat.signal.lobes import anti_alias
from cyclofeat.signal.orders import resample_by_angle
from cyclofeat.signal.windows import Float

# Rounding must not cost the grid point, in rad, at which a record begins or ends.
ROUNDING = 1e-9

# Samples per turn that are left to the interpolation, in multiples of the grid's.
_DENSE = 2.5
# Grid points by which a record is continued at either end, where the filters settle.
_MARGIN = 44.8


@dataclass(frozen=True)
class AngleGrid:
    """Filters that bring torque to equal steps of an angle."""

    samples_per_turn: int  # one of them at angle zero
    decimation: int  # of the sampling rate, before the torque is interpolated
    level: float = 0.0  # subtracted from the torque
    sign: float = 1.0  # by which the rest is multiplied

    @classmethod
    def for_angle(cls, angle: Float, samples_per_turn: int) -> AngleGrid:
        """Return the grid for a record of this angle in rad, shape (n,)."""
        return cls(samples_per_turn, max(1, int(mean_density(angle) / (samples_per_turn * _DENSE))))

    @property
    def step(self) -> float:
        """Distance of two grid points in rad."""
        return 2 * math.pi / self.samples_per_turn

    def first_point(self, angle: float) -> int:
        """Return the number of the first grid point from an angle in rad on."""
        return math.ceil((angle - ROUNDING) / self.step)

    def resample(self, torque: Float, angle: Float, sampling_rate: float) -> tuple[Float, Float]:
        """Return torque at the grid points within the angle, and these angles in rad, each of shape (m,)."""
        margin = self._n_reflected(angle)
        # One long array after the other: a record may fill a good part of the memory.
        longer = torque - self.level
        longer *= self.sign
        longer = self._low_pass(_reflect_ends(longer, margin))
        turning = _reflect_ends(angle, margin)[:: self.decimation].copy()
        even, grid = resample_by_angle(
            longer, turning, self.samples_per_turn, sampling_rate / self.decimation
        )
        inside = (grid >= angle[0] - ROUNDING) & (grid <= angle[-1] + ROUNDING)
        return even[inside], grid[inside]

    def decimate(self, torque: Float, angle: Float) -> Float:
        """Return torque at every ``decimation``-th sample, low-passed."""
        margin = self._n_reflected(angle)
        level = float(torque.mean())
        longer = self._low_pass(_reflect_ends(torque - level, margin))
        return longer[margin // self.decimation :][: angle[:: self.decimation].size] + level

    def _n_reflected(self, angle: Float) -> int:
        """Return the samples by which a record is continued, a multiple of the decimation."""
        longest = (angle.size - 1) // self.decimation
        wanted = math.ceil(_MARGIN / self.samples_per_turn * mean_density(angle) / self.decimation)
        return min(wanted, longest) * self.decimation

    def _low_pass(self, values: Float) -> Float:
        if self.decimation == 1:
            return values
        return np.asarray(resample_poly(values, 1, self.decimation, window=anti_alias(self.decimation)))


def mean_density(angle: Float) -> float:
    """Return the mean number of samples per turn of a record of this angle in rad."""
    return angle.size / (float(np.ptp(angle)) / (2 * np.pi))


def _reflect_ends(values: Float, margin: int) -> Float:
    """Continue a curve by its point reflection at either end: neither value nor slope has a step there."""
    before = 2 * values[0] - values[margin:0:-1]
    return np.concatenate([before, values, 2 * values[-1] - values[-2 : -margin - 2 : -1]])
