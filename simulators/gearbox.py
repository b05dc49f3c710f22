"""Parameters of the cycloidal gearbox and its rig, and the closed-form geometry of its wheels.

A wheel's profile is the parallel curve of a shortened trochoid, one pin radius inside: the contact gap is the
signed distance of the pin's centre from the trochoid. Points are complex numbers in the frame of the wheel,
whose centre is the origin; the tip of lobe 0 lies on the real axis. SI units and radians.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cyclofeat._base import checks

Complex = NDArray[np.complex128]
Float = NDArray[np.float64]

RPM = 2 * math.pi / 60
MAX_SLEEVES = 128
CONTACT_LAWS = ("paper", "hunt_crossley", "conservative")

# Numbers above 0, apart from those that may be 0; others have checks of their own.
_MAY_BE_ZERO = ("internal_sleeve_mass", "input_shaft_inertia", "contact_damping", "load_torque", "ramp_time")
_OTHER = ("shortening", "wheel_poisson_ratio", "sleeve_poisson_ratio")


@dataclass(frozen=True)
class CycloidalProfile:
    """Profile of a cycloidal wheel (paper A eq. 1, paper B eq. 1), lengths in m.

    The wheel has ``n_pins - 1`` lobes (z_s); the pins of radius q sit on a circle of radius e z_k / m, with
    the eccentricity e of the cams, the number of pins z_k and the ``shortening`` m, between 0 and 1.
    """

    eccentricity: float
    n_pins: int
    shortening: float
    pin_radius: float

    @property
    def n_lobes(self) -> int:
        """Number of lobes z_s."""
        return self.n_pins - 1

    @property
    def pin_circle_radius(self) -> float:
        """Radius R = e z_k / m of the circle on which the pins sit, in m."""
        return self.eccentricity * self.n_pins / self.shortening

    def trochoid(self, t: ArrayLike) -> Complex:
        """Path T(t) = R exp(it) + e exp(i z_k t) of a pin's centre, in m."""
        t = np.asarray(t, dtype=float)
        path = self.pin_circle_radius * np.exp(1j * t) + self.eccentricity * np.exp(1j * self.n_pins * t)
        return np.asarray(path, dtype=complex)

    def _tangent_factor(self, t: ArrayLike) -> Complex:
        """Factor g(t) = 1/m + exp(i z_s t) of the tangent T' = i e z_k exp(it) g."""
        turned = np.exp(1j * self.n_lobes * np.asarray(t, dtype=float))
        return np.asarray(1 / self.shortening + turned, dtype=complex)

    def normal(self, t: ArrayLike) -> Complex:
        """Outward unit normal of trochoid and profile at parameter t."""
        g = self._tangent_factor(t)
        return np.asarray(np.exp(1j * np.asarray(t, dtype=float)) * g / np.abs(g), dtype=complex)

    def point(self, t: ArrayLike) -> Complex:
        """Point of the wheel's profile at parameter t, in m."""
        return self.trochoid(t) - self.pin_radius * self.normal(t)

    def curvature(self, t: ArrayLike) -> Float:
        """Signed curvature of the trochoid in 1/m, positive where the profile is convex."""
        g2 = np.abs(self._tangent_factor(t)) ** 2
        cos_lobe = np.cos(self.n_lobes * np.asarray(t, dtype=float))
        return np.asarray(
            (1 + self.n_lobes * (1 + cos_lobe / self.shortening) / g2)
            / (self.eccentricity * self.n_pins * np.sqrt(g2))
        )

    def effective_radius(self, t: ArrayLike, clearance: float = 0.0) -> Float:
        """Effective contact radius q (1 - kappa q) of pin and profile in m (paper B eq. 14).

        It equals ``1 / (1/R_c + 1/q)`` with the radius R_c = 1/kappa - q - c of the profile, negative where
        concave, and the ``clearance`` c of the pins in m.
        """
        kappa, q = self.curvature(t), self.pin_radius
        return np.asarray(q * (1 - kappa * (q + clearance)) / (1 - kappa * clearance))

    def _path_speed(self, t: ArrayLike) -> Float:
        """Length |T'| of the trochoid per parameter at t, in m/rad."""
        return np.asarray(self.eccentricity * self.n_pins * np.abs(self._tangent_factor(t)))

    def flank_length(self, first: float = 0.0, last: float = 1.0) -> float:
        """Length of the profile between two places of a flank, from 0 (tip) to 1 (pit), in m."""
        t = np.linspace(first, last, 1001) * np.pi / self.n_lobes
        return float(np.trapezoid(self._path_speed(t) * (1 - self.curvature(t) * self.pin_radius), t))

    def deepest_wear(self, share: float, centre: float) -> float:
        """Return the largest radial wear that a pin can follow, in m; arguments as of ``LobeDefects``.

        Where the pins' path over the worn flank would be curved more tightly than a pin, the pin would rest
        on an edge instead of following it (to first order in the wear).
        """
        x = np.linspace(0, 1, 1001)
        flank = np.pi / self.n_lobes
        t = (centre + share * (x - 0.5)) * flank
        rate = 2 * np.pi / (share * flank)
        speed = self._path_speed(t)
        growth = np.gradient(np.log(speed), t)
        # Curvature that wear of 1 m adds: w'' along the path.
        sine, cosine = np.sin(2 * np.pi * x), np.cos(2 * np.pi * x)
        raised = (1 - cosine) / 2
        added = rate * (rate * (sine**2 / 2 + raised * cosine) - growth * raised * sine) / speed**2
        left = 1 / self.pin_radius - self.curvature(t)
        return float(np.min(left[added > 0] / added[added > 0]))

    def chord(self) -> tuple[complex, complex]:
        """End points (tip, pit) of the chord that replaces the worn half of lobe 0, in m."""
        return complex(self.point(0.0)), complex(self.point(np.pi / self.n_lobes))

    def outline(self, worn: tuple[int, ...] = (), points_per_lobe: int = 200) -> Complex:
        """Closed outline of the wheel with the chord at each worn lobe, for drawing: complex, in m.

        It has an even number of ``points_per_lobe``; ``worn`` lobes count from 0.
        """
        lobe_pitch = 2 * np.pi / self.n_lobes
        t = np.arange(self.n_lobes * points_per_lobe) * lobe_pitch / points_per_lobe
        outline = self.point(t)
        tip, pit = self.chord()
        share = np.arange(points_per_lobe // 2) / (points_per_lobe // 2)
        for lobe in worn:
            first = lobe * points_per_lobe
            turn = np.exp(1j * lobe * lobe_pitch)
            outline[first : first + points_per_lobe // 2] = turn * (tip + share * (pit - tip))
        return outline


@dataclass(frozen=True, repr=False)
class CycloidalGearbox(checks.Replaceable):
    """A single-stage cycloidal gearbox with two wheels, and the rig that drives and brakes it.

    Defaults are those of paper B (steel), where it states them. Fields marked *assumption* are stated in
    neither paper.

    Parameters
    ----------
    eccentricity : float
        e of the cams, in m (paper B table 1).
    n_pins : int
        Number of external sleeves z_k; each wheel has ``n_pins - 1`` lobes (z_s).
    shortening : float
        Short-width coefficient m (paper B table 1); the pins sit on a circle of radius e z_k / m.
    pin_radius : float
        Radius q of the external sleeves, in m.
    n_internal_sleeves : int
        Number of internal sleeves on the output shaft.
    internal_pitch_radius, internal_sleeve_radius : float
        Circle of the internal sleeves and their radius, in m. *Assumptions.*
    clearance : float
        Radial clearance of the internal sleeves in their holes, in m. *Assumption* (0).
    pin_clearance : float
        Clearance between wheels and external sleeves, in m: the wheels' outline lies so much deeper.
        *Assumption* (0).
    wheel_mass, wheel_inertia, internal_sleeve_mass, sleeve_inertia : float
        In kg and kg m2 (paper B table 2). ``sleeve_inertia`` matters only with friction.
    input_shaft_inertia, output_shaft_inertia : float
        In kg m2 (paper B table 2).
    wheel_youngs_modulus, wheel_poisson_ratio, sleeve_youngs_modulus, sleeve_poisson_ratio : float
        Materials, in Pa and 1 (paper A table 3).
    stiffness_scale : float
        Scale coefficient H of the contact stiffness (paper B eq. 14).
    contact_damping : float
        C in Ns/m (paper B: 150); for ``contact_law="hunt_crossley"`` relative damping in s/m.
    contact_ramp : float
        Penetration over which stiffness and damping rise from zero, in m (paper B eq. 12-13).
    contact_law : {"paper", "hunt_crossley", "conservative"}
        ``"paper"``: F = K d^1.5 + C d', K by local curvature. ``"hunt_crossley"``: damping times elastic
        force. ``"conservative"``: as ``"paper"`` with one effective radius for all contacts of a kind, so
        that the elastic forces have a potential.
    input_speed : float
        Angular speed of the input shaft after the ramp, in rad/s (500 RPM).
    load_torque : float
        Torque that resists the output after the ramp, in Nm.
    ramp_time : float
        Time over which drive and load rise from zero, in s.
    brake_inertia : float
        Inertia of the brake's rotor behind the torque meter, in kg m2; 0 as in the papers: the load acts on
        the output shaft. *Assumption* of the toolkit's rigs.
    meter_stiffness, meter_damping : float
        Torsional stiffness in Nm/rad and damping in Nms/rad between output shaft and brake. *Assumptions.*
    pin_radial_errors, pin_tangential_errors : tuple of float
        Position errors of the pins in m, one per pin; empty for none.
    lobe_pitch_errors : tuple of float
        Displacement of each lobe along the circle of the pins, in m: lobes of wheel 0, then of wheel 1; empty
        for none. The half from tip to pit is displaced as a whole; the other half passes to the next lobe.
    wheel_runouts : tuple of complex
        Offset of each wheel's profile from its bearing, in the wheel's frame, in m; empty for none.
    cam_errors : tuple of complex
        Offset of each cam's centre, in the frame of the input shaft, in m (a disturbance once per input
        turn); empty for none.
    profile_points : int
        Corners of a closed polyline in place of the smooth profile, as in the papers' discretisation (they
        do not state the number); 0 for the smooth profile. Slow, and coarse polylines add noise.
    sleeve_friction : float
        Coefficient of Coulomb friction between wheels and sleeves, which then spin on their axles.
        *Assumption* (0, as in the papers).
    sleeve_static_friction : float
        Coefficient at rest; 0 for ``sleeve_friction``.
    stribeck_speed : float
        Sliding speed in m/s at which the coefficient has fallen to 1/e of the difference. *Assumption.*
    sleeve_viscous_friction : float
        In Ns/m, while a contact is closed.
    journal_friction : float
        Friction of each sleeve on its axle: coefficient times the ratio of axle to sleeve radius.
    friction_transition_speed : float
        Sliding speed in m/s below which friction is proportional to the speed (tanh). Friction acts as a
        damper of coefficient times force over this speed; its rate times dt must stay below 2 (1 with the
        integrator ``"adams_bashforth"``), or it chatters and :func:`simulate` warns. The default suits
        coefficients up to 0.3 on worn steel lobes at dt = 1e-5 s. *Assumption.*
    input_bearing_torque, output_bearing_torque : float
        Coulomb friction of the shafts' bearings, in Nm. *Assumption* (0, as in the papers).
    input_bearing_viscosity, output_bearing_viscosity : float
        Viscous friction of the shafts' bearings, in Nms/rad.
    bearing_transition_speed : float
        Speed in rad/s below which the bearings' Coulomb friction is proportional to the speed (tanh).
        *Assumption.*

    Raises
    ------
    TypeError, ValueError
        If a parameter is of the wrong type, not finite or outside its range; the message names it.

    Examples
    --------
    >>> gearbox = CycloidalGearbox.steel()
    >>> gearbox.n_lobes, round(gearbox.pin_circle_radius * 1e3, 3)
    (15, 64.0)
    """

    eccentricity: float = 2.8e-3
    n_pins: int = 16
    shortening: float = 0.7
    pin_radius: float = 6e-3
    n_internal_sleeves: int = 8
    internal_pitch_radius: float = 36e-3
    internal_sleeve_radius: float = 6e-3
    clearance: float = 0.0
    pin_clearance: float = 0.0
    wheel_mass: float = 0.5998
    wheel_inertia: float = 1.57538e-4
    internal_sleeve_mass: float = 0.048
    sleeve_inertia: float = 1.1013e-5
    input_shaft_inertia: float = 1.846e-6
    output_shaft_inertia: float = 1.373e-4
    wheel_youngs_modulus: float = 200e9
    wheel_poisson_ratio: float = 0.3
    sleeve_youngs_modulus: float = 200e9
    sleeve_poisson_ratio: float = 0.3
    stiffness_scale: float = 0.01
    contact_damping: float = 150.0
    contact_ramp: float = 1e-5
    contact_law: str = "paper"
    input_speed: float = 500 * RPM
    load_torque: float = 22.0
    ramp_time: float = 0.2
    brake_inertia: float = 0.0
    meter_stiffness: float = 0.0
    meter_damping: float = 0.0
    pin_radial_errors: tuple[float, ...] = ()
    pin_tangential_errors: tuple[float, ...] = ()
    lobe_pitch_errors: tuple[float, ...] = ()
    wheel_runouts: tuple[complex, ...] = ()
    cam_errors: tuple[complex, ...] = ()
    profile_points: int = 0
    sleeve_friction: float = 0.0
    sleeve_static_friction: float = 0.0
    stribeck_speed: float = 0.05
    sleeve_viscous_friction: float = 0.0
    journal_friction: float = 0.0
    friction_transition_speed: float = 0.05
    input_bearing_torque: float = 0.0
    input_bearing_viscosity: float = 0.0
    output_bearing_torque: float = 0.0
    output_bearing_viscosity: float = 0.0
    bearing_transition_speed: float = 0.05

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            name, value = field.name, getattr(self, field.name)
            if name in _OTHER:
                checks.number(name, value)
            elif isinstance(field.default, float):
                may_be_zero = field.default == 0 or name in _MAY_BE_ZERO
                (checks.not_negative if may_be_zero else checks.positive)(name, value)
        for name in ("wheel_poisson_ratio", "sleeve_poisson_ratio"):
            if not 0 <= getattr(self, name) <= 0.5:
                raise ValueError(f"{name} must lie between 0 and 0.5, got {getattr(self, name)!r}")
        if 0 < self.sleeve_static_friction < self.sleeve_friction:
            raise ValueError(
                "sleeve_static_friction must be 0 (the same) or at least sleeve_friction "
                f"({self.sleeve_friction!r}), got {self.sleeve_static_friction!r}"
            )
        checks.one_of("contact_law", self.contact_law, CONTACT_LAWS)
        if self.brake_inertia > 0 and self.meter_stiffness == 0:
            raise ValueError("brake_inertia needs a meter_stiffness above 0 Nm/rad, got 0")
        self._check_teeth()
        for name, length in (
            ("pin_radial_errors", self.n_pins), ("pin_tangential_errors", self.n_pins),
            ("lobe_pitch_errors", 2 * self.n_lobes), ("wheel_runouts", 2), ("cam_errors", 2),
        ):  # fmt: skip
            values = checks.list_members(given := getattr(self, name))
            what, kinds = ("complex numbers", "iufc") if length == 2 else ("numbers", "iuf")
            if values is None or any(map(np.ndim, values)) or np.asarray(values).dtype.kind not in kinds:
                raise TypeError(
                    f"{name} must be a sequence of {what} (m), or empty, got {checks.repr_of(given)}"
                )
            if len(values) not in (0, length):
                raise ValueError(f"{name} must be empty or hold {length} values, got {len(values)}")
            if not np.all(np.isfinite(values)):
                raise ValueError(f"{name} must be finite, got {values!r}")
            object.__setattr__(self, name, tuple(np.asarray(values).tolist()))

    def __repr__(self) -> str:
        """Return the parameters that are not the defaults."""
        changed = {
            field.name: getattr(self, field.name)
            for field in dataclasses.fields(self)
            if getattr(self, field.name) != field.default
        }
        return f"{type(self).__name__}({', '.join(f'{name}={value!r}' for name, value in changed.items())})"

    def _check_teeth(self) -> None:
        """Check the numbers of sleeves and corners, and that the profile has no undercut."""
        if not 0 < self.shortening < 1:
            raise ValueError(f"shortening must lie between 0 and 1, got {self.shortening!r}")
        for name, least in (("n_pins", 4), ("n_internal_sleeves", 2)):
            object.__setattr__(self, name, checks.whole(name, getattr(self, name), least, MAX_SLEEVES))
        points = checks.whole("profile_points", self.profile_points, 0)
        if 0 < points < 4 * self.n_lobes:
            raise ValueError(f"profile_points must be 0 or at least 4 per lobe, got {points}")
        object.__setattr__(self, "profile_points", points)
        # The least radius of curvature of the pins' path, less the clearance.
        flank = np.linspace(0, math.pi / self.n_lobes, 181)
        most = 1 / float(self.profile.curvature(flank).max()) - self.pin_clearance
        if self.pin_radius >= most:
            raise ValueError(f"pin_radius must be below {most:.6g} m, else undercut, got {self.pin_radius!r}")

    @classmethod
    def steel(cls, **changes: Any) -> CycloidalGearbox:
        """Return the steel gearbox of paper B.

        Parameters
        ----------
        **changes : object
            New values by field, in SI units.

        Returns
        -------
        CycloidalGearbox
        """
        return cls(**changes)

    @classmethod
    def abs(cls, **changes: Any) -> CycloidalGearbox:
        """Return the gearbox with ABS wheels on steel sleeves of paper A (E 2.2 GPa, nu 0.37, C 20 Ns/m).

        Paper A does not state H for ABS; 0.2 puts the contact resonance at 400-500 Hz as in its fig. 20.
        *Assumption.*

        Parameters
        ----------
        **changes : object
            See :meth:`steel`.

        Returns
        -------
        CycloidalGearbox
        """
        return cls(
            wheel_youngs_modulus=2.2e9, wheel_poisson_ratio=0.37, contact_damping=20.0, stiffness_scale=0.2
        ).replace(**changes)

    @classmethod
    def printed_14_pin(cls, **changes: Any) -> CycloidalGearbox:
        """Return the printed drive of 14 pins and 13 lobes whose torque-deflection loops were measured.

        Dimensions from the repository JelmerV/Anti-Backlash-Cycloidal-Actuator (CC BY-SA 4.0), its clearance
        of 0.05 mm at pins and rollers. *Assumptions*: the rollers' stated 9 mm is their diameter (as a radius
        they would overlap), a modulus of 2.5 GPa, two wheels of 0.08 kg, shafts' inertias, H as for
        :meth:`abs`.

        Parameters
        ----------
        **changes : object
            See :meth:`steel`.

        Returns
        -------
        CycloidalGearbox
        """
        return cls(
            n_pins=14, eccentricity=1.5e-3, shortening=1.5e-3 * 14 / 34e-3, pin_radius=3.5e-3,
            pin_clearance=5e-5, internal_pitch_radius=20e-3, internal_sleeve_radius=4.5e-3, clearance=5e-5,
            wheel_mass=0.08, wheel_inertia=4e-5, internal_sleeve_mass=0.005, input_shaft_inertia=5e-6,
            output_shaft_inertia=5e-5, wheel_youngs_modulus=2.5e9, wheel_poisson_ratio=0.37,
            sleeve_youngs_modulus=2.5e9, sleeve_poisson_ratio=0.37, contact_damping=20.0, stiffness_scale=0.2,
        ).replace(**changes)  # fmt: skip

    @property
    def n_lobes(self) -> int:
        """Number of lobes z_s of each wheel; also the reduction ratio."""
        return self.n_pins - 1

    @property
    def profile(self) -> CycloidalProfile:
        """Profile of the wheels."""
        return CycloidalProfile(self.eccentricity, self.n_pins, self.shortening, self.pin_radius)

    @property
    def outline_profile(self) -> CycloidalProfile:
        """Profile whose points are the wheels' outline, ``pin_clearance`` deeper; the same trochoid."""
        depth = self.pin_radius + self.pin_clearance
        return CycloidalProfile(self.eccentricity, self.n_pins, self.shortening, depth)

    @property
    def pin_circle_radius(self) -> float:
        """Radius e z_k / m of the circle of the external sleeves, in m."""
        return self.profile.pin_circle_radius

    @property
    def output_inertia(self) -> float:
        """Inertia of output shaft and internal sleeves (as m r^2) about the origin, in kg m2."""
        sleeves = self.n_internal_sleeves * self.internal_sleeve_mass * self.internal_pitch_radius**2
        return self.output_shaft_inertia + sleeves

    @property
    def has_friction(self) -> bool:
        """True if sleeves or shafts' bearings rub; the sleeves then spin."""
        return any(
            getattr(self, name) > 0
            for name in (
                "sleeve_friction", "sleeve_static_friction", "sleeve_viscous_friction", "journal_friction",
                "input_bearing_torque", "input_bearing_viscosity", "output_bearing_torque",
                "output_bearing_viscosity",
            )
        )  # fmt: skip

    @property
    def input_speed_hz(self) -> float:
        """Input speed in revolutions per second."""
        return self.input_speed / (2 * math.pi)

    def with_brake(self, inertia: float, stiffness: float, damping_ratio: float) -> CycloidalGearbox:
        """Return the gearbox with a brake rotor behind a compliant torque meter.

        Parameters
        ----------
        inertia : float
            Rotor's inertia in kg m2.
        stiffness : float
            Torsional stiffness of shaft and torque meter in Nm/rad.
        damping_ratio : float
            Share of critical damping of the rotor on that stiffness: c = 2 ratio sqrt(k J).

        Returns
        -------
        CycloidalGearbox
        """
        checks.not_negative("inertia", inertia)
        checks.not_negative("stiffness", stiffness)
        if not 0 <= checks.number("damping_ratio", damping_ratio) < 1:
            raise ValueError(f"damping_ratio must lie in [0, 1), got {damping_ratio!r}")
        damping = 2 * damping_ratio * math.sqrt(stiffness * inertia)
        return self.replace(brake_inertia=inertia, meter_stiffness=stiffness, meter_damping=damping)
