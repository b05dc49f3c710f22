"""Run the reduced gearbox model: from parameters to torque records."""

from __future__ import annotations

import functools
import math
import warnings
from dataclasses import dataclass, field, replace
from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.signal import firwin, resample_poly

from cyclofeat._base.checks import check_type, number, one_of, positive
from cyclofeat.simulators import _kernels, tables
from cyclofeat.simulators._simulator import Simulator
from cyclofeat.simulators.courses import MARGIN, Courses, DriveAndLoad
from cyclofeat.simulators.defects import LobeDefects, check_machine
from cyclofeat.simulators.gearbox import CycloidalGearbox

Float = NDArray[np.float64]
Complex = NDArray[np.complex128]

# Nm; a healthy run stays below 30 Nm.
ABSURD_TORQUE = 1e4
# The machine is locked if the drive must overcome this force (N) on a cam for this time (s). Impacts are
# shorter, and a diverging integration exceeds ABSURD_TORQUE earlier.
LOCKING_FORCE = 2e4
LOCKING_TIME = 1e-3
STAGES = {"midpoint": 2, "adams_bashforth": 1, "leapfrog": 1}
# Limit of stability of p = rate dt for x' = -rate x: 1 - p + p^2/2 (midpoint) stays below 1 up to p = 2, the
# roots of r^2 - (1 - 3/2 p) r - p/2 (Adams-Bashforth) up to p = 1, those of r^3 - (1 - 15/8 p) r^2 - 5/4 p r
# + 3/8 p (leapfrog) up to 4/7, less by the share (w dt)^2 / 4 where x'' = -w^2 x - rate x'.
_STABLE = {"midpoint": 2.0, "adams_bashforth": 1.0, "leapfrog": 4 / 7}
# Bodies that friction damps: two wheels, the output shaft, and all sleeves (about their axles).
_OUTPUT = 2
_FIRST_SPIN = 3
# Errors of rules (Nm rms) over (dt W k)^2 / d, with the input's speed W and one wheel's contact stiffness k
# and damping d; 60 drawn machines around paper B's gearbox had at most so much, but for a ringing brake.
_ERROR = {"leapfrog": 1e-6, "adams_bashforth": 7e-6}
# Share of the limit of stability that a step takes; factor of force-weighted damping in impacts.
_SHARE_OF_STABLE, _IMPACTS = 0.75, 2.3
_LARGEST_STEP, _LEAST_STEP = 5e-5, 8e-6  # in s, by choice; below, it is 1e-5 s
# Number of instants at which the damping by friction is compared with the time step.
_N_WATCHED = 128
# A step needs about 100 bytes of memory: 100 million steps are 1000 s and 10 GB.
LARGEST_N_STEPS = 100_000_000
# A start has settled after this many time constants of the slowest torsional mode (exp(-5) = 0.7 %).
_N_TIME_CONSTANTS = 5.0


class SimulationFailed(RuntimeError):
    """Error of a run that did not reach its end.

    Attributes
    ----------
    time : float
        Time in s at which it ended.
    contact : str
        Contact with the largest force at that time.
    force : float
        That force in N.
    """

    def __init__(
        self, message: str, time: float = math.nan, contact: str = "", force: float = math.nan
    ) -> None:
        self.time, self.contact, self.force = time, contact, force
        super().__init__(message)


class SimulationDiverged(SimulationFailed):
    """The integration left the range of finite, sensible values."""


