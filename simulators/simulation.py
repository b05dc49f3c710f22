"""Run the reduced gearbox model: from parameters to torque records."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, fields
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.signal import resample_poly

from cyclofeat.simulators import _kernels
from cyclofeat.simulators.contact import contact_constants, joint_effective_radius
from cyclofeat.simulators.gearbox import CycloidalGearbox, LobeDefects
from cyclofeat.simulators.tolerances import AssemblyTolerances

Float = NDArray[np.float64]
Load = float | ArrayLike | Callable[[Float], ArrayLike]

# Beyond any torque that the papers' machine could bear; a healthy run stays below 30 Nm.
ABSURD_TORQUE = 1e4
_FILTER_MARGIN = 40  # samples of the result
# A step takes about 100 bytes of memory while it is simulated: 100 million are 1000 s and 10 GB.
LARGEST_N_STEPS = 100_000_000


class SimulationDiverged(RuntimeError):
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
    torque_in : ndarray, shape (n,)
        Moment of the cams' reactions about the input shaft, in Nm (paper B fig. 5).
    input_angle : ndarray, shape (n,)
        Angle phi of the input shaft in rad; 0 is cam 0 at pin 0.
    output_angle : ndarray, shape (n,)
        Angle psi of the output shaft in rad; it turns against the input.
    external_forces : ndarray, shape (n, 2, n_pins) or None
        Normal force between each wheel and each external sleeve, in N. None where not asked for.
    internal_forces : ndarray, shape (n, 2, n_internal_sleeves) or None
        Normal force between each wheel and each internal sleeve, in N. None where not asked for.
    dt : float
        Integration step in s.
    seed : int or None
        Seed from which the assembly's errors were drawn, for the record.
    """

    gearbox: CycloidalGearbox
    defects: LobeDefects
    sampling_rate: float
    torque_out: Float = field(repr=False)
    torque_in: Float = field(repr=False)
    input_angle: Float = field(repr=False)
    output_angle: Float = field(repr=False)
    external_forces: Float | None = field(repr=False, default=None)
    internal_forces: Float | None = field(repr=False, default=None)
    dt: float = 1e-5
    seed: int | None = None

    @property
    def time(self) -> Float:
        """Time of each sample in s, shape (n,)."""
        return np.arange(self.torque_out.size) / self.sampling_rate


@dataclass(frozen=True)
class KernelInput:
    """Constants and tables of one gearbox with its defects, as the kernel takes them."""

    wheel: _kernels.WheelConstants
    joint: _kernels.JointConstants
    contact: _kernels.ContactConstants
    joint_contact: _kernels.ContactConstants
    body: _kernels.BodyConstants
    pins: Float
    mounts: Float
    lobes: Float
    wear: Float
    sleeves: Float

    def __iter__(self) -> Iterator[Any]:
        return (getattr(self, f.name) for f in fields(self))


