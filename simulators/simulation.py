"""Run the reduced gearbox model: from parameters to torque records."""

from __future__ import annotations

import functools
import math
from collections.abc import Iterator
from dataclasses import dataclass, field, fields, replace
from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.signal import firwin, resample_poly

from cyclofeat.simulators import _kernels, _outline
from cyclofeat.simulators._chatter import friction_rates, warn_of_chatter
from cyclofeat.simulators._checks import check_number, check_type
from cyclofeat.simulators._lines import on_lines
from cyclofeat.simulators.contact import contact_constants, joint_effective_radius, pin_centres
from cyclofeat.simulators.courses import MARGIN, TimeCourse, drive_and_load
from cyclofeat.simulators.gearbox import CycloidalGearbox, LobeDefects, machine
from cyclofeat.simulators.tolerances import AssemblyTolerances

Float = NDArray[np.float64]
Complex = NDArray[np.complex128]

# Beyond any torque that the papers' machine could bear; a healthy run stays below 30 Nm.
ABSURD_TORQUE = 1e4
# The machine counts as wedged where the drive has to overcome so much force (N) on a cam for so long (s): an
# impact on a stiff contact is shorter, a diverging integration grows beyond all bounds sooner.
LOCKING_FORCE = 2e4
LOCKING_TIME = 1e-3
_STAGES = {"midpoint": 2, "adams_bashforth": 1}
_RELAXATION_ROUNDS = 3000
# Instants of a run at which friction is held against the time step.
_N_WATCHED = 128
# A step takes about 100 bytes of memory while it is simulated: 100 million are 1000 s and 10 GB.
LARGEST_N_STEPS = 100_000_000


class SimulationFailed(RuntimeError):
    """A run that did not reach its end.

    Attributes
    ----------
    time : float
        Time in s at which it ended.
    contact : str
        Contact with the largest force at that time.
    """

    time: float
    contact: str


class SimulationDiverged(SimulationFailed):
    """The integration left the range of finite, sensible values.

    Attributes
    ----------
    time : float
        Time of the divergence in s.
    contact : str
        Contact with the largest force at that time.
    """

    def __init__(self, time: float, contact: str, force: float, dt: float) -> None:
        self.time = time
        self.contact = contact
        self._given = (time, contact, force, dt)
        super().__init__(
            f"simulation diverged at t = {time:.6f} s: {contact} reached {force:.3g} N with dt = {dt:g} s; "
            f"use a smaller dt (try {dt / 4:g} s) or a softer contact (smaller stiffness_scale)"
        )

    def __reduce__(self) -> tuple[Any, ...]:
        # An exception is rebuilt from its message by default; this one comes back from other processes whole.
        return type(self), self._given


class GearboxLocked(SimulationFailed):
    """The gearbox wedged: the drive had to overcome more than 20 kN on a cam for a millisecond.

    Attributes
    ----------
    time : float
        Time of the locking in s.
    contact : str
        Contact with the largest force at that time.
    force : float
        That force in N.
    """

    def __init__(self, time: float, contact: str, force: float) -> None:
        self.time = time
        self.contact = contact
        self.force = force
        super().__init__(
            f"the gearbox locks at t = {time:.6f} s: {contact} carries {force:.3g} N and the drive has had "
            f"to overcome more than {LOCKING_FORCE / 1e3:g} kN for {LOCKING_TIME * 1e3:g} ms; this is a "
            "result, not a numerical failure"
        )

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.time, self.contact, self.force)


