"""The papers' own formulation of the gearbox: 28 planar bodies held together by Lagrange multipliers.

Two shafts, two wheels, 8 internal and 16 external sleeves have 84 coordinates and 57 constraints (equations
2-16 in section 3 of paper B, the analysis of lobe defects with coherence and Morris wavelets).
:class:`ReferenceGearbox` solves this system in plain NumPy, a thousand times slower than
:func:`~cyclofeat.simulators.simulate`, whose reduced model gives the same accelerations, forces and torques
to rounding.

Bodies have coordinates x, y and angle, in the order input shaft, output shaft, wheel 0, wheel 1, 8 internal
sleeves, ``n_pins`` external sleeves. Each has one revolute joint, whose two constraints come in the same
order; the driver of the input shaft is the last. Angles count counter-clockwise. The output turns against the
input and a positive load torque resists it. Plane vectors are complex numbers x + iy.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cyclofeat.simulators.defects import LobeDefects
from cyclofeat.simulators.gearbox import CycloidalGearbox

Real = NDArray[np.float64]
Plane = NDArray[np.complex128]

N_INTERNAL = 8
HOUSING, INPUT, OUTPUT = -1, 0, 1  # indices of bodies; the housing is not a body and comes last
WHEELS, INTERNAL, EXTERNAL = slice(2, 4), slice(4, 12), slice(12, -1)
INPUT_SHAFT_MASS, OUTPUT_SHAFT_MASS = 0.2341, 1.6345  # kg (paper B table 2)
RAMP_DEPTH = 1e-5  # m: stiffness and damping reach their full value there (paper B eq. 12-13)


class Solution(NamedTuple):
    """Accelerations, reactions and contact forces of one instant, SI units."""

    accelerations: Real  #: (n_coordinates,): x'', y'' in m/s2 and angle'' in rad/s2, body by body
    theta_acceleration: Real  #: (2,): theta_1'', theta_2'' of the wheels in rad/s2
    psi_acceleration: float  #: psi'' of the output shaft in rad/s2
    multipliers: Real  #: (n_constraints,): force of its joint on each body (x, y) in N, then the driver in Nm
    cam_reactions: Real  #: (2, 2): force R_k of cam k on wheel k in N, the multipliers of the wheels' joints
    input_torque: float  #: sum of c_k x R_k over the cams in Nm (paper B section 4)
    driver_torque: float  #: multiplier of the driver in Nm = input_torque + input shaft's inertia times alpha
    output_torque: float  #: minus the internal sleeves' moment on the output in Nm = load - J_out psi''
    external_force: Real  #: (2, n_pins): magnitudes in N, profile and chord contact of a sleeve added
    internal_force: Real  #: (2, 8): magnitudes in N
    external_vector: Real  #: (2, n_pins, 2): resulting force of the sleeve on the wheel in N, fixed frame
    internal_vector: Real  #: (2, 8, 2): likewise


@dataclass(frozen=True, eq=False)
class ReferenceGearbox:
    """The multibody gearbox of paper B, solved as written there (eq. 2).

    Parameters
    ----------
    gearbox : CycloidalGearbox
        With an even number of pins, so that two equal wheels mesh half a turn apart, 8 internal sleeves and
        the papers' contact law. Clearance of the pins, errors of lobes and cams, friction and brake are not
        taken into account.
    defects : LobeDefects
        Worn lobes. A chord replaces the half from the tip to the next pit (paper B section 2), with ``depth``
        as the weight of the worn outline's force. Radial wear sinks the path of the sleeves' centres.
    """

    gearbox: CycloidalGearbox = field(default_factory=CycloidalGearbox)
    defects: LobeDefects = field(default_factory=LobeDefects)

    # The wheel in its own frame -----------------------------------------------------------------------------

    @property
    def n_lobes(self) -> int:
        """Number of lobes z_s of a wheel."""
        return self.gearbox.n_pins - 1

    def trochoid(self, t: ArrayLike, derivative: int = 0) -> Plane:
        """Centre (complex, m) of a sleeve that touches the profile at parameter ``t`` (rad), or a derivative.

        Paper B eq. 1 without its last term: T(t) = e z_k / m e^{it} + e e^{i z_k t}.
        """
        t, z = np.asarray(t, dtype=float), self.gearbox.n_pins
        ring = z / self.gearbox.shortening * 1j**derivative * np.exp(1j * t)
        return np.asarray(self.gearbox.eccentricity * (ring + (1j * z) ** derivative * np.exp(1j * z * t)))

    def normal(self, t: ArrayLike) -> Plane:
        """Outward unit normal (complex) of trochoid and profile at parameter ``t`` (rad)."""
        tangent = self.trochoid(t, 1)
        return np.asarray(-1j * tangent / np.abs(tangent))

    def profile(self, t: ArrayLike) -> Plane:
        """Point (complex, m) of the healthy wheel profile at parameter ``t`` (rad): paper B eq. 1."""
        return self.trochoid(t) - self.gearbox.pin_radius * self.normal(t)

    def curvature(self, t: ArrayLike) -> Real:
        """Curvature of the trochoid in 1/m, positive where convex, at parameter ``t`` (rad)."""
        tangent = self.trochoid(t, 1)
        return np.asarray(_cross_of(tangent, self.trochoid(t, 2)) / np.abs(tangent) ** 3)

    def foot_point(self, p: Plane) -> Real:
        """Parameter (rad) of the trochoid's nearest point to each of the points ``p`` (wheel frame, m).

        Newton's method on (p - T) . T' = 0, bracketed around the nearest grid point: beyond the pit's radius
        of curvature, half a millimetre, the derivative has the wrong sign.
        """
        grid = np.linspace(0.0, 2 * np.pi, 64 * self.n_lobes, endpoint=False)
        t = grid[np.argmin(np.abs(p[..., None] - self.trochoid(grid)), axis=-1)]
        low, high = t - grid[1], t + grid[1]
        for _ in range(60):
            offset, tangent = p - self.trochoid(t), self.trochoid(t, 1)
            ahead = _dot_of(offset, tangent)
            slope = _dot_of(offset, self.trochoid(t, 2)) - _dot_of(tangent, tangent)
            low, high = np.where(ahead > 0, t, low), np.where(ahead > 0, high, t)
            newton = t - ahead / np.where(slope < 0, slope, -np.inf)
            trusted = (slope < 0) & (newton >= low) & (newton <= high)
            previous, t = t, np.where(trusted, newton, (low + high) / 2)
            if np.abs(t - previous).max() < 1e-14:
                break
        return np.asarray(t)

    def worn_foot(self, p: Plane) -> tuple[Real, Plane, Plane]:
        """Parameter, point and outward normal of the sleeves' path over radial wear, nearest to ``p`` (2, n).

        Healthy flanks have the trochoid. The nearest point lies within some micrometres of that on the
        trochoid, from which steps of Gauss and Newton find it.
        """
        t = self.foot_point(p)
        flank = np.pi / self.n_lobes
        centre, half = self.defects.wear_centre, self.defects.wear_share / 2
        begin, end = (centre - half) * flank, (centre + half) * flank
        frequency = 2 * np.pi / (end - begin)
        depths = np.zeros((2, self.n_lobes))
        for wheel in self.defects.wheels:
            depths[wheel, list(self.defects.worn_lobes)] = 1e-6 * np.asarray(self.defects.wear_um or 0.0)
        for _ in range(60):
            # Wear (m), and its derivative (m/rad).
            lobe, past_tip = np.divmod(t % (2 * np.pi), 2 * flank)
            depth = np.take_along_axis(depths, lobe.astype(int) % self.n_lobes, axis=1)
            depth = np.where((past_tip > begin) & (past_tip < end), depth, 0.0)
            half_angle = frequency * (past_tip - begin) / 2
            sine, cosine = np.sin(half_angle), np.cos(half_angle)
            wear, slope = depth * sine**4, 2 * depth * frequency * sine**3 * cosine
            normal, tangent = self.normal(t), self.trochoid(t, 1)
            path = self.trochoid(t) - wear * normal
            along = tangent * (1 - wear * self.curvature(t)) - slope * normal
            ahead = np.where(wear > 0, _dot_of(p - path, along) / np.abs(along) ** 2, 0.0)
            if np.abs(ahead).max() < 1e-15:
                break
            t = t + ahead
        return t, path, np.asarray(-1j * along / np.abs(along))

    # Contact ------------------------------------------------------------------------------------------------

    def normal_force(self, gap: Real, gap_rate: Real, effective_radius: ArrayLike) -> Real:
        """Contact force in N (paper B eq. 11-16), never tensile.

        ``gap`` (m) is negative in penetration and ``gap_rate`` (m/s) its rate; ``effective_radius`` (m) is
        R_c R_p / (R_c + R_p) with the sign of the wheel's curvature.
        """
        g = self.gearbox
        compliance = (1 - g.wheel_poisson_ratio**2) / g.wheel_youngs_modulus
        compliance += (1 - g.sleeve_poisson_ratio**2) / g.sleeve_youngs_modulus
        stiffness = 4 * g.stiffness_scale / (3 * compliance) * np.sqrt(effective_radius)
        depth = np.maximum(-gap, 0.0)
        ramp = np.minimum(depth / RAMP_DEPTH, 1.0)
        return np.asarray(np.maximum(ramp * (stiffness * depth**1.5 - g.contact_damping * gap_rate), 0.0))

    def _outline_contact(self, p: Plane, rate: Plane) -> tuple[Real, Plane]:
        """Magnitudes and vectors (N, wheel frame) of the external sleeves' forces on the wheels, (2, n_pins).

        Tangents at tips and pits are perpendicular to the radius: the polar angle says which side a sleeve is
        on. Magnitudes of simultaneous contacts add.
        """
        q, pitch = self.gearbox.pin_radius, 2 * np.pi / self.n_lobes
        lobe, past_tip = np.divmod(np.angle(p) % (2 * np.pi), pitch)
        lobe %= self.n_lobes  # rounding of an angle of -0
        on_worn = np.isin(lobe, self.defects.worn_lobes) & np.isin([[0], [1]], self.defects.wheels)
        chord_width = np.where(on_worn, self.defects.depth, 0.0)
        end_width = np.where(past_tip < pitch / 2, chord_width, 0.0)
        # Radial wear leaves the stiffness as it was.
        t, path, along = self.worn_foot(p)
        contacts = [(1 - end_width, _dot_of(p - path, along), along, q * (1 - self.curvature(t) * q))]
        # The chord of the worn lobe continues beyond the pit: in the re-entrant corner a sleeve touches chord
        # and flank at once. In the frame of the lobe:
        turn = np.exp(1j * lobe * pitch)
        tip, pit = self.profile([0.0, pitch / 2])
        chord_normal = -1j * (pit - tip) / abs(pit - tip)
        from_tip, from_pit = p / turn - tip, p / turn - pit
        on_vertex = _dot_of(from_tip, pit - tip) < 0
        normal = np.where(on_vertex, from_tip / np.abs(from_tip), chord_normal)
        # The effective radius follows the normal around the vertex, from 0 at the tip: no jump of stiffness.
        turned = normal.imag / chord_normal.imag
        radius = q * (1 - (1 - turned) * self.curvature(0.0) * q)
        contacts.append((chord_width, _dot_of(from_tip, normal) - q, turn * normal, radius))
        # A displaced sleeve before the pit may touch the flank behind it, whose nearest point is its end.
        distance = np.abs(from_pit)
        radius = q * (1 - self.curvature(pitch / 2) * q)
        contacts.append((end_width, distance - q, turn * from_pit / distance, radius))
        magnitude, vector = np.zeros(p.shape), np.zeros(p.shape, dtype=complex)
        for width, gap, direction, radius in contacts:
            force = self.normal_force(gap, _dot_of(rate, direction), radius)
            magnitude += width * force
            vector -= width * force * direction
        return magnitude, vector

    def contact_forces(self, coordinates: Real, velocities: Real) -> tuple[Real, Plane, Real, Plane]:
        """Magnitudes (N) and vectors on the wheel (complex, N, fixed frame) of the contact forces.

        From coordinates and velocities (n_coordinates,) in SI units: external sleeves, (2, n_pins) each, then
        internal sleeves, (2, 8) each.
        """
        (at, angle), (speed, spin) = _split_bodies(coordinates), _split_bodies(velocities)
        wheel, wheel_speed, wheel_spin = at[WHEELS, None], speed[WHEELS, None], 1j * spin[WHEELS, None]
        turn = np.exp(1j * angle[WHEELS, None])
        # The holes face the internal sleeves in the rest position.
        facing = self._internal_points * np.exp(-1j * self.rest_angles(0.0)[:2, None])
        arm, hole = at[EXTERNAL] - wheel, turn * facing
        rate = speed[EXTERNAL] - wheel_speed - wheel_spin * arm
        centre = np.array(self.gearbox.wheel_runouts or (0j, 0j))[:, None]
        external_force, external_vector = self._outline_contact(arm / turn - centre, rate / turn)
        rate = speed[INTERNAL] - wheel_speed - wheel_spin * hole
        # Magnitudes and vectors (N) of the forces on a wheel; ``offset`` is sleeve minus hole centre (m).
        offset = at[INTERNAL] - wheel - hole
        distance = np.abs(offset)
        outward = offset / np.where(distance > 0, distance, 1.0)
        play = self.gearbox.eccentricity + self.gearbox.clearance
        radius = self.gearbox.internal_sleeve_radius * (self.gearbox.internal_sleeve_radius + play) / play
        force = self.normal_force(play - distance, -_dot_of(rate, outward), radius)
        hole_contact = force, force * outward
        return external_force, external_vector * turn, *hole_contact

    # Bodies and joints --------------------------------------------------------------------------------------

    @property
    def n_bodies(self) -> int:
        """Number of bodies: two shafts, two wheels and all sleeves."""
        return EXTERNAL.start + self.gearbox.n_pins

    def rest_angles(self, phi: float) -> Real:
        """theta_1, theta_2, psi (rad) without load at input angle ``phi`` (rad): all contacts just touch."""
        theta = -(phi + np.pi) / self.n_lobes
        return np.array([theta, theta + np.pi, -phi / self.n_lobes])

    @cached_property
    def _internal_points(self) -> Plane:
        return np.asarray(
            self.gearbox.internal_pitch_radius * np.exp(2j * np.pi * np.arange(N_INTERNAL) / N_INTERNAL)
        )

    @cached_property
    def _joint_mounts(self) -> tuple[NDArray[np.intp], Plane]:
        """Parent of every body's joint and mounting point in the parent's frame (complex, m)."""
        g = self.gearbox
        parents = [HOUSING] * 2 + [INPUT] * 2 + [OUTPUT] * N_INTERNAL + [HOUSING] * g.n_pins
        cams = g.eccentricity * np.array([1.0, -1.0])
        angle = 2 * np.pi * np.arange(g.n_pins) / g.n_pins
        errors = np.asarray(g.pin_radial_errors or 0.0) + 1j * np.asarray(g.pin_tangential_errors or 0.0)
        pins = (g.eccentricity * g.n_pins / g.shortening + errors) * np.exp(1j * angle)
        return np.array(parents), np.concatenate([[0, 0], cams, self._internal_points, pins])

    @cached_property
    def mass_matrix(self) -> Real:
        """M of paper B eq. 2 in kg and kg m2, shape (n_coordinates, n_coordinates)."""
        g = self.gearbox
        count = [1, 1, 2, N_INTERNAL + g.n_pins]
        mass = [INPUT_SHAFT_MASS, OUTPUT_SHAFT_MASS, g.wheel_mass, g.internal_sleeve_mass]
        inertia = [g.input_shaft_inertia, g.output_shaft_inertia, g.wheel_inertia, g.sleeve_inertia]
        return np.diag(np.repeat(np.column_stack([mass, mass, inertia]), count, axis=0).ravel())

    def coordinates(self, phi: float, angles: ArrayLike) -> Real:
        """Coordinates u (n_coordinates,) that satisfy every joint, from phi and the three angles (rad)."""
        angle = self._body_angles(phi, angles)
        parents, points = self._joint_mounts
        return _join_bodies(
            np.exp(1j * angle[parents]) * points, angle
        )  # every parent turns about the origin

    def velocities(self, coordinates: Real, omega: float, rates: ArrayLike) -> Real:
        """Velocities u' (n_coordinates,) that satisfy every joint, from omega and three rates (rad/s)."""
        spin = self._body_angles(omega, rates)
        at, _ = _split_bodies(coordinates)
        return _join_bodies(1j * spin[self._joint_mounts[0]] * at[:HOUSING], spin)

    def _body_angles(self, phi: float, angles: ArrayLike) -> Real:
        """Angle of every body and the housing; sleeves do not turn without friction."""
        theta_1, theta_2, psi = np.asarray(angles, dtype=float)
        return np.concatenate([[phi, psi, theta_1, theta_2], np.zeros(N_INTERNAL + self.gearbox.n_pins + 1)])

    def constraints(self, coordinates: Real, phi: float) -> Real:
        """Phi(u, t), shape (n_constraints,), in m and, for the driver (paper B eq. 3), rad."""
        at, angle = _split_bodies(coordinates)
        parents, points = self._joint_mounts
        misfit = at[:HOUSING] - at[parents] - np.exp(1j * angle[parents]) * points
        return np.append(_as_xy(misfit), angle[INPUT] - phi)

    def jacobian(self, coordinates: Real) -> Real:
        """D = dPhi/du of paper B eq. 2, shape (n_constraints, n_coordinates)."""
        _, angle = _split_bodies(coordinates)
        parents, points = self._joint_mounts
        lever = _as_xy(1j * np.exp(1j * angle[parents]) * points)
        # joint, direction, body or housing, coordinate
        d = np.zeros((self.n_bodies, 2, self.n_bodies + 1, 3))
        for body, parent in enumerate(parents):
            d[body, :, body, :2] = np.eye(2)
            d[body, :, parent, :2] = -np.eye(2)
            d[body, :, parent, 2] = -lever[body]
        driver = np.zeros(3 * self.n_bodies)
        driver[3 * INPUT + 2] = 1.0
        return np.vstack([d[:, :, :HOUSING].reshape(2 * self.n_bodies, -1), driver])

    def gamma(self, coordinates: Real, velocities: Real, alpha: float) -> Real:
        """Right-hand side of D u'' = gamma, (n_constraints,): centripetal in m/s2, then alpha in rad/s2."""
        (_, angle), (_, spin) = _split_bodies(coordinates), _split_bodies(velocities)
        parents, points = self._joint_mounts
        return np.append(_as_xy(-(spin[parents] ** 2) * np.exp(1j * angle[parents]) * points), alpha)

    def applied_forces(self, at: Plane, on_wheels: tuple[Plane, Plane], load_torque: float) -> Real:
        """F of paper B eq. 2; normal forces do not turn sleeves."""
        force, moment = np.zeros(len(at), dtype=complex), np.zeros(len(at))
        moment[OUTPUT] = load_torque
        for sleeves, vectors in zip((EXTERNAL, INTERNAL), on_wheels, strict=True):
            force[sleeves] -= vectors.sum(axis=0)
            force[WHEELS] += vectors.sum(axis=1)
            moment[WHEELS] += _cross_of(at[sleeves] - at[WHEELS, None], vectors).sum(axis=1)
        return _join_bodies(force[:HOUSING], moment)

    # Motion -------------------------------------------------------------------------------------------------

    def accelerations(
        self, phi: float, omega: float, alpha: float, angles: ArrayLike, rates: ArrayLike, load_torque: float
    ) -> Solution:
        """Solve [[M, -D^T], [D, 0]] [u''; lambda] = [F; gamma] (paper B eq. 2) at one instant.

        ``phi`` (rad), ``omega`` and ``alpha`` are of the input shaft; ``angles`` and ``rates``, shape (3,),
        those of theta_1, theta_2, psi. A positive ``load_torque`` in Nm resists the output when ``omega`` is
        positive.
        """
        u = self.coordinates(phi, angles)
        v = self.velocities(u, omega, rates)
        at, _ = _split_bodies(u)
        external_force, external_vector, internal_force, internal_vector = self.contact_forces(u, v)
        d = self.jacobian(u)
        system = np.block([[self.mass_matrix, -d.T], [d, np.zeros((len(d), len(d)))]])
        forces = self.applied_forces(at, (external_vector, internal_vector), load_torque)
        solved = np.linalg.solve(system, np.concatenate([forces, self.gamma(u, v, alpha)]))
        acceleration, multipliers = solved[: len(u)], solved[len(u) :]
        reactions = multipliers[:-1].reshape(-1, 2)[WHEELS]
        return Solution(
            accelerations=acceleration,
            theta_acceleration=acceleration[2::3][WHEELS],
            psi_acceleration=float(acceleration[2::3][OUTPUT]),
            multipliers=multipliers,
            cam_reactions=reactions,
            input_torque=float(_cross_of(at[WHEELS], reactions @ np.array([1.0, 1j])).sum()),
            driver_torque=float(multipliers[-1]),
            output_torque=float(_cross_of(at[INTERNAL], internal_vector).sum()),
            external_force=external_force,
            internal_force=internal_force,
            external_vector=_as_xy(external_vector),
            internal_vector=_as_xy(internal_vector),
        )


def _dot_of(a: Any, b: Any) -> Real:
    """Scalar product of plane vectors given as complex numbers."""
    return np.asarray((a * np.conj(b)).real)


def _cross_of(a: Plane, b: Plane) -> Real:
    """z component of the vector product of plane vectors given as complex numbers."""
    return np.asarray((np.conj(a) * b).imag)


def _as_xy(vectors: Plane) -> Real:
    """Plane vectors given as complex numbers, with a last axis for x and y instead."""
    return np.stack([vectors.real, vectors.imag], axis=-1)


def _join_bodies(position: Plane, angle: Real) -> Real:
    """Coordinates, body by body, from the positions of the bodies and the angles of bodies and housing."""
    return np.column_stack([position.real, position.imag, angle[:HOUSING]]).ravel()


def _split_bodies(coordinates: Real) -> tuple[Plane, Real]:
    """Positions (complex) and angles of all bodies and, last and all zero, the housing."""
    x, y, angle = np.append(coordinates, np.zeros(3)).reshape(-1, 3).T
    return x + 1j * y, angle
