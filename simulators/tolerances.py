"""Random errors of single assemblies: without them every simulated recording of a class is the same."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np

from cyclofeat.simulators._checks import check_number, check_type, generator, members
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
    lobe_pitch : float
        Standard deviation of each lobe's displacement along the pitch circle, in m.
    cam_position : float
        Standard deviation, by component, of each cam's offset on the input shaft, in m.

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
    lobe_pitch: float = 0.0
    cam_position: float = 0.0

    def __post_init__(self) -> None:
        clearance = members(self.clearance)
        if clearance is None or len(clearance) != 2:
            raise ValueError(f"clearance must be (lower, upper) in m, got {self.clearance!r}")
        object.__setattr__(self, "clearance", clearance)
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            is_range = field.name == "clearance"
            for one in clearance if is_range else (value,):
                check_number(field.name, one, "(lower, upper) in m" if is_range else "a number")
                if not (math.isfinite(one) and one >= 0):
                    raise ValueError(f"{field.name} must be finite and not negative, got {value!r}")
        for name in ("stiffness", "damping", "load", "speed"):
            if getattr(self, name) >= 1:
                raise ValueError(f"{name} is a relative half width below 1, got {getattr(self, name)!r}")
        if self.clearance[0] > self.clearance[1]:
            raise ValueError(f"clearance must be (lower, upper) in m, got {self.clearance!r}")

    @property
    def has_spread(self) -> bool:
        """Whether assemblies differ at all."""
        low, high = self.clearance
        others = (getattr(self, one.name) for one in dataclasses.fields(self) if one.name != "clearance")
        return low < high or any(value > 0 for value in others)

    def draw(self, gearbox: CycloidalGearbox, seed: int | np.random.Generator) -> CycloidalGearbox:
        """One assembly: the gearbox with errors drawn from these tolerances.

        Parameters
        ----------
        gearbox : CycloidalGearbox
            Nominal gearbox; its own errors of pins, lobes, wheels and cams and its clearance are replaced.
        seed : int or numpy.random.Generator
        """
        check_type("gearbox", gearbox, CycloidalGearbox)
        random = generator(seed)
        stiffness, damping, load, speed = 1 + random.uniform(-1, 1, 4) * (
            self.stiffness, self.damping, self.load, self.speed,
        )  # fmt: skip
        clearance = random.uniform(*self.clearance)
        radial, tangential = random.normal(0, self.pin_position, (2, gearbox.n_pins))
        runouts = random.normal(0, self.runout, (2, 2)) @ np.array([1, 1j])
        # Drawn last: a tolerance more does not change what is drawn from the others.
        pitch = random.normal(0, self.lobe_pitch, 2 * gearbox.n_lobes) if self.lobe_pitch else ()
        cams = random.normal(0, self.cam_position, (2, 2)) @ [1, 1j] if self.cam_position else ()
        return gearbox.replace(
            stiffness_scale=gearbox.stiffness_scale * stiffness,
            contact_damping=gearbox.contact_damping * damping,
            load_torque=gearbox.load_torque * load,
            input_speed=gearbox.input_speed * speed,
            clearance=clearance,
            pin_radial_errors=radial,
            pin_tangential_errors=tangential,
            lobe_pitch_errors=pitch,
            wheel_runouts=runouts,
            cam_errors=cams,
        )
