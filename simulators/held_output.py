"""Torque against deflection of a gearbox with its output held: play, stiffness and hysteresis."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import trapezoid

from cyclofeat._base.checks import number, positive, whole
from cyclofeat.simulators._kernels import integrate_held, new_memory
from cyclofeat.simulators.defects import LobeDefects, check_machine
from cyclofeat.simulators.gearbox import CycloidalGearbox
from cyclofeat.simulators.simulation import ABSURD_TORQUE, LARGEST_N_STEPS, SimulationDiverged
from cyclofeat.simulators.tables import kernel_input, rest_state

Float = NDArray[np.float64]

_DAMPING = 1e-3  # Nms/rad, of the input's free vibration: an assumption


@dataclass(frozen=True)
class TorqueDeflection:
    """A torque-deflection loop, as :func:`torque_deflection` makes it: arrays of shape (n,)."""

    gearbox: CycloidalGearbox
    torque: Float = field(repr=False)  #: torque at the input times the reduction, in Nm
    deflection: Float = field(repr=False)  #: angle of the input from the start over the reduction, in rad
    held_torque: Float = field(repr=False)  #: torque in Nm at the held output: ``torque`` less friction
    #: Cycle of each point, counted from 0; the first starts at rest and is not closed.
    cycle: NDArray[np.int64] = field(repr=False)

    def last_cycle(self) -> tuple[Float, Float]:
        """Torque (Nm) and deflection (rad) of the last cycle, a closed loop."""
        last = self.cycle == self.cycle[-1]
        return self.torque[last], self.deflection[last]

    def lost_motion(self) -> float:
        """Width of the last loop in rad, between its two crossings of zero torque: the play."""
        torque, deflection = self._closed_loop()
        at = np.flatnonzero((torque[1:] >= 0) != (torque[:-1] >= 0))
        if at.size != 2:
            raise ValueError(f"the loop must cross zero torque twice, not {at.size} times: raise n_points")
        share = torque[at] / (torque[at] - torque[at + 1])
        return float(np.ptp(deflection[at] + share * (deflection[at + 1] - deflection[at])))

    def stiffness(self) -> float:
        """Slope in Nm/rad of the unloading branches beyond half the peak torque, mean of both."""
        torque, deflection = self.last_cycle()
        peak = np.abs(torque).max()
        falling = np.gradient(np.abs(torque)) < 0
        slopes = []
        for side in (torque > peak / 2, torque < -peak / 2):
            chosen = side & falling
            if chosen.sum() < 3:
                raise ValueError("beyond half the peak torque there are fewer than 3 points: raise n_points")
            slopes.append(np.polyfit(deflection[chosen], torque[chosen], 1)[0])
        return float(np.mean(slopes))

    def hysteresis(self) -> float:
        """Area of the last loop in J: the energy lost in one cycle."""
        return float(abs(trapezoid(*self._closed_loop())))

    def _closed_loop(self) -> tuple[Float, Float]:
        torque, deflection = self.last_cycle()
        return np.append(torque, torque[0]), np.append(deflection, deflection[0])


def torque_deflection(
    gearbox: CycloidalGearbox | None = None,
    defects: LobeDefects | None = None,
    *,
    peak_torque: float = 22.0,
    period: float = 1.0,
    n_cycles: int = 2,
    n_points: int = 1000,
    input_angle: float = 0.0,
    dt: float = 1e-5,
) -> TorqueDeflection:
    """Simulate a torque-deflection loop with the output held.

    The output shaft is held rigidly or, if the gearbox has a ``meter_stiffness``, through shaft and torque
    meter. A triangular torque of amplitude ``peak_torque`` over the reduction drives the free input.

    Parameters
    ----------
    gearbox : CycloidalGearbox, default ``CycloidalGearbox.steel()``
        Its speed, load and brake's inertia are not used.
    defects : LobeDefects, default healthy
    peak_torque : float
        Largest torque in Nm, referred to the output.
    period : float
        Time of one cycle in s; long compared with the drive's vibration, or the loop shows inertia.
    n_cycles : int
        Number of cycles; the loop is closed from the second on.
    n_points : int
        Points recorded per cycle.
    input_angle : float
        Angle of the input at the start, in rad: backlash and stiffness depend on it.
    dt : float
        Integration step in s.

    Returns
    -------
    TorqueDeflection

    Notes
    -----
    The input's equation is (J_in + sum m_w |c_k|^2) phi'' = T - sum c_k x R_k: paper B eq. 2 without the
    driver's constraint, with the wheels' masses on the cams. The input's free vibration is damped by 0.001
    Nms/rad (*assumption*).

    Examples
    --------
    >>> loose = CycloidalGearbox.steel(clearance=5e-5, sleeve_friction=0.05)
    >>> loop = torque_deflection(loose, peak_torque=10.0, period=0.2)
    >>> loop.lost_motion() > 1e-3, loop.hysteresis() > 0
    (True, True)
    """
    gearbox, defects = check_machine(gearbox, defects)
    for name, value in (("peak_torque", peak_torque), ("period", period), ("dt", dt)):
        positive(name, value)
    number("input_angle", input_angle)
    whole("n_cycles", n_cycles, 1)
    whole("n_points", n_points, 8)
    every = max(round(period / (n_points * dt)), 1)
    n_steps = round(n_cycles * period / dt)
    if n_steps > LARGEST_N_STEPS:
        raise ValueError(f"period and n_cycles take {n_steps:.3g} steps, more than {LARGEST_N_STEPS:g}")
    z = gearbox.n_lobes
    half_steps = np.arange(2 * n_steps + 1) * (dt / 2)
    phase = half_steps / period
    swing = 2 * np.abs(2 * ((phase + 0.75) % 1) - 1) - 1
    through_meter = gearbox.meter_stiffness > 0
    # The inertia behind the meter is held, so that any value above 0 is right.
    held_by = gearbox.replace(brake_inertia=1.0 if through_meter else 0.0)
    n_kept = -(-n_steps // every)
    angle, held = np.empty(n_kept), np.empty(n_kept)
    state = rest_state(gearbox)
    finished = integrate_held(
        n_steps, dt, swing * peak_torque / z, float(input_angle), _DAMPING,
        float(gearbox.input_shaft_inertia), through_meter, state, *kernel_input(held_by, defects),
        new_memory(state), ABSURD_TORQUE, every, angle, held,
    )  # fmt: skip
    if finished < n_steps:
        raise SimulationDiverged(f"simulation diverged at t = {finished * dt:.6f} s; try dt {dt / 4:g} s")
    kept = np.arange(n_kept) * every
    return TorqueDeflection(
        gearbox=gearbox,
        torque=swing[2 * kept] * peak_torque,
        deflection=(angle - input_angle) / z,
        held_torque=held,
        cycle=(kept * dt / period).astype(np.int64),
    )
