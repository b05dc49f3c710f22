"""The motor that turns the input shaft."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

from cyclofeat._base.checks import not_negative, positive, whole


@dataclass(frozen=True)
class Motor:
    """A motor on the input shaft with control of its speed; made by effects such as ``ServoMotor``.

    J w' = k(phi) i - friction - cogging(phi) - T_in, with phi and w = phi' of the input, J of the rotor with
    all that turns rigidly with it, and the input torque T_in. A proportional-integral controller of the speed
    sets the current i, which follows with a lag of first order. Default values are *assumptions*.

    Parameters
    ----------
    inertia : float
        Of the rotor, in kg m2.
    bandwidth_hz : float
        b of the speed controller, in Hz. Its gains are p = 2 pi b J and p (2 pi b)/4, J with the inertia of
        gearbox and brake: two equal poles at pi b rad/s, as far as everything turns rigidly.
    current_bandwidth_hz : float
        Corner of the current's lag, in Hz.
    torque_constant : float
        Mean of k(phi), in Nm/A.
    pole_pairs, slots : int
        Pairs of magnetic poles of the rotor, and slots of the stator.
    ripple, ripple_phase : float
        k(phi) = ``torque_constant`` (1 + ``ripple`` cos(6 ``pole_pairs`` phi + ``ripple_phase``)).
    cogging_nm, cogging_phases : tuple of three floats
        Amplitudes in Nm, and phases in rad, of the waves of :attr:`cogging_orders`.
    coulomb_nm, viscous : float
        Friction of the motor's bearings: in Nm, and in Nm s/rad.
    offset_nm, noise_nm, lsb_nm : float
        Offset, standard deviation of white noise, and step (0 for none) of the measured current, times the
        torque constant, in Nm.

    Raises
    ------
    TypeError, ValueError
        If a parameter is of the wrong type or outside its range.

    Examples
    --------
    >>> Motor(pole_pairs=5, slots=12).cogging_orders
    (60, 12, 10)
    """

    inertia: float = 5e-5
    bandwidth_hz: float = 50.0
    current_bandwidth_hz: float = 500.0
    torque_constant: float = 0.3
    pole_pairs: int = 4
    slots: int = 12
    ripple: float = 0.0
    ripple_phase: float = 0.0
    cogging_nm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    cogging_phases: tuple[float, float, float] = (0.0, 0.0, 0.0)
    coulomb_nm: float = 0.0
    viscous: float = 0.0
    offset_nm: float = 0.0
    noise_nm: float = 0.0
    lsb_nm: float = 0.0

    def __post_init__(self) -> None:
        for name in ("inertia", "bandwidth_hz", "current_bandwidth_hz", "torque_constant"):
            positive(name, getattr(self, name))
        for name in ("pole_pairs", "slots"):
            whole(name, getattr(self, name), 1)
        for name in ("noise_nm", "lsb_nm"):
            not_negative(name, getattr(self, name))

    @property
    def cogging_orders(self) -> tuple[int, int, int]:
        """Waves per turn: least common multiple of slots and poles, slots, poles."""
        poles = 2 * self.pole_pairs
        return math.lcm(self.slots, poles), self.slots, poles

    @property
    def warm_up(self) -> float:
        """Time in s after which a start in steady state is forgotten: ten time constants of the control."""
        return 10 / (math.pi * self.bandwidth_hz)

    def replace(self, **changes: float | tuple[float, ...]) -> Motor:
        """Return a copy with single fields changed."""
        return dataclasses.replace(self, **changes)  # type: ignore[arg-type]