@dataclass(frozen=True)
class SimulationRun:
    """Result of :func:`simulate`.

    Attributes
    ----------
    gearbox : CycloidalGearbox
    defects : LobeDefects
    sampling_rate : float
        Samples per second of all arrays below.
    torque_out : ndarray, shape (n,)
        Torque in Nm that resists the output: in the meter where there is a brake, else the moment of the
        internal sleeves on the output shaft.
    torque_in : ndarray, shape (n,), or None
        Moment of the cams' reactions about the input shaft, in Nm (paper B fig. 5). None where not asked for.
    input_angle : ndarray, shape (n,)
        Angle phi of the input shaft in rad; 0 is cam 0 at pin 0.
    output_angle, output_speed : ndarray, shape (n,), or None
        Angle psi of the output shaft in rad and its rate in rad/s (the tachometer of paper A); it turns
        against the input. None where not asked for.
    external_forces : ndarray, shape (n, 2, n_pins) or None
        Normal force between each wheel and each external sleeve, in N. None where not asked for.
    internal_forces : ndarray, shape (n, 2, n_internal_sleeves) or None
        Normal force between each wheel and each internal sleeve, in N. None where not asked for.
    external_points, internal_points : complex ndarray of the forces' shapes, or None
        Place x + iy in m, in the fixed frame, where each sleeve touches each wheel; NaN where it does not. A
        sleeve that touches twice (at a worn lobe's pit) has one point, in the direction of the resulting
        force. None where not asked for.
    dt : float
        Integration step in s.
    seed : int or None
        Seed from which the assembly's errors were drawn, for the record.
    """

    gearbox: CycloidalGearbox
    defects: LobeDefects
    sampling_rate: float
    torque_out: Float = field(repr=False)
    torque_in: Float | None = field(repr=False)
    input_angle: Float = field(repr=False)
    output_angle: Float | None = field(repr=False, default=None)
    output_speed: Float | None = field(repr=False, default=None)
    external_forces: Float | None = field(repr=False, default=None)
    internal_forces: Float | None = field(repr=False, default=None)
    external_points: Complex | None = field(repr=False, default=None)
    internal_points: Complex | None = field(repr=False, default=None)
    dt: float = 1e-5
    seed: int | None = None

    @property
    def time(self) -> Float:
        """Time of each sample in s, shape (n,)."""
        return np.arange(self.torque_out.size) / self.sampling_rate


@dataclass(frozen=True)
class KernelInput:
    """Constants and tables of one gearbox with its defects, as the kernel takes them."""

    wheel: _outline.WheelConstants
    joint: _kernels.JointConstants
    contact: _kernels.ContactConstants
    joint_contact: _kernels.ContactConstants
    body: _kernels.BodyConstants
    friction: _kernels.FrictionConstants | None
    pins: Float
    mounts: Float
    lobes: Float
    wear: Float
    sleeves: Float

    def __iter__(self) -> Iterator[Any]:
        return (getattr(self, f.name) for f in fields(self))


