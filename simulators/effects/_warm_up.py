"""Warming up of brake and torque meter: what decays exponentially after the start."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from numpy.random import Generator
from scipy.stats import loguniform, norm

from cyclofeat.simulators.effects import _noise
from cyclofeat.simulators.effects._base import Effect, Float, Fluctuation, TorqueContext
from cyclofeat.simulators.effects._numbers import EffectParameter
from cyclofeat.simulators.gearbox import CycloidalGearbox


class _WarmUp(Effect):
    """Base of both: size and time constant of the decay."""

    parameters: ClassVar = {
        "size_nm": EffectParameter("Nm", -1e3, 1e3, 0.0, norm(0.0, 1.5), default=1.0),
        "time_constant_s": EffectParameter(
            "s", 1e-2, 1e5, None, loguniform(0.3, 10.0), log=True, default=2.0
        ),
    }

    def _course(self, time: Float) -> Float:
        return np.asarray(self.size_nm * np.exp(-time / self.time_constant_s))


class LoadWarmUp(_WarmUp):
    """Warm-up of the brake: its torque begins too high or too low and settles exponentially.

    The load T becomes T + ``size`` exp(-t/``time_constant``), t from the start of the run; a record begins
    later by the settling time. A brake that fades while it warms up does so. Each run begins cold, by
    assumption: a warm-up over a session of many recordings is not modelled. Separating measurement: the same
    record when the rig is warm.

    Parameters
    ----------
    size_nm : float or (low, high), default 1
        Excess of the load at the start in Nm, of either sign; 0 is neutral.
    time_constant_s : float or (low, high), default 2
        In s.
    """

    separated_by = "the same record when the rig is warm"

    def load_fluctuation(
        self, gearbox: CycloidalGearbox, duration: float, random: Generator
    ) -> Fluctuation | None:
        if self.size_nm == 0:
            return None
        end = duration + _noise.MARGIN
        return lambda time: self._course(_noise.checked_time(time, end))


class SensorWarmUp(_WarmUp):
    """Warm-up of the torque meter: its zero begins too high or too low and settles exponentially.

    The torque T becomes T + ``size`` exp(-t/``time_constant``), t from the first sample. The load stays as it
    is, unlike that of :class:`LoadWarmUp`, and each record begins cold in the same way. Separating
    measurement: the same record when the rig is warm, and the meter's reading with the machine at rest.

    Parameters
    ----------
    size_nm : float or (low, high), default 1
        Error at the first sample in Nm, of either sign; 0 is neutral.
    time_constant_s : float or (low, high), default 2
        In s.
    """

    separated_by = "the same record when the rig is warm, and the meter's reading with the machine at rest"

    def change_torque(
        self, torque: Float, sampling_rate: float, random: Generator, context: TorqueContext | None = None
    ) -> Float:
        if self.size_nm == 0:
            return torque
        return np.asarray(torque + self._course(np.arange(torque.size) / sampling_rate))
