"""Where the energy of a run goes: the drive's work against load, stored energy and losses."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cyclofeat.simulators import _kernels, _outline
from cyclofeat.simulators._checks import check_number
from cyclofeat.simulators.contact import pin_centres
from cyclofeat.simulators.courses import TimeCourse, drive_and_load
from cyclofeat.simulators.gearbox import CycloidalGearbox, LobeDefects, machine
from cyclofeat.simulators.simulation import (
    ABSURD_TORQUE,
    Complex,
    Float,
    GearboxLocked,
    KernelInput,
    SimulationDiverged,
    _integrated,
    _largest_contact,
    kernel_input,
    rest_state,
)

# Steps whose forces and motion are held at once: some 15 MB.
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
        """What does not balance: negative where energy came from nothing."""
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
    speed: TimeCourse | None = None,
    load: TimeCourse | None = None,
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
        Where the stretch begins in s; the run itself begins at 0, from rest.
    start_angle : float
        Input angle at t = 0 in rad.
    speed, load : float, array or function of time, optional
        As in :func:`~cyclofeat.simulators.simulate`; an array holds one value per step.

    Returns
    -------
    EnergyAudit

    Raises
    ------
    SimulationDiverged, GearboxLocked
        As :func:`~cyclofeat.simulators.simulate`.
    ValueError
        For times that are not finite or out of range.

    Notes
    -----
    The energy stored in a contact of effective radius R is the integral of its elastic force (paper B
    eq. 11-14 with the ramp of eq. 12 up to d_0),

        U(d, R) = k sqrt(R) d^3.5 / (3.5 d_0)                                  for d < d_0,
        U(d, R) = k sqrt(R) (d_0^2.5 / 3.5 + (d^2.5 - d_0^2.5) / 2.5)          beyond,

    k = K / sqrt(R). The contact gives back what it took only where R does not change under load. Paper B lets
    R follow the curvature, so that U changes by (dU/dR) R' without work as a contact moves along the flank:
    this law makes about 1 % of the power from nothing, which is the leak. ``contact_law="conservative"``
    has none.

    Powers are evaluated at every step and summed by the trapezoid rule. The input shaft's own inertia is
    left out, as in torque_in.

    Examples
    --------
    >>> audit = energy_audit(CycloidalGearbox.steel(contact_law="conservative"))
    >>> abs(audit.relative_leak) < 1e-3
    True
    >>> round(energy_audit().relative_leak, 4)
    -0.0095
    """
    gearbox, defects = machine(gearbox, defects)
    for name, value in (("duration", duration), ("dt", dt)):
        check_number(name, value)
        if not (math.isfinite(value) and value > 0):
            raise ValueError(f"{name} must be positive and finite, got {value!r}")
    check_number("start_time", start_time)
    if not (math.isfinite(start_time) and start_time >= 0):
        raise ValueError(f"start_time must be finite and not negative (s), got {start_time!r}")
    first, n_steps = round(start_time / dt), max(round(duration / dt), 1)
    last = first + n_steps
    course = drive_and_load(
        gearbox, 2 * last + 3, dt / 2, 1 / dt, start_angle=start_angle, speed=speed, load=load
    )
    constants = kernel_input(gearbox, defects)
    state = rest_state(gearbox)
    if first > 0:
        state, *_ = _run(gearbox, constants, course, dt, state, 0, first, False)
    stored: list[Float] = []
    powers: list[Float] = []
    # One step more than there are: the energies at the end belong to a step's beginning.
    for begin in range(first, last + 1, _BLOCK):
        end = min(begin + _BLOCK, last + 1)
        state, motion, torques, external, internal = _run(
            gearbox, constants, course, dt, state, begin, end, True
        )
        phi, omega, _, torque_load = course[:, 2 * begin : 2 * end : 2]
        account = _Account(gearbox, constants, phi, omega, motion)
        in_pins, taken_by_pins = account.in_pins()
        in_joints, taken_by_joints = account.in_joints()
        stored.append(np.array([account.kinetic(), in_pins + in_joints + account.stored_in_meter()]))
        powers.append(
            np.array(
                [
                    torques[:, 1] * omega,
                    -torque_load * account.braked_speed,
                    taken_by_pins + taken_by_joints,
                    account.rubbed(external, internal),
                    account.damped_in_meter(),
                ]
            )
        )
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


