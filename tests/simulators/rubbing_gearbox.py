"""The 28 bodies with friction: every sleeve turns on its axle and rubs on the wheels."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from benchmarks import reference_gearbox as bodies
from benchmarks.reference_gearbox import ReferenceGearbox

Real = NDArray[np.float64]
Plane = NDArray[np.complex128]


class RubbingSolution(NamedTuple):
    """One instant of the gearbox with friction, SI units."""

    theta_acceleration: Real  #: (2,): of the wheels in rad/s2
    psi_acceleration: float  #: of the output shaft in rad/s2
    spin_acceleration: Real  #: (n_pins + 8,): of external, then internal sleeves in rad/s2
    input_torque: float  #: of the cams and of the input shaft's bearing in Nm
    output_torque: float  #: that the output shaft passes on behind its bearing in Nm = load - J_out psi''
    sleeve_power: float  #: of the friction between sleeves and wheels in W, both sides
    journal_power: float  #: of the sleeves' axles in W
    bearing_power: float  #: of the shafts' bearings in W


class RubbingGearbox(ReferenceGearbox):
    """A :class:`~benchmarks.reference_gearbox.ReferenceGearbox` with the friction of its gearbox.

    The load on an axle is the resulting force of both wheels on the sleeve.
    """

    def _friction(self, slip: Real, force: Real) -> Real:
        """Force in N along ``slip`` (m/s) of contacts pressed with ``force`` (N)."""
        g = self.gearbox
        fall = np.exp(-((slip / g.stribeck_speed) ** 2))
        static = g.sleeve_static_friction or g.sleeve_friction
        coefficient = g.sleeve_friction + (static - g.sleeve_friction) * fall
        dry = coefficient * force * np.tanh(slip / g.friction_transition_speed)
        return np.asarray(dry + g.sleeve_viscous_friction * slip * (force > 0))

    def rubbing_accelerations(
        self, phi: float, omega: float, alpha: float, angles: ArrayLike, rates: ArrayLike, load_torque: float
    ) -> RubbingSolution:
        """Solve paper B eq. 2 with friction among the applied forces.

        Parameters as in :meth:`ReferenceGearbox.accelerations`, except that ``rates`` (3 + n_pins + 8,) holds
        the sleeves' angular speeds in rad/s after those of wheels and output, external, then internal.
        """
        u = self.coordinates(phi, angles)
        shafts, external, internal = np.split(np.asarray(rates, dtype=float), [3, 3 + self.gearbox.n_pins])
        v = self.velocities(u, omega, shafts)
        rate = v.reshape(-1, 3)[:, 2]  # a view
        rate[bodies.EXTERNAL.start :], rate[bodies.INTERNAL] = external, internal
        (at, _), (_, spin) = bodies._split_bodies(u), bodies._split_bodies(v)
        _, outside, _, inside = self.contact_forces(u, v)
        rubbing, pressed = self._sleeve_friction(u, v, (outside, inside))
        journals, bearings = self._journal_friction(spin, pressed), self._bearing_friction(spin)

        d = self.jacobian(u)
        system = np.block([[self.mass_matrix, -d.T], [d, np.zeros((len(d), len(d)))]])
        applied = self.applied_forces(at, (outside, inside), load_torque) + rubbing + journals + bearings
        solved = np.linalg.solve(system, np.concatenate([applied, self.gamma(u, v, alpha)]))
        acceleration, driver = solved[2 : len(u) : 3], float(solved[-1])
        psi = float(acceleration[bodies.OUTPUT])
        return RubbingSolution(
            theta_acceleration=acceleration[bodies.WHEELS],
            psi_acceleration=psi,
            spin_acceleration=np.append(acceleration[bodies.EXTERNAL.start :], acceleration[bodies.INTERNAL]),
            input_torque=driver - self.gearbox.input_shaft_inertia * alpha,
            output_torque=load_torque - self.gearbox.output_inertia * psi,
            sleeve_power=float(rubbing @ v),
            journal_power=float(journals @ v),
            bearing_power=float(bearings @ v),
        )

    def _sleeve_friction(self, u: Real, v: Real, pressing: tuple[Plane, Plane]) -> tuple[Real, Plane]:
        """Friction of sleeves on wheels, which they press with the forces ``pressing``.

        Returns forces and moments on all bodies, and the resultant on every sleeve.
        """
        (at, _), (speed, spin) = bodies._split_bodies(u), bodies._split_bodies(v)
        force, moment = np.zeros(len(at), dtype=complex), np.zeros(len(at))
        pressed = force.copy()
        for sleeves, vector in zip((bodies.EXTERNAL, bodies.INTERNAL), pressing, strict=True):
            size = np.abs(vector)
            toward = np.where(size > 0, vector, 1.0) / np.where(size > 0, size, 1.0)  # from sleeve to wheel
            radius = (
                self.gearbox.pin_radius if sleeves == bodies.EXTERNAL else self.gearbox.internal_sleeve_radius
            )
            point = at[sleeves] + radius * toward
            of_wheel = speed[bodies.WHEELS, None] + 1j * spin[bodies.WHEELS, None] * (
                point - at[bodies.WHEELS, None]
            )
            of_sleeve = speed[sleeves] + 1j * spin[sleeves] * radius * toward
            along = 1j * toward
            rub = self._friction(bodies._dot_of(of_wheel - of_sleeve, along), size) * along  # on the sleeve
            force[sleeves] += rub.sum(axis=0)
            force[bodies.WHEELS] -= rub.sum(axis=1)
            moment[sleeves] += bodies._cross_of(point - at[sleeves], rub).sum(axis=0)
            moment[bodies.WHEELS] -= bodies._cross_of(point - at[bodies.WHEELS, None], rub).sum(axis=1)
            pressed[sleeves] += (rub - vector).sum(axis=0)
        return bodies._join_bodies(force[: bodies.HOUSING], moment), pressed

    def _journal_friction(self, spin: Real, pressed: Plane) -> Real:
        """Moments of the sleeves' axles; external ones belong to the housing, internal ones to the output."""
        moment = np.zeros(spin.size)
        for sleeves, parent, radius in (
            (bodies.EXTERNAL, bodies.HOUSING, self.gearbox.pin_radius),
            (bodies.INTERNAL, bodies.OUTPUT, self.gearbox.internal_sleeve_radius),
        ):
            turning = spin[sleeves] - spin[parent]
            couple = self.gearbox.journal_friction * radius * np.abs(pressed[sleeves])
            couple = couple * np.tanh(turning * radius / self.gearbox.friction_transition_speed)
            moment[sleeves] -= couple
            moment[parent] += couple.sum()
        return _moments(moment)

    def _bearing_friction(self, spin: Real) -> Real:
        """Moments of the shafts' bearings."""
        moment = np.zeros(spin.size)
        for shaft, coulomb, viscous in (
            (bodies.INPUT, self.gearbox.input_bearing_torque, self.gearbox.input_bearing_viscosity),
            (bodies.OUTPUT, self.gearbox.output_bearing_torque, self.gearbox.output_bearing_viscosity),
        ):
            moment[shaft] -= coulomb * np.tanh(spin[shaft] / self.gearbox.bearing_transition_speed)
            moment[shaft] -= viscous * spin[shaft]
        return _moments(moment)


def _moments(moment: Real) -> Real:
    """Applied forces that are moments only, from those on all bodies and the housing."""
    return bodies._join_bodies(np.zeros(moment.size - 1, dtype=complex), moment)
