"""Random errors of single assemblies: without them every simulated recording of a class is the same."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from cyclofeat.simulators.gearbox import CycloidalGearbox


@dataclass(frozen=True)
class AssemblyTolerances:
    """Spread between assemblies of one gearbox on one kind of rig. All values are *assumptions*.

    Parameters
    ----------
    pin_position : float
        Standard deviation of each pin's radial and of its tangential position error, in m.
    runout : float
        Standard deviation, by component, of the offset of each wheel's profile from its bearing, in m.
    stiffness, damping : float
        Half width of the uniform relative spread of contact stiffness and damping.
    load, speed : float
        Half width of the uniform relative spread of load torque and input speed.
    clearance : tuple of float
        Lower and upper end of the uniform radial clearance of the internal sleeves, in m.

    Examples
    --------
    >>> drawn = AssemblyTolerances().draw(CycloidalGearbox.steel(), seed=1)
    >>> len(drawn.pin_radial_errors)
    16
    """

    pin_position: float = 10e-6
    runout: float = 5e-6
    stiffness: float = 0.25
    damping: float = 0.25
    load: float = 0.03
    speed: float = 0.01
    clearance: tuple[float, float] = (0.0, 30e-6)

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            values = np.atleast_1d(getattr(self, field.name))
            if not np.all(np.isfinite(values)) or np.any(values < 0):
                raise ValueError(
                    f"{field.name} must be finite and not negative, got {getattr(self, field.name)!r}"
                )
        for name in ("stiffness", "damping", "load", "speed"):
            if getattr(self, name) >= 1:
                raise ValueError(f"{name} is a relative half width below 1, got {getattr(self, name)!r}")
        if np.shape(self.clearance) != (2,) or self.clearance[0] > self.clearance[1]:
            raise ValueError(f"clearance must be (lower, upper) in m, got {self.clearance!r}")

    def draw(self, gearbox: CycloidalGearbox, seed: int | np.random.Generator) -> CycloidalGearbox:
        """One assembly: the gearbox with errors drawn from these tolerances.

        Parameters
        ----------
        gearbox : CycloidalGearbox
            Nominal gearbox; its own pin errors, runouts and clearance are replaced.
        seed : int or numpy.random.Generator
        """
        random = np.random.default_rng(seed)
        stiffness, damping, load, speed = 1 + random.uniform(-1, 1, 4) * (
            self.stiffness, self.damping, self.load, self.speed,
        )  # fmt: skip
        clearance = random.uniform(*self.clearance)
        radial, tangential = random.normal(0, self.pin_position, (2, gearbox.n_pins))
        runouts = random.normal(0, self.runout, (2, 2)) @ np.array([1, 1j])
        return gearbox.replace(
            stiffness_scale=gearbox.stiffness_scale * stiffness,
            contact_damping=gearbox.contact_damping * damping,
            load_torque=gearbox.load_torque * load,
            input_speed=gearbox.input_speed * speed,
            clearance=clearance,
            pin_radial_errors=radial,
            pin_tangential_errors=tangential,
            wheel_runouts=runouts,
        )
