"""Energy balance of a run: the drive's work against load, stored energy and losses."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cyclofeat._base.checks import not_negative, positive
from cyclofeat.simulators import _kernels, _outline
from cyclofeat.simulators.contact import pin_centres
from cyclofeat.simulators.courses import drive_and_load
from cyclofeat.simulators.defects import LobeDefects, machine
from cyclofeat.simulators.gearbox import CycloidalGearbox
from cyclofeat.simulators.simulation import Integrated, Integration
from cyclofeat.simulators.tables import kernel_input, rest_state

__all__ = ["EnergyAudit", "energy_audit"]

Float = NDArray[np.float64]
Complex = NDArray[np.complex128]

# Steps whose forces and motion are in memory at once, about 15 MB.
_BLOCK = 8192


@dataclass(frozen=True)
class EnergyAudit:
    """Energy that flowed in a stretch of a run, in J.

    input_work = output_work + kinetic_change + elastic_change + contact_dissipation + friction
    + meter_damping + leak

    Attributes
    ----------
    start_time, end_time : float
        The stretch, in s.
    input_work : float
        Integral of torque_in times the input's speed: the drive's work on the cams and in its bearing.
    output_work : float
        Integral of the load torque times the speed of the shaft that it brakes, against its turning.
    kinetic_change, elastic_change : float
        Change of the kinetic energy of wheels, output shaft, sleeves and brake rotor, and of the energy that
        all contacts and the torque meter's spring store.
    contact_dissipation : float
        Taken by the contacts' damping: integral of (force - elastic force) times the rate of penetration.
    friction : float
        Taken by friction of sleeves on wheels and axles and by the shafts' bearings.
    meter_damping : float
        Taken by the damping between output shaft and brake.
    """

    start_time: float
    end_time: float
    input_work: float
    output_work: float
    kinetic_change: float
    elastic_change: float
    contact_dissipation: float
    friction: float
    meter_damping: float

    @property
    def leak(self) -> float:
        """Energy in J that does not balance; negative if the contact law creates energy."""
        kept = self.output_work + self.kinetic_change + self.elastic_change
        return self.input_work - kept - self.contact_dissipation - self.friction - self.meter_damping

    @property
    def relative_leak(self) -> float:
        """The leak as a share of the input work."""
        return self.leak / self.input_work


def energy_audit(
    gearbox: CycloidalGearbox | None = None,
    defects: LobeDefects | None = None,
    *,
    duration: float = 0.24,
    dt: float = 1e-5,
    start_time: float = 0.3,
    start_angle: float = 0.0,
) -> EnergyAudit:
    """Account for the energy of a run, from ``start_time`` on.

    Parameters
    ----------
    gearbox : CycloidalGearbox, default ``CycloidalGearbox.steel()``
    defects : LobeDefects, default healthy
    duration : float
        Length of the audited stretch in s (two input turns at 500 RPM).
    dt : float
        Integration step in s.
    start_time : float
        Start of the stretch in s; the run starts at 0 from rest.
    start_angle : float
        Input angle at t = 0 in rad.

    Raises
    ------
    SimulationDiverged, GearboxLocked
        As :func:`~cyclofeat.simulators.simulate`.
    ValueError
        If a time is not finite or out of range.

    Notes
    -----
    The energy stored in a contact of effective radius R is the integral of its elastic force (paper B
    eq. 11-14 with the ramp of eq. 12 up to d_0),

        U(d, R) = k sqrt(R) d^3.5 / (3.5 d_0)                                  for d < d_0,
        U(d, R) = k sqrt(R) (d_0^2.5 / 3.5 + (d^2.5 - d_0^2.5) / 2.5)          beyond,

    k = K / sqrt(R). Energy is conserved only where R is constant. In paper B R follows the curvature, so that
    U changes by (dU/dR) R' without work as a contact moves along the flank: the leak, about 1 % of the power.
    ``contact_law="conservative"`` has none.

    Powers are summed over all steps by the trapezoid rule, without the inertia of the input shaft.

    Examples
    --------
    >>> audit = energy_audit(CycloidalGearbox.steel(contact_law="conservative"))
    >>> abs(audit.relative_leak) < 1e-3
    True
    >>> round(energy_audit().relative_leak, 4)
    -0.0095
    """
    gearbox, defects = machine(gearbox, defects)
    positive("duration", duration)
    positive("dt", dt)
    not_negative("start_time", start_time)
    first, n_steps = round(start_time / dt), max(round(duration / dt), 1)
    last = first + n_steps
    course = drive_and_load(gearbox, 2 * last + 3, dt / 2, 1 / dt, start_angle)
    integration = Integration(gearbox, kernel_input(gearbox, defects), course, dt)
    state = rest_state(gearbox)
    if first > 0:
        state = integration.run(state, 0, first, np.arange(0)).state
    stored: list[Float] = []
    powers: list[Float] = []
    # One more step, because energies are those at the beginning of a step.
    for begin in range(first, last + 1, _BLOCK):
        end = min(begin + _BLOCK, last + 1)
        done = integration.run(state, begin, end, np.arange(end - begin), forces=True)
        state = done.state
        block = _Account(integration, begin, done)
        stored.append(block.stored)
        powers.append(block.powers)
    energy, power = np.concatenate(stored, axis=1), np.concatenate(powers, axis=1)
    work = dt * (power.sum(axis=1) - 0.5 * (power[:, 0] + power[:, -1]))
    change = energy[:, -1] - energy[:, 0]
    return EnergyAudit(
        start_time=first * dt,
        end_time=last * dt,
        input_work=float(work[0]),
        output_work=float(work[1]),
        kinetic_change=float(change[0]),
        elastic_change=float(change[1]),
        contact_dissipation=float(work[2]),
        friction=float(work[3]),
        meter_damping=float(work[4]),
    )


class _Account:
    """Energies in J and powers in W at the n steps of a run from ``first`` on."""

    def __init__(self, integration: Integration, first: int, done: Integrated) -> None:
        gearbox, constants = integration.gearbox, integration.constants
        z = gearbox.n_lobes
        self.gearbox, self.constants, self.first = gearbox, constants, first
        self.one_step = replace(integration, integrator="adams_bashforth")
        motion = done.motion
        phi, omega, _, torque_load = integration.course[:, 2 * first :: 2][:, : len(motion)]
        self.phi, self.omega, self.motion = phi, omega, motion
        self.rates = motion[:, 4:8] - omega[:, None] / z  # wheels, output shaft, brake
        self.spins = motion[:, 8:]
        mounts = constants.mounts.reshape(2, _outline.COLUMNS)
        cams = mounts[:, int(_outline.CAM_X)] + 1j * mounts[:, int(_outline.CAM_Y)]
        self.cams: Complex = cams * np.exp(1j * phi)[:, None]  # (n, 2)
        self.pins: Complex = pin_centres(gearbox)
        sleeves = 2 * np.pi * np.arange(gearbox.n_internal_sleeves) / gearbox.n_internal_sleeves
        from_centre = gearbox.internal_pitch_radius * np.exp(1j * sleeves)
        turned = motion[:, :3] - phi[:, None] / z
        self.sleeves: Complex = from_centre * np.exp(1j * turned[:, 2, None])  # (n, n_sleeves)
        # (n, 2, n_sleeves)
        self.holes: Complex = from_centre * np.exp(1j * turned[:, :2, None])
        in_pins, taken_by_pins = self.in_pins()
        in_joints, taken_by_joints = self.in_joints()
        has_brake = gearbox.brake_inertia > 0
        braked_speed = self.rates[:, 3 if has_brake else 2]
        twist, twist_rate = motion[:, 3] - motion[:, 2], motion[:, 7] - motion[:, 6]
        in_meter = 0.5 * gearbox.meter_stiffness * twist**2 if has_brake else 0.0
        # Kinetic and elastic energy, (2, n), and the powers in the order of EnergyAudit, (5, n).
        self.stored = np.array([self.kinetic(), in_pins + in_joints + in_meter])
        self.powers = np.array(
            [
                done.torques[:, 1] * omega,
                -torque_load * braked_speed,
                taken_by_pins + taken_by_joints,
                self.rubbed(done.external, done.internal),
                gearbox.meter_damping * twist_rate**2 * has_brake,
            ]
        )

    def kinetic(self) -> Float:
        """Kinetic energy without that of the input shaft, (n,)."""
        g, rates = self.gearbox, self.rates
        energy = 0.5 * g.wheel_inertia * (rates[:, :2] ** 2).sum(axis=1)
        energy += 0.5 * g.wheel_mass * (np.abs(self.cams) ** 2).sum(axis=1) * self.omega**2
        energy += 0.5 * g.output_inertia * rates[:, 2] ** 2
        energy += 0.5 * g.brake_inertia * rates[:, 3] ** 2
        energy += 0.5 * g.sleeve_inertia * (self.spins**2).sum(axis=1)
        return np.asarray(energy)

    def in_pins(self) -> Float:
        """Energy stored in the contacts of pins and wheels, and power that they dissipate: (2, n)."""
        k = self.constants
        memory = _kernels.new_memory(self.motion[0])
        none: NDArray[np.int64] = np.zeros(0, dtype=int)
        energy_and_power = np.empty((2, self.phi.size))
        for i, (phi, omega, state) in enumerate(zip(self.phi, self.omega, self.motion, strict=True)):
            # One evaluation, after which the memory describes the contacts of this state.
            self.one_step.attempt(state, self.first + i, self.first + i + 1, none, memory=memory)
            energy_and_power[:, i] = _kernels.pin_energy(
                phi, omega, state, k.wheel, k.contact, k.mounts, memory
            )
        return energy_and_power

    def in_joints(self) -> tuple[Float, Float]:
        """Energy stored in the contacts of internal sleeves and holes, and power that they dissipate."""
        law = self.constants.joint_contact
        moving = (1j * self.omega[:, None] * self.cams)[..., None] + 1j * self.rates[:, :2, None] * self.holes
        away = self.sleeves[:, None] - self.cams[..., None] - self.holes
        distance = np.abs(away)
        depth = np.maximum(distance - self.constants.joint.gap_at_centre, 0.0)
        rate = ((1j * self.rates[:, 2, None] * self.sleeves)[:, None] - moving) * np.conj(away) / distance
        d_0 = 1 / law.inverse_ramp
        stiffness = law.stiffness_factor * math.sqrt(law.constant_radius)
        rise = np.minimum(depth / d_0, 1.0)
        elastic = stiffness * rise * depth**1.5
        ramp = np.minimum(depth, d_0)
        stored = stiffness * (ramp**3.5 / d_0 / 3.5 + (depth**2.5 - ramp**2.5) / 2.5)
        damping = law.damping * (elastic if law.law == _kernels.HUNT_CROSSLEY_LAW else rise)
        force = np.maximum(elastic + damping * rate.real, 0.0)
        taken = (force - elastic) * rate.real
        return stored.sum(axis=(1, 2)), taken.sum(axis=(1, 2))

    def rubbed(self, external: Float, internal: Float) -> Float:
        """Power that friction dissipates, (n,), from the normal forces (n, 2, n_sleeves, 3)."""
        g = self.gearbox
        if not g.has_friction:
            return np.zeros(self.phi.size)
        total = np.zeros(self.phi.size)
        for speed, coulomb, viscous in (
            (self.omega, g.input_bearing_torque, g.input_bearing_viscosity),
            (self.rates[:, 2], g.output_bearing_torque, g.output_bearing_viscosity),
        ):
            total += (coulomb * np.tanh(speed / g.bearing_transition_speed) + viscous * speed) * speed
        n = g.n_pins
        still = np.zeros_like(self.rates[:, 2])
        total += self._rubbed(
            external, np.broadcast_to(self.pins, (self.phi.size, n)), g.pin_radius, self.spins[:, :n], still
        )
        total += self._rubbed(
            internal, self.sleeves, g.internal_sleeve_radius, self.spins[:, n:], self.rates[:, 2]
        )
        return total

    def _rubbed(self, forces: Float, centres: Complex, radius: float, spins: Float, turning: Float) -> Float:
        """Power taken at one kind of sleeves, whose axles turn about the origin with ``turning`` (n,)."""
        g = self.gearbox
        vector = forces[..., 1] + 1j * forces[..., 2]
        size = np.abs(vector)
        toward = vector / np.where(size > 0, size, 1.0)  # from the sleeve to the wheel
        cams = self.cams[..., None]
        from_cam = centres[:, None] + radius * toward - cams
        of_wheel = 1j * self.omega[:, None, None] * cams + 1j * self.rates[:, :2, None] * from_cam
        of_sleeve = (1j * turning[:, None] * centres)[:, None] + 1j * spins[:, None] * radius * toward
        slip = ((of_wheel - of_sleeve) * np.conj(1j * toward)).real
        static = g.sleeve_static_friction or g.sleeve_friction
        coefficient = g.sleeve_friction + (static - g.sleeve_friction) * np.exp(
            -((slip / g.stribeck_speed) ** 2)
        )
        rub = coefficient * size * np.tanh(slip / g.friction_transition_speed)
        rub += g.sleeve_viscous_friction * slip * (size > 0)
        on_axle = np.abs((vector - 1j * rub * toward).sum(axis=1))
        turn = spins - turning[:, None]
        drag = g.journal_friction * radius * on_axle * np.tanh(turn * radius / g.friction_transition_speed)
        return np.asarray((rub * slip).sum(axis=(1, 2)) + (drag * turn).sum(axis=1))