class GearboxLocked(SimulationFailed):
    """The gearbox wedged: the drive had to overcome more than 20 kN on a cam for a millisecond."""


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
        Moment of the cams' reactions about the input shaft, in Nm (paper B fig. 5). This and the optional
        arrays below are None unless requested.
    input_angle : ndarray, shape (n,)
        Angle phi of the input shaft in rad; 0 is cam 0 at pin 0.
    output_angle, output_speed : ndarray, shape (n,), or None
        Angle psi of the output shaft in rad and its rate in rad/s (the tachometer of paper A); it turns
        against the input.
    external_forces, internal_forces : ndarray, shape (n, 2, n_pins or n_internal_sleeves), or None
        Normal force between each wheel and each external or internal sleeve, in N.
    external_points, internal_points : complex ndarray of the forces' shapes, or None
        Point x + iy in m, in the fixed frame, where each sleeve touches each wheel; NaN without contact. A
        sleeve that touches twice (at a worn lobe's pit) has one point, in the direction of the resultant.
    motor_current : ndarray, shape (n,), or None
        Current of the motor in A, for rigs that have one (:class:`cyclofeat.simulators.ServoMotor`).
    dt : float
        Integration step in s.
    kernel : str
        What made the run: the kernel "exact" or "batch" (:func:`simulate_many`), or the class of a user's
        simulator.
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
    motor_current: Float | None = field(repr=False, default=None)
    dt: float = 1e-5
    kernel: str = "exact"

    @property
    def time(self) -> Float:
        """Time of each sample in s, shape (n,)."""
        return np.arange(self.torque_out.size) / self.sampling_rate


@dataclass(frozen=True)
class Solver:
    """Numerical settings of a simulation.

    Parameters
    ----------
    dt : float
        Integration step in s.
    integrator : {"midpoint", "adams_bashforth", "leapfrog"}
        The papers' midpoint rule (second-order Runge-Kutta), or one of two second-order rules that take half
        the time: Adams-Bashforth, with 2.5 to 3 times the error at the same step (``make bench-simulator``)
        and half the limit of stability; or, in batches, leapfrog (positions by the speed half a step later,
        forces at a speed extrapolated by the last two accelerations), with a tenth of Adams-Bashforth's error
        and 4/7 of its limit. The exact kernel takes Adams-Bashforth with at most 1e-5 s in its place.
    decimation : {"antialias", "pick"}
        Anti-alias filter, or every k-th sample as in the papers (``1 / (dt sampling_rate)`` must then be a
        whole number).
    check_friction : bool
        Whether to warn if friction chatters at this ``dt``. The forces that this takes come from the exact
        kernel, also after a batch, which must then be compiled: leave it out where no one can act on it.

    Raises
    ------
    TypeError, ValueError
        For settings of the wrong type or outside their range.
    """

    dt: float = 1e-5
    integrator: str = "midpoint"
    decimation: str = "antialias"
    check_friction: bool = True

    def __post_init__(self) -> None:
        positive("dt", self.dt)
        one_of("integrator", self.integrator, STAGES)
        one_of("decimation", self.decimation, ("antialias", "pick"))


def simulate(
    gearbox: CycloidalGearbox | None = None,
    defects: LobeDefects | None = None,
    *,
    duration: float = 0.6,
    sampling_rate: float = 25_600.0,
    start_angle: float = 0.0,
    courses: Courses | None = None,
    solver: Solver | None = None,
    simulator: Simulator | None = None,
    torque_in: bool = True,
    motion: bool = True,
    forces: bool = False,
    points: bool = False,
) -> SimulationRun:
    """Simulate the gearbox from rest.

    Planar multibody model of paper B in its exact reduction: the input angle is prescribed, two wheels, the
    output shaft and, where there is one, the brake's rotor move.

    Parameters
    ----------
    gearbox : CycloidalGearbox, default ``CycloidalGearbox.steel()``
    defects : LobeDefects, default healthy
    duration : float
        Simulated time in s, the ramp included.
    sampling_rate : float
        Samples per second of the result. At most ``1 / solver.dt``.
    start_angle : float
        Input angle at t = 0 in rad.
    courses : Courses, optional
        Input speed and load over time, in place of the gearbox's.
    solver : Solver, optional
        Time step, integrator and decimation.
    simulator : Simulator, optional
        User's simulator in the place of the model: without ramp, ``solver`` and the results below.
    torque_in : bool
        Keep the moment about the input shaft.
    motion, forces, points : bool
        Keep angle and speed of the output, the force of every sleeve, and its contact points. These are
        always picked, never filtered.

    Returns
    -------
    SimulationRun
        ``round(duration * sampling_rate)`` samples from t = 0.

    Raises
    ------
    SimulationDiverged
        If the integration diverges; the message says when, which contact, and what helps.
    GearboxLocked
        If the gearbox wedges.
    RuntimeError
        If a user's simulator raises an error, or gives a result of a wrong length or that is not finite.
    TypeError, ValueError
        For arguments of the wrong type or outside their range.

    Warns
    -----
    RuntimeWarning
        If friction is so steep that it chatters at this ``dt``: see ``friction_transition_speed`` of
        :class:`CycloidalGearbox`.

    Examples
    --------
    >>> run = simulate(CycloidalGearbox.steel(), LobeDefects.worn(1), duration=0.3)
    >>> run.torque_out.shape
    (7680,)
    """
    gearbox, defects = check_machine(gearbox, defects)
    if simulator is not None:
        n, steady = round(duration * sampling_rate), gearbox.replace(ramp_time=0.0)
        course = DriveAndLoad(steady, n, 1 / sampling_rate, start_angle, courses).piece()
        return _run_simulator(simulator, gearbox, defects, course, sampling_rate)
    solver = solver or Solver()
    check_type("solver", solver, Solver)
    if solver.integrator == "leapfrog":
        solver = replace(solver, dt=min(solver.dt, Solver.dt), integrator="adams_bashforth")
    sampling = Sampling.plan(duration, sampling_rate, solver)
    number("start_angle", start_angle)
    dt, n_steps, steps = solver.dt, sampling.n_steps, sampling.steps
    course = DriveAndLoad(gearbox, 2 * n_steps + 1, dt / 2, start_angle, courses).piece()
    integration = Integration(gearbox, tables.kernel_input(gearbox, defects), course, dt, solver.integrator)
    checked = gearbox.has_friction and solver.check_friction
    watched = steps[:: max(steps.size // _N_WATCHED, 1)] if checked else steps[:0]
    kept = steps if motion or forces or points else watched
    done = integration.run(tables.rest_state(gearbox), 0, n_steps, kept, forces=forces or points)
    if checked:
        states = done.motion[np.searchsorted(kept, watched)]
        nearby = np.stack([course[:, 2 * step : 2 * step + 3] for step in watched])
        check_friction(gearbox, integration.constants, solver, nearby, states)
    phi, omega = course[:2]
    input_angle = np.interp(sampling.time, np.arange(phi.size) * (dt / 2), phi)
    z, external, internal = gearbox.n_lobes, done.external, done.internal
    external_points, internal_points = None, None
    if points:
        axles = tables.sleeve_centres(gearbox, done.motion[:, 2] - phi[2 * kept] / z)[:, np.newaxis]
        external_points = contact_points(tables.pin_centres(gearbox), gearbox.pin_radius, external)
        internal_points = contact_points(axles, gearbox.internal_sleeve_radius, internal)
    return SimulationRun(
        gearbox=gearbox, defects=defects, sampling_rate=float(sampling_rate), dt=dt, input_angle=input_angle,
        torque_out=sampling.decimate(done.torques[:, 0]),
        torque_in=sampling.decimate(done.torques[:, 1]) if torque_in else None,
        output_angle=done.motion[:, 2] - input_angle / z if motion else None,
        output_speed=done.motion[:, 6] - omega[2 * kept] / z if motion else None,
        external_forces=np.ascontiguousarray(external[..., 0]) if forces else None,
        internal_forces=np.ascontiguousarray(internal[..., 0]) if forces else None,
        external_points=external_points, internal_points=internal_points,
    )  # fmt: skip


def _run_simulator(
    simulator: Simulator, gearbox: CycloidalGearbox, defects: LobeDefects, course: Float, sampling_rate: float
) -> SimulationRun:
    """Return the run of a user's simulator, checked."""
    angle, speed, _, load = course
    n, where = angle.size, f"simulate of {simulator!r}"
    try:
        given = simulator.simulate(np.arange(n) / sampling_rate, angle, speed, load, gearbox, defects)
        torque, input_angle = (np.array(values, dtype=float) for values in given)
    except SimulationFailed:
        raise
    except Exception as error:
        raise RuntimeError(f"{where} raised {type(error).__name__}: {error}") from error
    for name, values in (("torque", torque), ("input_angle", input_angle)):
        if values.shape != (n,):
            raise RuntimeError(f"{where} must return {name} of shape ({n},), got {values.shape}")
        if not np.all(np.isfinite(values)):
            first = int(np.argmin(np.isfinite(values)))
            got = f"{values[first]} at sample {first} of {n}"
            raise RuntimeError(f"{where} must return finite {name}, or raise SimulationFailed, got {got}")
    return SimulationRun(
        gearbox, defects, float(sampling_rate), torque, None, input_angle, kernel=type(simulator).__name__
    )


@dataclass(frozen=True)
class Sampling:
    """Selection of the samples of the result from the steps of the integration."""

    time: Float
    n_steps: int
    steps: NDArray[np.int64]
    ratio: Fraction
    picks: bool  #: samples are values of single steps, without a filter

    @classmethod
    def plan(cls, duration: float, sampling_rate: float, solver: Solver) -> Sampling:
        positive("duration", duration)
        positive("sampling_rate", sampling_rate)
        check_type("solver", solver, Solver)
        dt = solver.dt
        if sampling_rate * dt > 1 + 1e-9:
            raise ValueError(f"sampling_rate must not exceed 1/dt = {1 / dt:g} Hz, got {sampling_rate:g} Hz")
        n_samples = round(duration * sampling_rate)
        if n_samples < 1:
            raise ValueError(f"duration {duration:g} s is shorter than one sample at {sampling_rate:g} Hz")
        ratio = Fraction(sampling_rate * dt).limit_denominator(100_000)
        if solver.decimation == "pick" and ratio.numerator != 1:
            raise ValueError(f"sampling_rate must divide 1/dt = {1 / dt:g} Hz to pick, got {sampling_rate:g}")
        # The anti-alias filter pads with zeros. That is right at the start, at rest; MARGIN covers the end.
        n_steps = math.ceil((n_samples + MARGIN) / ratio)
        if n_steps > LARGEST_N_STEPS:
            raise ValueError(f"duration must take at most {LARGEST_N_STEPS:g} steps of dt, got {n_steps:.3g}")
        time = np.arange(n_samples) / sampling_rate
        steps = np.minimum(np.rint(time / dt).astype(int), n_steps - 1)
        return cls(time, n_steps, steps, ratio, picks=solver.decimation == "pick" or ratio == 1)

    def decimate(self, channel: Float) -> Float:
        """Return the samples of the result from one value per step."""
        if self.picks:
            return np.ascontiguousarray(channel[self.steps])
        up, down = self.ratio.numerator, self.ratio.denominator
        low_pass = anti_alias_filter(up, down)
        samples = resample_poly(channel, up, down, window=low_pass)[: self.time.size]
        return np.ascontiguousarray(samples)


class Integrated(NamedTuple):
    """State after the last step, torques at every step, motion and forces at the requested steps."""

    state: Float
    torques: Float
    motion: Float
    external: Float
    internal: Float


@dataclass(frozen=True)
class Integration:
    """The kernel with the constants of one gearbox and the courses of its input and load.

    ``course``, shape (4, 2 n_steps + 1), has angle, speed and acceleration of the input and load at every
    half step (:func:`~cyclofeat.simulators.courses.DriveAndLoad`); the integrator may not be ``"leapfrog"``.
    """

    gearbox: CycloidalGearbox
    constants: tables.KernelInput
    course: Float
    dt: float
    integrator: str = "midpoint"

    def run(
        self, state: Float, begin: int, end: int, instants: NDArray[np.int64], *, forces: bool = False,
        memory: tuple[NDArray[Any], ...] | None = None,
    ) -> Integrated:  # fmt: skip
        """Integrate from step ``begin``, at which ``state`` (n_state,) is, to step ``end``.

        At ``instants``, steps counted from ``begin``, motion and, with ``forces``, the forces of all sleeves
        are recorded. ``memory`` holds the kernel's description of the contacts afterwards. Raises
        SimulationDiverged or GearboxLocked.
        """
        gearbox, n_steps = self.gearbox, end - begin
        torques = np.empty((n_steps, _kernels.N_RESULT))
        motion = np.empty((instants.size, state.size))
        n_rows = (instants.size if forces else 0) + 1
        external, internal = (
            np.zeros((n_rows, 2, n, 3)) for n in (gearbox.n_pins, gearbox.n_internal_sleeves)
        )
        state = state.copy()
        finished = _kernels.integrate(
            STAGES[self.integrator], n_steps, self.dt, *self.course[:, 2 * begin : 2 * end + 1], state,
            *self.constants, memory or _kernels.new_memory(state), ABSURD_TORQUE,
            gearbox.eccentricity * LOCKING_FORCE, LOCKING_TIME / self.dt, torques, instants, motion, external,
            internal,
        )  # fmt: skip
        if finished < n_steps:
            # The most loaded contact, or the first whose force is not a number.
            sizes = np.concatenate([external[-1, ..., 0], internal[-1, ..., 0]], axis=None)
            sizes[~np.isfinite(sizes)] = np.inf
            worst, n_pins = int(np.argmax(sizes)), gearbox.n_pins
            kind, wheel, sleeve = "external", *divmod(worst, n_pins)
            if worst >= 2 * n_pins:
                kind, wheel, sleeve = "internal", *divmod(worst - 2 * n_pins, gearbox.n_internal_sleeves)
            time, force = (begin + finished) * self.dt, float(sizes[worst])
            contact = f"the contact of wheel {wheel + 1} with {kind} sleeve {sleeve + 1} (counted from 1)"
            if np.all(np.abs(torques[: finished + 1]) < ABSURD_TORQUE):
                raise GearboxLocked(
                    f"the gearbox locks at t = {time:.6f} s: {contact} carries {force:.3g} N and the drive "
                    f"had to overcome more than {LOCKING_FORCE / 1e3:g} kN for {LOCKING_TIME * 1e3:g} ms; "
                    "this is a result, not a numerical failure", time, contact, force,
                )  # fmt: skip
            raise SimulationDiverged(
                f"simulation diverged at t = {time:.6f} s: {contact} reached {force:.3g} N with dt = "
                f"{self.dt:g} s; use a smaller dt (try {self.dt / 4:g} s) or a softer contact (smaller "
                "stiffness_scale)", time, contact, force,
            )  # fmt: skip
        return Integrated(state, torques, motion, external[:-1], internal[:-1])


def check_friction(
    gearbox: CycloidalGearbox, constants: tables.KernelInput, solver: Solver, courses: Float, states: Float
) -> None:
    """Warn if friction damps at rates beyond the integrator's limit of stability in any of several states.

    ``courses`` (n, 4, 3) hold input and load in each of the ``states`` (n, n_state) and at the next two half
    steps.
    """
    dt, integrator, first = solver.dt, solver.integrator, np.zeros(1, dtype=int)
    again = [
        Integration(gearbox, constants, course, dt).run(state, 0, 1, first, forces=True)
        for course, state in zip(courses, states, strict=True)
    ]
    external = np.concatenate([done.external for done in again])
    internal = np.concatenate([done.internal for done in again])
    phi, omega = courses[:, :2, 0].T
    rates = friction_rates(gearbox, phi, omega, states, external, internal)
    fastest, limit = float(rates.max(initial=0.0)), _STABLE[integrator]
    if fastest * dt > limit:
        warnings.warn(
            f"friction chatters where surfaces stick: it damps at up to {fastest:.3g} 1/s, and "
            f"integrator={integrator!r} with dt = {dt:g} s follows {limit:g}/dt = {limit / dt:.3g} 1/s; "
            f"take a dt below {limit / fastest:.2g} s, or friction less steep (a higher "
            "friction_transition_speed, or bearing_transition_speed)",
            RuntimeWarning,
            stacklevel=3,
        )


def friction_rates(
    gearbox: CycloidalGearbox, phi: Float, omega: Float, motion: Float, external: Float, internal: Float
) -> Float:
    """Largest damping rate by friction in 1/s, if sleeves stick to wheels and axles, (n,).

    Friction at rest is a damper of force times coefficient over the transition speed. With S the sliding
    speeds per unit of the bodies' rates, G these slopes and M the inertias, the damping rates are the
    eigenvalues of M^-1 S' G S. The slope of the output's bearing is that at the shaft's speed. ``phi`` and
    ``omega`` (n,) are of the input, ``motion`` (n, n_state) and the sleeves' forces (n, 2, n_sleeves, 3) as
    the kernel gathers them.
    """
    n_pins, n_sleeves = gearbox.n_pins, gearbox.n_internal_sleeves
    inertias = np.full(_FIRST_SPIN + n_pins + n_sleeves, gearbox.sleeve_inertia)
    inertias[:_FIRST_SPIN] = gearbox.wheel_inertia, gearbox.wheel_inertia, gearbox.output_inertia
    centres = gearbox.eccentricity * np.array([1, -1]) + np.asarray(gearbox.cam_errors or (0j, 0j))
    cams = centres * np.exp(1j * phi)[:, None]
    pins = np.tile(tables.pin_centres(gearbox), (phi.size, 1))
    sleeves = tables.sleeve_centres(gearbox, motion[:, 2] - phi / gearbox.n_lobes)
    bearing = np.zeros((phi.size, 1, inertias.size))
    bearing[..., _OUTPUT] = 1.0
    turning = (motion[:, 6] - omega / gearbox.n_lobes)[:, None] / gearbox.bearing_transition_speed
    coulomb = gearbox.output_bearing_torque / gearbox.bearing_transition_speed * (1 - np.tanh(turning) ** 2)
    # Sliding speeds per unit of the bodies' rates (n, n_sleeves, n_bodies), and slopes (n, n_sleeves).
    slides, slopes = [bearing], [coulomb + gearbox.output_bearing_viscosity]
    at_rest = gearbox.sleeve_static_friction or gearbox.sleeve_friction
    # Axles turn about the origin with the bodies' rates times the carrier's.
    for axles, radius, first, forces, carrier in (
        (pins, gearbox.pin_radius, _FIRST_SPIN, external, bearing * 0.0),
        (sleeves, gearbox.internal_sleeve_radius, _FIRST_SPIN + n_pins, internal, bearing),
    ):
        vector = forces[..., 1] + 1j * forces[..., 2]
        size = np.abs(vector)
        toward = vector / np.where(size > 0, size, 1.0)  # from the sleeve to the wheel
        spin = np.zeros((*axles.shape, inertias.size))
        sleeve = np.arange(axles.shape[1])
        spin[:, sleeve, first + sleeve] = radius
        for w in range(2):
            normal = toward[:, w].conj()
            slide = -spin - (axles * normal).real[..., None] * carrier
            slide[..., w] = ((axles + radius * toward[:, w] - cams[:, w, None]) * normal).real
            slides.append(slide)
            viscous = gearbox.sleeve_viscous_friction * (size[:, w] > 0)
            slopes.append(at_rest * size[:, w] / gearbox.friction_transition_speed + viscous)
        on_axle = np.abs(vector.sum(axis=1))
        slides.append(spin - radius * carrier)
        slopes.append(gearbox.journal_friction * on_axle / gearbox.friction_transition_speed)
    slope = np.concatenate(slopes, axis=1)
    scaled = np.concatenate(slides, axis=1) * np.sqrt(slope)[..., None] / np.sqrt(inertias)
    return np.asarray(np.linalg.eigvalsh(np.swapaxes(scaled, 1, 2) @ scaled)[:, -1])


@functools.cache
def anti_alias_filter(up: int, down: int) -> Float:
    """Low-pass of ``resample_poly`` with equal gains of its phases at 0 Hz.

    In scipy's design the gains differ by some 1e-5, which adds a comb of 0.4 mNm at 22 Nm.
    """
    largest = max(up, down)
    taps = firwin(20 * largest + 1, 1 / largest, window=("kaiser", 5.0))
    for phase in range(up):
        taps[phase::up] /= taps[phase::up].sum() * up
    taps.setflags(write=False)
    return np.asarray(taps)


def contact_points(centres: Complex, radius: float, forces: Float) -> Complex:
    """Return the points where sleeves touch each wheel, from the ``forces`` (n, 2, n_sleeves, 3)."""
    vector = forces[..., 1] + 1j * forces[..., 2]
    size = np.abs(vector)
    with np.errstate(invalid="ignore"):  # a contact without force has no point
        return np.where(size > 0, centres + radius * vector / size, np.nan)


def settling_time(gearbox: CycloidalGearbox) -> float:
    """Return the time in s until a run from rest is steady: ramp and decay of the slowest torsional mode.

    With a brake that mode is the rotor (inertia J) on torque meter (k, c) and gearbox (k_g, c_g) in series:
    it decays with time constant 2 J / c_e, c_e = c (k_g / (k + k_g))^2 + c_g (k / (k + k_g))^2. The gearbox's
    share is estimated for all sleeves of the loaded half in Hertzian contact at the mean load. After the ramp
    follow five time constants or one turn of the input, whichever is longer; the time is infinite without any
    damping. In 96 simulated assemblies of R1 and R2 the start left 0.1 % of the ripple (std) in the next
    output turn in the median, below 0.4 % in nine of ten, 4 % in the worst.
    """
    check_type("gearbox", gearbox, CycloidalGearbox)
    turn = 1 / gearbox.input_speed_hz
    if gearbox.brake_inertia == 0:
        return gearbox.ramp_time + turn
    _, damping = torsion(gearbox)
    if damping == 0:
        return math.inf
    decay = 2 * gearbox.brake_inertia / damping
    return gearbox.ramp_time + max(turn, _N_TIME_CONSTANTS * decay)


def solver_within(gearbox: CycloidalGearbox, sampling_rate: float, error_nm: float) -> Solver:
    """Return the rule of one stage with the largest step whose error of the torque is below ``error_nm`` rms.

    The step is a whole fraction of the sampling interval, smaller where contacts are stiff or barely damped,
    and where damping or friction would make the rule unstable, but not below about 1e-5 s.
    """
    stiffness, damping, forces = contact_rings(gearbox)
    wheel_stiffness, wheel_damping = float(stiffness.sum()) / 2, float(damping.sum()) / 2
    coefficient = max(gearbox.sleeve_static_friction, gearbox.sleeve_friction)
    rub = float(forces @ np.array([gearbox.pin_circle_radius, gearbox.internal_pitch_radius]) ** 2)
    on_wheel = rub * coefficient / gearbox.friction_transition_speed
    on_wheel += wheel_damping * (_IMPACTS if gearbox.contact_law == "hunt_crossley" else 1.0)
    on_output = float(damping[1]) + gearbox.meter_damping + gearbox.output_bearing_viscosity
    fastest = max(on_wheel / gearbox.wheel_inertia, on_output / gearbox.output_inertia)
    square = _SHARE_OF_STABLE * wheel_stiffness / gearbox.wheel_inertia
    moving = max(abs(gearbox.input_speed) * wheel_stiffness, 1.0)
    steps = {}
    for integrator, error in _ERROR.items():
        rate = fastest / _STABLE[integrator]
        stable = 2 * _SHARE_OF_STABLE / max(rate + math.sqrt(rate**2 + square), 1.0)
        exact = max(math.sqrt(error_nm * wheel_damping / error) / moving, Solver.dt)
        n_steps = math.ceil(1 / (sampling_rate * min(stable, exact, _LARGEST_STEP)) - 1e-9)
        # An even number above one: machines with equal steps share batches.
        steps[integrator] = 1 / (sampling_rate * (n_steps if n_steps == 1 else n_steps + n_steps % 2))
    integrator = max(steps, key=lambda name: steps[name])
    if steps[integrator] < _LEAST_STEP:
        return Solver(integrator="adams_bashforth", check_friction=False)
    return Solver(steps[integrator], integrator, check_friction=False)


def contact_rings(gearbox: CycloidalGearbox) -> tuple[Float, Float, Float]:
    """Return stiffness (Nm/rad), damping (Nms/rad) and forces (N) of all pins, and of all internal sleeves.

    The forces are sums over one wheel; all are for Hertzian contact of the loaded half at the mean load.
    """
    torque = abs(gearbox.load_torque) / 2  # per wheel
    joint_radius = tables.joint_effective_radius(gearbox)
    stiffness, damping, forces = np.empty((3, 2))
    for stage, (n_sleeves, largest_arm, radius) in enumerate(
        (
            (gearbox.n_pins, gearbox.eccentricity * gearbox.n_lobes, gearbox.pin_radius),
            (gearbox.n_internal_sleeves, gearbox.internal_pitch_radius, joint_radius),
        )
    ):
        loaded = max(n_sleeves // 2, 1)
        arms = largest_arm * np.sin(np.pi * (np.arange(loaded) + 0.5) / loaded)
        contact = tables.stiffness_factor(gearbox) * math.sqrt(radius)
        # torque = contact * twist^1.5 * sum(arm^2.5), and the stiffness is its derivative
        levers = contact * float(np.sum(arms**2.5))
        stiffness[stage] = 2 * (1.5 * torque ** (1 / 3) * levers ** (2 / 3))
        elastic = contact * ((torque / levers) ** (2 / 3) * arms) ** 1.5
        forces[stage] = elastic.sum()
        weights = elastic if gearbox.contact_law == "hunt_crossley" else np.ones(loaded)
        damping[stage] = 2 * gearbox.contact_damping * float(np.sum(weights * arms**2))
    return stiffness, damping, forces


def torsion(gearbox: CycloidalGearbox) -> tuple[float, float]:
    """Return torsional stiffness (Nm/rad) and damping (Nms/rad) of torque meter and gearbox in series."""
    stiffness, damping, _ = contact_rings(gearbox)
    gear_stiffness = stiffness.prod() / stiffness.sum() if stiffness.all() else 0.0
    gear_damping = damping.prod() / damping.sum() if damping.all() else 0.0
    meter_part = gear_stiffness / (gear_stiffness + gearbox.meter_stiffness)
    series = gearbox.meter_damping * meter_part**2 + gear_damping * (1 - meter_part) ** 2
    return float(meter_part * gearbox.meter_stiffness), float(series)