def _run(
    gearbox: CycloidalGearbox,
    constants: KernelInput,
    course: Float,
    dt: float,
    state: Float,
    begin: int,
    end: int,
    keep: bool,
) -> tuple[Float, Float, Float, Float, Float]:
    """Steps ``begin`` to ``end``: the state after them and, at each, motion, torques and forces."""
    part = course[:, 2 * begin : 2 * end + 1]
    n_steps = end - begin
    kept: NDArray[np.int64] = np.arange(n_steps if keep else 0)
    done = _integrated(gearbox, constants, part, dt, state, n_steps, kept, keep)
    if done.finished < n_steps:
        time = (begin + done.finished) * dt
        contact, force = _largest_contact(done.last_external, done.last_internal)
        if np.all(np.abs(done.torques[: done.finished + 1]) < ABSURD_TORQUE):
            raise GearboxLocked(time, contact, force)
        raise SimulationDiverged(time, contact, force, dt)
    return done.state, done.motion, done.torques, done.external, done.internal


class _Account:
    """Energies in J and powers in W at n instants, from the kernel's states (n, n_state)."""

    def __init__(
        self, gearbox: CycloidalGearbox, constants: KernelInput, phi: Float, omega: Float, motion: Float
    ) -> None:
        z = gearbox.n_lobes
        self.gearbox, self.constants = gearbox, constants
        self.phi, self.omega, self.motion = phi, omega, motion
        self.rates = motion[:, 4:8] - omega[:, None] / z  # wheels, output shaft, brake
        self.spins = motion[:, 8:]
        mounts = constants.mounts
        cams = mounts[:, _outline.CAM_X] + 1j * mounts[:, _outline.CAM_Y]
        self.cams: Complex = cams * np.exp(1j * phi)[:, None]  # (n, 2)
        self.pins: Complex = pin_centres(gearbox)
        sleeves = 2 * np.pi * np.arange(gearbox.n_internal_sleeves) / gearbox.n_internal_sleeves
        from_centre = gearbox.internal_pitch_radius * np.exp(1j * sleeves)
        turned = motion[:, :3] - phi[:, None] / z
        self.sleeves: Complex = from_centre * np.exp(1j * turned[:, 2, None])  # (n, n_sleeves)
        # (n, 2, n_sleeves)
        self.holes: Complex = from_centre * np.exp(1j * turned[:, :2, None])

    @property
    def braked_speed(self) -> Float:
        """Speed of the shaft that the load acts on, in rad/s."""
        return self.rates[:, 3 if self.gearbox.brake_inertia > 0 else 2]

    def kinetic(self) -> Float:
        """Kinetic energy of all that moves except the input shaft, (n,)."""
        g, rates = self.gearbox, self.rates
        energy = 0.5 * g.wheel_inertia * (rates[:, :2] ** 2).sum(axis=1)
        energy += 0.5 * g.wheel_mass * (np.abs(self.cams) ** 2).sum(axis=1) * self.omega**2
        energy += 0.5 * g.output_inertia * rates[:, 2] ** 2
        energy += 0.5 * g.brake_inertia * rates[:, 3] ** 2
        energy += 0.5 * g.sleeve_inertia * (self.spins**2).sum(axis=1)
        return np.asarray(energy)

    def stored_in_meter(self) -> Float:
        twist = self.motion[:, 3] - self.motion[:, 2]
        return 0.5 * self._meter(self.gearbox.meter_stiffness) * twist**2

    def damped_in_meter(self) -> Float:
        return self._meter(self.gearbox.meter_damping) * (self.motion[:, 7] - self.motion[:, 6]) ** 2

    def _meter(self, value: float) -> float:
        return value if self.gearbox.brake_inertia > 0 else 0.0

    def in_pins(self) -> Float:
        """Energy stored in the contacts of pins and wheels, and power that they take: (2, n)."""
        k, z = self.constants, self.gearbox.n_lobes
        memory = _kernels.new_memory(self.spins.shape[1])
        rates, result = np.empty(self.motion.shape[1]), np.empty(_kernels.N_RESULT)
        slow = self.phi / z
        found = np.empty((2, self.phi.size))
        for i, (phi, omega, state) in enumerate(zip(self.phi, self.omega, self.motion, strict=True)):
            _kernels.derivatives(
                phi, math.cos(phi), math.sin(phi), math.cos(slow[i]), -math.sin(slow[i]), omega, 0.0, 0.0,
                state, *k, memory, rates, result,
            )  # fmt: skip
            found[:, i] = _kernels.pin_energy(phi, omega, state, k.wheel, k.contact, k.mounts, memory)
        return found

    def in_joints(self) -> tuple[Float, Float]:
        """The same for internal sleeves and holes."""
        law, moving = self.constants.joint_contact, self._velocity_of_holes()
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

    def _velocity_of_holes(self) -> Complex:
        return (1j * self.omega[:, None] * self.cams)[..., None] + 1j * self.rates[:, :2, None] * self.holes

    def rubbed(self, external: Float, internal: Float) -> Float:
        """Power that friction takes, from the normal forces (n, 2, n_sleeves, 3): (n,)."""
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