def kernel_input(gearbox: CycloidalGearbox, defects: LobeDefects) -> KernelInput:
    """Translate parameters into the kernel's constants and tables."""
    profile = gearbox.profile
    n_pins, n_lobes = gearbox.n_pins, gearbox.n_lobes
    tip, pit = profile.chord()
    pit_angle = math.pi / n_lobes
    pit_normal = complex(profile.normal(pit_angle))
    pin_errors = np.hypot(gearbox.pin_radial_errors or [0.0], gearbox.pin_tangential_errors or [0.0])
    wheel = _kernels.WheelConstants(
        eccentricity=float(gearbox.eccentricity),
        shortening=float(gearbox.shortening),
        n_lobes=int(n_lobes),
        pin_radius=float(gearbox.pin_radius),
        pin_circle_radius=float(gearbox.pin_circle_radius),
        tip_x=tip.real,
        pit_x=pit.real,
        pit_y=pit.imag,
        pit_nx=pit_normal.real,
        pit_ny=pit_normal.imag,
        tip_radius=float(profile.effective_radius(0.0)),
        pit_radius=float(profile.effective_radius(pit_angle)),
        near=max(0.7 / abs(float(profile.curvature(pit_angle))) - float(pin_errors.max()), 0.0) ** 2,
    )
    joint = _kernels.JointConstants(
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
    pins = np.zeros(_kernels.PIN_TABLE_SIZE)
    for row, values in (
        (_kernels.PIN_COS, np.cos(pin_angles)),
        (_kernels.PIN_SIN, np.sin(pin_angles)),
        (_kernels.PIN_RADIAL_ERROR, gearbox.pin_radial_errors or 0.0),
        (_kernels.PIN_TANGENTIAL_ERROR, gearbox.pin_tangential_errors or 0.0),
        (_kernels.PIN_ANGLE, pin_angles),
    ):
        pins[int(row) : int(row) + n_pins] = values
    sleeve_angles = 2 * np.pi * np.arange(gearbox.n_internal_sleeves) / gearbox.n_internal_sleeves
    lobe_angles = 2 * np.pi * np.arange(n_lobes) / n_lobes
    wear = np.zeros((2, n_lobes))
    for w in defects.wheels:
        wear[w, list(defects.worn_lobes)] = defects.depth
        wear[w, list(defects.removed_lobes)] = _kernels.REMOVED
    # The wheels are mounted 180 deg apart as closely as their lobes allow (exactly, where z_s is odd).
    rest = np.array([-math.pi / n_lobes, 2 * math.pi * ((n_lobes + 1) // 2 - 1) / n_lobes])
    runouts = np.asarray(gearbox.wheel_runouts or (0j, 0j), dtype=complex)
    worn = ((wear > 0) & (wear <= 1)).any(axis=1)
    removed = (wear == _kernels.REMOVED).any(axis=1)
    kind = worn * _kernels.HAS_WORN + removed * _kernels.HAS_REMOVED
    mounts = np.column_stack([rest, np.cos(rest), np.sin(rest), runouts.real, runouts.imag, kind])
    return KernelInput(
        wheel=wheel,
        joint=joint,
        # The conservative law takes the pin's own radius, as on a plane flank, for every pin contact.
        contact=contact_constants(gearbox, gearbox.pin_radius),
        joint_contact=contact_constants(gearbox, joint_effective_radius(gearbox)),
        body=body,
        pins=pins,
        mounts=mounts,
        lobes=np.array([np.cos(lobe_angles), np.sin(lobe_angles)]),
        wear=wear,
        sleeves=np.array([np.cos(sleeve_angles), np.sin(sleeve_angles)]),
    )


def _driver(gearbox: CycloidalGearbox, time: Float, start_angle: float) -> tuple[Float, Float, Float]:
    """Angle, speed and acceleration of the input: a linear rise of the speed, then constant.

    Paper B's eq. 6 lets the angle jump at the end of the ramp; here the speed is integrated.
    """
    ramp, speed = gearbox.ramp_time, gearbox.input_speed
    if ramp == 0:
        return start_angle + speed * time, np.full_like(time, speed), np.zeros_like(time)
    rising = time < ramp
    angle = np.where(rising, 0.5 * speed / ramp * time**2, speed * (time - ramp / 2))
    omega = np.where(rising, speed / ramp * time, speed)
    return start_angle + angle, omega, np.where(rising, speed / ramp, 0.0)


def _load(gearbox: CycloidalGearbox, time: Float, fluctuation: Load | None) -> Float:
    """Load torque on the output (paper B eq. 9-10), plus its fluctuation, both under the ramp."""
    load = np.full_like(time, gearbox.load_torque)
    if fluctuation is not None:
        extra = fluctuation(time) if callable(fluctuation) else fluctuation
        values = np.asarray(extra, dtype=float)
        if values.ndim > 1 or (values.ndim == 1 and values.shape != time.shape):
            raise ValueError(
                "load_fluctuation must be a number or a function of time that returns one value per time; "
                f"it gave shape {values.shape} for {time.shape[0]} times"
            )
        if not np.all(np.isfinite(values)):
            raise ValueError("load_fluctuation must be finite, it gave NaN or infinity")
        load = load + values
    if gearbox.ramp_time > 0:
        load = load * np.clip(time / gearbox.ramp_time, 0, 1)
    return load


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
    load_fluctuation: Load | None = None,
    decimation: str = "antialias",
    forces: bool = False,
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
    load_fluctuation : float or function of time, optional
        Added to the load torque, in Nm: a number, or a function that takes times of shape (n,) in s and
        returns Nm of the same shape.
    decimation : {"antialias", "pick"}
        How the integration's samples become the result's: through an anti-alias filter, or by picking every
        k-th as the papers do (``1 / (dt sampling_rate)`` must then be a whole number).
    forces : bool
        Whether to keep the force of every sleeve (these are always picked, never filtered).

    Returns
    -------
    SimulationRun

    Raises
    ------
    SimulationDiverged
        Where the integration diverges; says when, which contact, and what helps.
    ValueError
        For arguments outside their range.

    Examples
    --------
    >>> run = simulate(CycloidalGearbox.steel(), LobeDefects.worn(1), duration=0.3)
    >>> run.torque_out.shape
    (7680,)
    """
    gearbox = CycloidalGearbox.steel() if gearbox is None else gearbox
    defects = LobeDefects.healthy() if defects is None else defects
    defects.check_against(gearbox.n_lobes)
    for name, value in (("duration", duration), ("dt", dt), ("sampling_rate", sampling_rate)):
        if not (math.isfinite(value) and value > 0):
            raise ValueError(f"{name} must be positive and finite, got {value!r}")
    if not math.isfinite(start_angle):
        raise ValueError(f"start_angle must be finite (rad), got {start_angle!r}")
    if sampling_rate * dt > 1 + 1e-9:
        raise ValueError(f"sampling_rate must not exceed 1/dt = {1 / dt:g} Hz, got {sampling_rate:g} Hz")
    if decimation not in ("antialias", "pick"):
        raise ValueError(f"decimation must be 'antialias' or 'pick', got {decimation!r}")
    if tolerances is not None:
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
    n_steps = math.ceil((n_samples + _FILTER_MARGIN) / ratio)
    if n_steps > LARGEST_N_STEPS:
        raise ValueError(
            f"duration {duration:g} s takes {n_steps:.3g} steps of dt = {dt:g} s, more than "
            f"{LARGEST_N_STEPS:g}: simulate shorter runs"
        )
    half_steps: Float = np.arange(2 * n_steps + 1, dtype=float) * (dt / 2)
    phi, omega, alpha = _driver(gearbox, half_steps, start_angle)
    load = _load(gearbox, half_steps, load_fluctuation)
    torques = np.empty((n_steps, _kernels.N_RESULT))
    angles = np.empty((n_steps, 4))
    last_external = _zeros_apart(2, gearbox.n_pins)
    last_internal = _zeros_apart(2, gearbox.n_internal_sleeves)
    n_force_rows = n_steps if forces else 0
    external = np.empty((n_force_rows, *last_external.shape))
    internal = np.empty((n_force_rows, *last_internal.shape))
    finished = _kernels.integrate(
        n_steps, dt, phi, omega, alpha, load, np.zeros(_kernels.N_STATE), *kernel_input(gearbox, defects),
        ABSURD_TORQUE, torques, angles, last_external, last_internal, external, internal,
    )  # fmt: skip
    if finished < n_steps:
        contact, force = _largest_contact(last_external, last_internal)
        raise SimulationDiverged(finished * dt, contact, force, dt)

    time = np.arange(n_samples) / sampling_rate
    steps = np.minimum(np.rint(time / dt).astype(int), n_steps - 1)
    if decimation == "pick" or ratio == 1:
        torque_out, torque_in = torques[steps].T
    else:
        torque_out, torque_in = resample_poly(torques.T, ratio.numerator, ratio.denominator, axis=1)[
            :, :n_samples
        ]
    input_angle = _driver(gearbox, time, start_angle)[0]
    return SimulationRun(
        gearbox=gearbox,
        defects=defects,
        sampling_rate=float(sampling_rate),
        torque_out=np.ascontiguousarray(torque_out),
        torque_in=np.ascontiguousarray(torque_in),
        input_angle=input_angle,
        output_angle=angles[steps, 2] - input_angle / gearbox.n_lobes,
        external_forces=external[steps] if forces else None,
        internal_forces=internal[steps] if forces else None,
        dt=dt,
        seed=seed,
    )


def _zeros_apart(n_rows: int, n_columns: int) -> Float:
    """Array of zeros that begins well behind whatever lies before it in memory.

    Compiled loops that write to it check whether it begins within a few vectors of what they read, and if so
    add in another order: the last bits of a run would depend on where the memory happened to be free.
    """
    apart = 64
    return np.zeros(apart + n_rows * n_columns)[apart:].reshape(n_rows, n_columns)


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
