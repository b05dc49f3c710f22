"""A simulator of another machine, and effects of its own, for the gap workflow to work on."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from scipy import signal
from scipy.stats import loguniform

from cyclofeat.simulators import Effect, EffectParameter, Simulator, register_effect


@dataclass(frozen=True)
class SpurStage(Simulator):
    """A spur gear's mesh, felt behind a coupling that resonates."""

    resonance_hz: float = 140.0
    damping_ratio: float = 0.05
    mesh_nm: float = 0.3
    n_teeth: int = 23
    wear_nm: float = 0.1  # per worn lobe, once per turn of the input

    def simulate(self, time, angle, speed, load, gearbox, defects):  # type: ignore[no-untyped-def]
        """Return load and ripple behind the coupling, and the angle that the input is driven with."""
        step, lead = time[1], round(0.5 / time[1])  # the resonance settles before the record
        early = np.pad(angle, (lead, 0), "reflect", reflect_type="odd")
        ripple = sum(self.mesh_nm / k * np.cos(k * self.n_teeth * early + k**2) for k in range(1, 5))
        for lobe in defects.worn_lobes:
            ripple = ripple + self.wear_nm * np.cos(early - 2 * np.pi * lobe / gearbox.n_lobes)
        pole = 2 * np.pi * self.resonance_hz
        continuous = [pole**2], [1.0, 2 * self.damping_ratio * pole, pole**2]
        above, below, _ = signal.cont2discrete(continuous, step, "foh")
        return load + signal.lfilter(above.ravel(), below, ripple)[lead:], angle


@register_effect
class SoftCoupling(Effect):
    """Coupling that resonates lower than stated, by a factor."""

    parameters: ClassVar = {
        "factor": EffectParameter("1", 0.3, 1.0, neutral=1.0, prior=loguniform(0.5, 0.95), log=True),
    }

    def change_simulator(self, simulator: Any, random: np.random.Generator) -> Any:
        """Lower the resonance."""
        return dataclasses.replace(simulator, resonance_hz=self.factor * simulator.resonance_hz)


@register_effect
class RoughMesh(Effect):
    """Mesh with more ripple than stated, by a factor."""

    parameters: ClassVar = {
        "factor": EffectParameter("1", 1.0, 10.0, neutral=1.0, prior=loguniform(1.1, 4.0), log=True),
    }

    def change_simulator(self, simulator: Any, random: np.random.Generator) -> Any:
        """Increase the ripple."""
        return dataclasses.replace(simulator, mesh_nm=self.factor * simulator.mesh_nm)