def kernel_input(gearbox: CycloidalGearbox, defects: LobeDefects) -> KernelInput:
    """Translate parameters into the kernel's constants and tables."""
    profile = gearbox.outline_profile
    n_pins, n_lobes = gearbox.n_pins, gearbox.n_lobes
    tip, pit = profile.chord()
    pit_angle = math.pi / n_lobes
    pit_normal = complex(profile.normal(pit_angle))
    pin_errors = np.hypot(gearbox.pin_radial_errors or [0.0], gearbox.pin_tangential_errors or [0.0])
    wheel = _outline.WheelConstants(
        eccentricity=float(gearbox.eccentricity),
        shortening=float(gearbox.shortening),
        n_lobes=int(n_lobes),
        pin_radius=float(gearbox.pin_radius),
        pin_circle_radius=float(gearbox.pin_circle_radius),
        clearance=float(gearbox.pin_clearance),
        tip_x=tip.real,
        pit_x=pit.real,
        pit_y=pit.imag,
        pit_nx=pit_normal.real,
        pit_ny=pit_normal.imag,
        tip_radius=float(gearbox.profile.effective_radius(0.0, gearbox.pin_clearance)),
        pit_radius=float(gearbox.profile.effective_radius(pit_angle, gearbox.pin_clearance)),
        near=max(0.7 / abs(float(profile.curvature(pit_angle))) - float(pin_errors.max()), 0.0),
        has_pitch_errors=any(gearbox.lobe_pitch_errors),
        profile_points=gearbox.profile_points,
    )
    joint = _kernels.JointConstants(
        n_sleeves=gearbox.n_internal_sleeves,
        sleeve_radius=float(gearbox.internal_sleeve_radius),
        pitch_radius=float(gearbox.internal_pitch_radius),
        gap_at_centre=float(gearbox.eccentricity + gearbox.clearance),
    )
    body = _kernels.BodyConstants(
        wheel_mass=float(gearbox.wheel_mass),
        wheel_inertia=float(gearbox.wheel_inertia),
        output_inertia=float(gearbox.output_inertia),
        brake_inertia=float(gearbox.brake_inertia),
        meter_stiffness=float(gearbox.meter_stiffness),
        meter_damping=float(gearbox.meter_damping),
    )
    pin_angles = 2 * np.pi * np.arange(n_pins) / n_pins
    pins = np.zeros(_outline.PIN_TABLE_SIZE)
    for row, values in (
        (_outline.PIN_COS, np.cos(pin_angles)),
        (_outline.PIN_SIN, np.sin(pin_angles)),
        (_outline.PIN_RADIAL_ERROR, gearbox.pin_radial_errors or 0.0),
        (_outline.PIN_TANGENTIAL_ERROR, gearbox.pin_tangential_errors or 0.0),
        (_outline.PIN_ANGLE, pin_angles),
    ):
        pins[int(row) : int(row) + n_pins] = values
    sleeve_angles = 2 * np.pi * np.arange(gearbox.n_internal_sleeves) / gearbox.n_internal_sleeves
    lobe_angles = 2 * np.pi * np.arange(n_lobes) / n_lobes
    wear = np.zeros((2, n_lobes))
    for w in defects.wheels:
        wear[w, list(defects.worn_lobes)] = defects.depth
        wear[w, list(defects.removed_lobes)] = _outline.REMOVED
    # The wheels are mounted 180 deg apart as closely as their lobes allow (exactly, where z_s is odd).
    rest = np.array([-math.pi / n_lobes, 2 * math.pi * ((n_lobes + 1) // 2 - 1) / n_lobes])
    runouts = np.asarray(gearbox.wheel_runouts or (0j, 0j), dtype=complex)
    faults = (wear > 0).any(axis=1)
    cams = gearbox.eccentricity * np.array([1, -1]) + np.asarray(gearbox.cam_errors or (0j, 0j))
    mounts = np.column_stack(
        [rest, np.cos(rest), np.sin(rest), runouts.real, runouts.imag, cams.real, cams.imag, faults]
    )
    pitch_errors = np.reshape(gearbox.lobe_pitch_errors or np.zeros(2 * n_lobes), (2, n_lobes))
    sleeves = np.zeros(_kernels.SLEEVE_TABLE_SIZE)
    for row, values in (
        (_kernels.SLEEVE_COS, np.cos(sleeve_angles)),
        (_kernels.SLEEVE_SIN, np.sin(sleeve_angles)),
    ):
        sleeves[int(row) : int(row) + gearbox.n_internal_sleeves] = values
    return KernelInput(
        wheel=wheel,
        joint=joint,
        # The conservative law takes the pin's own radius, as on a plane flank, for every pin contact.
        contact=contact_constants(gearbox, gearbox.pin_radius),
        joint_contact=contact_constants(gearbox, joint_effective_radius(gearbox)),
        body=body,
        friction=_friction(gearbox),
        pins=pins,
        mounts=mounts,
        lobes=np.vstack([np.cos(lobe_angles), np.sin(lobe_angles), pitch_errors / gearbox.pin_circle_radius]),
        wear=wear,
        sleeves=sleeves,
    )


def _friction(gearbox: CycloidalGearbox) -> _kernels.FrictionConstants | None:
    if not gearbox.has_friction:
        return None
    return _kernels.FrictionConstants(
        coulomb=float(gearbox.sleeve_friction),
        static=float(gearbox.sleeve_static_friction or gearbox.sleeve_friction),
        stribeck_speed=float(gearbox.stribeck_speed),
        viscous=float(gearbox.sleeve_viscous_friction),
        journal=float(gearbox.journal_friction),
        transition_speed=float(gearbox.friction_transition_speed),
        input_coulomb=float(gearbox.input_bearing_torque),
        input_viscous=float(gearbox.input_bearing_viscosity),
        output_coulomb=float(gearbox.output_bearing_torque),
        output_viscous=float(gearbox.output_bearing_viscosity),
        bearing_transition=float(gearbox.bearing_transition_speed),
        sleeve_inertia=float(gearbox.sleeve_inertia),
    )


def rest_state(gearbox: CycloidalGearbox) -> Float:
    """The kernel's state at the rest position, nothing moving."""
    n_spins = gearbox.n_pins + gearbox.n_internal_sleeves if gearbox.has_friction else 0
    return np.zeros(_kernels.N_STATE + n_spins)


def simulate(
    gearbox: CycloidalGearbox | None = None,
    defects: LobeDefects | None = None,
    *,
    duration: float = 0.6,
    dt: float = 1e-5,
    sampling_rate: float = 25_600.0,
    seed: int | None = None,
    tolerances: AssemblyTolerances | None = None,
    start_angle: float = 0.0,
    start: str = "rest",
    speed: TimeCourse | None = None,
    load: TimeCourse | None = None,
    speed_fluctuation: TimeCourse | None = None,
    load_fluctuation: TimeCourse | None = None,
    decimation: str = "antialias",
    integrator: str = "midpoint",
    torque_in: bool = True,
    motion: bool = True,
    forces: bool = False,
    points: bool = False,
) -> SimulationRun:
    """Simulate the gearbox from rest.

    Planar multibody model of paper B in its exact reduction: the input angle is prescribed, two wheels, the
    output shaft and, where there is one, the brake's rotor move; midpoint rule (second-order Runge-Kutta).

    Parameters
    ----------
    gearbox : CycloidalGearbox, default ``CycloidalGearbox.steel()``
    defects : LobeDefects, default healthy
    duration : float
        Simulated time in s, the ramp included.
    dt : float
        Integration step in s.
    sampling_rate : float
        Samples per second of the result. At most ``1 / dt``.
    seed : int, optional
        Seed of the assembly's random errors; without ``tolerances`` the run has no random part and the seed
        is only recorded.
    tolerances : AssemblyTolerances, optional
        Tolerances from which this assembly's errors are drawn with ``seed``.
    start_angle : float
        Input angle at t = 0 in rad.
    start : {"rest", "relaxed"}
        Where wheels and output begin: at the ideal rest position, where displaced pins or a worn lobe may be
        pressed in, or relaxed until the contacts balance the load at the start.
    speed, load : float, array or function of time, optional
        Input speed in rad/s and load torque in Nm in place of the gearbox's. A number is reached over the
        ramp, like the gearbox's own; an array (one value per sample of the result, joined by straight lines)
        or a function (takes times of shape (n,) in s, returns as many values) is taken as it is.
    speed_fluctuation, load_fluctuation : float, array or function of time, optional
        Added to input speed (rad/s) and load torque (Nm), under the ramp; as above.
    decimation : {"antialias", "pick"}
        How the integration's samples become the result's: through an anti-alias filter, or by picking every
        k-th as the papers do (``1 / (dt sampling_rate)`` must then be a whole number).
    integrator : {"midpoint", "adams_bashforth"}
        The papers' midpoint rule (second-order Runge-Kutta), or the second-order Adams-Bashforth rule, which
        takes half the time. Its error at the same step is two and a half to three times as large
        (``make bench-simulator``), at half the step, which costs as much, a quarter of that; its limit of
        stability is nearer.
    torque_in : bool
        Whether to keep the moment about the input shaft.
    motion, forces, points : bool
        Whether to keep angle and speed of the output, the force of every sleeve, and where it touches. These
        are always picked, never filtered.

    Returns
    -------
    SimulationRun

    Raises
    ------
    SimulationDiverged
        Where the integration diverges; says when, which contact, and what helps.
    GearboxLocked
        Where the gearbox wedges: the drive has to overcome more than 20 kN on a cam for a millisecond.
    TypeError, ValueError
        For arguments of the wrong type or outside their range.

    Warns
    -----
    RuntimeWarning
        Where friction is so steep that it chatters at this ``dt``: see ``friction_transition_speed`` of
        :class:`CycloidalGearbox`.

    Examples
    --------
    >>> run = simulate(CycloidalGearbox.steel(), LobeDefects.worn(1), duration=0.3)
    >>> run.torque_out.shape
    (7680,)
    """
    gearbox, defects = machine(gearbox, defects)
    for name, value in (("duration", duration), ("dt", dt), ("sampling_rate", sampling_rate)):
        check_number(name, value)
        if not (math.isfinite(value) and value > 0):
            raise ValueError(f"{name} must be positive and finite, got {value!r}")
    check_number("start_angle", start_angle)
    if not math.isfinite(start_angle):
        raise ValueError(f"start_angle must be finite (rad), got {start_angle!r}")
    if sampling_rate * dt > 1 + 1e-9:
        raise ValueError(f"sampling_rate must not exceed 1/dt = {1 / dt:g} Hz, got {sampling_rate:g} Hz")
    if decimation not in ("antialias", "pick"):
        raise ValueError(f"decimation must be 'antialias' or 'pick', got {decimation!r}")
    if integrator not in tuple(_STAGES):  # which, unlike a dict, may be asked for anything
        raise ValueError(f"integrator must be one of {tuple(_STAGES)}, got {integrator!r}")
    if start not in ("rest", "relaxed"):
        raise ValueError(f"start must be 'rest' or 'relaxed', got {start!r}")
    if tolerances is not None:
        check_type("tolerances", tolerances, AssemblyTolerances)
        if seed is None:
            raise ValueError("seed must be given with tolerances, so that the assembly can be made again")
        gearbox = tolerances.draw(gearbox, seed)
    n_samples = round(duration * sampling_rate)
    if n_samples < 1:
        raise ValueError(f"duration {duration:g} s is shorter than one sample at {sampling_rate:g} Hz")
    ratio = Fraction(sampling_rate * dt).limit_denominator(100_000)
    if decimation == "pick" and ratio.numerator != 1:
        raise ValueError(
            f"sampling_rate must divide 1/dt = {1 / dt:g} Hz with decimation='pick', got {sampling_rate:g} Hz"
        )
    # The anti-alias filter pads with zeros: right at the start, which is at rest; at the end it falls on the
    # samples simulated beyond it.
    n_steps = math.ceil((n_samples + MARGIN) / ratio)
    if n_steps > LARGEST_N_STEPS:
        raise ValueError(
            f"duration {duration:g} s takes {n_steps:.3g} steps of dt = {dt:g} s, more than "
            f"{LARGEST_N_STEPS:g}: simulate shorter runs"
        )
    course = drive_and_load(
        gearbox, 2 * n_steps + 1, dt / 2, sampling_rate, start_angle=start_angle, speed=speed, load=load,
        speed_fluctuation=speed_fluctuation, load_fluctuation=load_fluctuation,
    )  # fmt: skip
    phi, omega = course[:2]
    time = np.arange(n_samples) / sampling_rate
    steps = np.minimum(np.rint(time / dt).astype(int), n_steps - 1)
    state = rest_state(gearbox)
    constants = kernel_input(gearbox, defects)
    if start == "relaxed":
        state = _relaxed(gearbox, constants, phi[0], course[3, 0], dt, state)
    watched = steps[:: max(steps.size // _N_WATCHED, 1)] if gearbox.has_friction else steps[:0]
    kept = steps if motion or forces or points else watched
    done = _integrated(
        gearbox, constants, course, dt, state, n_steps, kept, forces or points, _STAGES[integrator]
    )
    finished = done.finished
    if finished < n_steps:
        contact, force = _largest_contact(done.last_external, done.last_internal)
        if np.all(np.abs(done.torques[: finished + 1]) < ABSURD_TORQUE):
            raise GearboxLocked(finished * dt, contact, force)
        raise SimulationDiverged(finished * dt, contact, force, dt)

    if gearbox.has_friction:
        states = done.motion[np.searchsorted(kept, watched)]
        warn_of_chatter(_friction_rates(gearbox, constants, course, dt, states, watched), dt, integrator)
    channels = done.torques.T if torque_in else done.torques.T[:1]
    if decimation == "pick" or ratio == 1:
        torques = [channel[steps] for channel in channels]
    else:
        up, down = ratio.numerator, ratio.denominator
        low_pass = _anti_alias_filter(up, down)
        torques = [resample_poly(channel, up, down, window=low_pass)[:n_samples] for channel in channels]
    # Every sample falls on a half step or between two: the driver is smooth there.
    input_angle = on_lines(time, np.arange(phi.size) * (dt / 2), phi)
    z = gearbox.n_lobes
    kept_phi, kept_omega = phi[2 * kept], omega[2 * kept]
    external, internal = done.external, done.internal
    return SimulationRun(
        gearbox=gearbox,
        defects=defects,
        sampling_rate=float(sampling_rate),
        torque_out=np.ascontiguousarray(torques[0]),
        torque_in=np.ascontiguousarray(torques[1]) if torque_in else None,
        input_angle=input_angle,
        output_angle=done.motion[:, 2] - input_angle / z if motion else None,
        output_speed=done.motion[:, 6] - kept_omega / z if motion else None,
        external_forces=np.ascontiguousarray(external[..., 0]) if forces else None,
        internal_forces=np.ascontiguousarray(internal[..., 0]) if forces else None,
        external_points=_external_points(gearbox, external) if points else None,
        internal_points=(
            _internal_points(gearbox, internal, done.motion[:, 2] - kept_phi / z) if points else None
        ),
        dt=dt,
        seed=seed,
    )


class _Integrated(NamedTuple):
    """What the kernel leaves behind."""

    finished: int
    state: Float
    torques: Float
    motion: Float
    external: Float
    internal: Float
    last_external: Float
    last_internal: Float


def _integrated(
    gearbox: CycloidalGearbox,
    constants: KernelInput,
    course: Float,
    dt: float,
    state: Float,
    n_steps: int,
    kept: NDArray[np.int64],
    forces: bool,
    stages: int = 2,
) -> _Integrated:
    """Run the kernel from ``state``, which stays as it is."""
    torques = np.empty((n_steps, _kernels.N_RESULT))
    motion = np.empty((kept.size, state.size))
    last_external = np.zeros((2, gearbox.n_pins, 3))
    last_internal = np.zeros((2, gearbox.n_internal_sleeves, 3))
    n_rows = kept.size if forces else 0
    external = np.empty((n_rows, *last_external.shape))
    internal = np.empty((n_rows, *last_internal.shape))
    state = state.copy()
    finished = _kernels.integrate(
        stages, n_steps, dt, *course, state, *constants, ABSURD_TORQUE, gearbox.eccentricity * LOCKING_FORCE,
        LOCKING_TIME / dt, torques, kept, motion, external, internal, last_external, last_internal,
    )  # fmt: skip
    return _Integrated(
        finished, state, torques, motion, external, internal, last_external[..., 0], last_internal[..., 0]
    )


def _friction_rates(
    gearbox: CycloidalGearbox,
    constants: KernelInput,
    course: Float,
    dt: float,
    states: Float,
    steps: NDArray[np.int64],
) -> Float:
    """Rates in 1/s at which friction damps in these states, which are those at the beginning of ``steps``."""
    first: NDArray[np.int64] = np.zeros(1, dtype=int)
    again = [
        _integrated(gearbox, constants, course[:, 2 * step : 2 * step + 3], dt, state, 1, first, True)
        for step, state in zip(steps, states, strict=True)
    ]
    external = np.concatenate([one.external for one in again])
    internal = np.concatenate([one.internal for one in again])
    phi, omega = course[:2, 2 * steps]
    return friction_rates(gearbox, phi, omega, states, external, internal)


def _relaxed(
    gearbox: CycloidalGearbox,
    constants: KernelInput,
    angle: float,
    load: float,
    dt: float,
    state: Float,
) -> Float:
    """State in which the contacts balance the load at the start, the drive held still.

    Motion is stopped again and again (kinetic damping) until the forces of rest are left. A brake's heavy
    rotor would take far too long: the load acts on the output shaft until then, and the meter bears it after.
    """
    n_steps = 10
    constants = replace(constants, body=constants.body._replace(brake_inertia=0.0))
    held = np.repeat([[angle], [0.0], [0.0], [load]], 2 * n_steps + 1, axis=1)
    none: NDArray[np.int64] = np.zeros(0, dtype=int)
    for _ in range(_RELAXATION_ROUNDS):
        before = state
        done = _integrated(gearbox, constants, held, dt, state, n_steps, none, False)
        state = done.state
        state[4:] = 0.0
        if np.abs(state - before).max() < 1e-12:
            break
    if gearbox.brake_inertia > 0:
        state[3] = state[2] + load / gearbox.meter_stiffness
    return state


@functools.cache
def _anti_alias_filter(up: int, down: int) -> Float:
    """Low-pass for ``resample_poly``: its own design, with the same gain at 0 Hz in each of its phases.

    By that design the phases' gains differ by some 1e-5, which puts a comb of 0.4 mNm on 22 Nm.
    """
    largest = max(up, down)
    taps = firwin(20 * largest + 1, 1 / largest, window=("kaiser", 5.0))
    for phase in range(up):
        taps[phase::up] /= taps[phase::up].sum() * up
    taps.setflags(write=False)
    return np.asarray(taps)


def _external_points(gearbox: CycloidalGearbox, external: Float) -> Complex:
    """Where each pin touches each wheel: a pin's radius from its centre, against the force on the wheel."""
    return _points(pin_centres(gearbox), gearbox.pin_radius, external)


def _internal_points(gearbox: CycloidalGearbox, internal: Float, output_angle: Float) -> Complex:
    angles = 2 * np.pi * np.arange(gearbox.n_internal_sleeves) / gearbox.n_internal_sleeves
    centres = gearbox.internal_pitch_radius * np.exp(1j * (angles + output_angle[:, None, None]))
    return _points(centres, gearbox.internal_sleeve_radius, internal)


def _points(centres: Complex, radius: float, forces: Float) -> Complex:
    vector = forces[..., 1] + 1j * forces[..., 2]
    size = np.abs(vector)
    with np.errstate(invalid="ignore"):  # no force, no point
        return np.where(size > 0, centres + radius * vector / size, np.nan)


def _largest_contact(external: Float, internal: Float) -> tuple[str, float]:
    """Name and force of the contact that carries most, or of the first whose force is not a number."""
    name, force = "", -1.0
    for kind, forces in (("external", external), ("internal", internal)):
        values = np.where(np.isfinite(forces), forces, np.inf)
        wheel, sleeve = np.unravel_index(int(np.argmax(values)), values.shape)
        if values[wheel, sleeve] > force:
            name = f"the contact of wheel {wheel} with {kind} sleeve {sleeve} (counted from 0)"
            force = float(values[wheel, sleeve])
    return name, force
