"""Machines drawn from rigs, their runs, and the records of a chain of measurement."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cyclofeat._base.checks import whole
from cyclofeat._base.quantities import CHANNELS, TORQUES, factor_to_output
from cyclofeat.simulators._simulator import Simulator
from cyclofeat.simulators.courses import Courses
from cyclofeat.simulators.effects import Effect, library
from cyclofeat.simulators.effects.effect import Fluctuation, TorqueContext, draw_for_assembly
from cyclofeat.simulators.gearbox import CycloidalGearbox
from cyclofeat.simulators.motor import Motor, drive_run
from cyclofeat.simulators.simulation import SimulationRun, simulate

Float = NDArray[np.float64]
RandomState = int | np.random.SeedSequence

# Child of a run's seed for the noise of the current; those of the rig are 1 to 3.
_CURRENT = 4


def seed_sequence(random_state: Any, name: str = "random_state") -> np.random.SeedSequence:
    """Return the SeedSequence of a whole number, a new one for None, or one given as it is."""
    if random_state is None:
        return np.random.SeedSequence()
    if isinstance(random_state, np.random.SeedSequence):
        return random_state
    return np.random.SeedSequence(whole(name, random_state, 0))


@dataclasses.dataclass(frozen=True)
class Machine:
    """One machine of a rig; made by :meth:`cyclofeat.simulators.Rig.draw`.

    Gearbox, a user's simulator and the motor on the input shaft (None for a given speed) have all effects of
    this machine on them; ``effects`` are the rig's in the order of the chain, with the numbers of this
    machine, and ``random_state`` is the seed of the assembly.
    """

    gearbox: CycloidalGearbox
    effects: tuple[Effect, ...]
    random_state: np.random.SeedSequence = dataclasses.field(repr=False, compare=False)
    simulator: Simulator | None = None
    motor: Motor | None = None

    def true_values(self) -> dict[str, float]:
        """Return the machine's speed, load, brake and contacts, as recordings and campaigns state them."""
        gearbox = self.gearbox
        return {
            # Rounded: the conversion to rad/s and back changes the last digits.
            "true_speed_rpm": round(60 * float(gearbox.input_speed_hz), 6),
            "true_load_nm": float(gearbox.load_torque),
            "brake_inertia_kg_m2": float(gearbox.brake_inertia),
            "meter_stiffness_nm_per_rad": float(gearbox.meter_stiffness),
            "meter_damping_nms_per_rad": float(gearbox.meter_damping),
            "stiffness_scale": float(gearbox.stiffness_scale),
            "contact_damping": float(gearbox.contact_damping),
            "clearance_m": float(gearbox.clearance),
        }

    def measured_by(self, effects: Sequence[Effect]) -> Machine:
        """Return the machine with more effects on its torque."""
        for effect in effects:
            if effect.needs_simulation():
                raise ValueError(f"effects must act on the torque only; the gearbox answers {effect!r}")
        added = draw_effects(effects, self.random_state, self.effects)
        return dataclasses.replace(self, effects=library.in_chain((*self.effects, *added)))

    def samples_needed(self, n_samples: int) -> int:
        """Return the number of samples from which the chain makes a record of ``n_samples``."""
        for effect in reversed(self.effects):
            n_samples = effect.samples_needed(n_samples)
        return n_samples

    def fluctuations(self, random_state: np.random.SeedSequence, duration: float) -> Courses:
        """Return the sums of what the effects add to load and speed in one run."""
        totals: dict[str, Fluctuation] = {}
        for name, hook in (("load_fluctuation", library.LOAD), ("speed_fluctuation", library.SPEED)):
            parts = [
                getattr(effect, name)(self.gearbox, duration, library.stream(random_state, *key, hook))
                for effect, key in zip(self.effects, library.stream_keys(self.effects), strict=True)
                if effect.overrides(name)
            ]
            acting = [part for part in parts if part is not None]
            if acting:

                def total(time: Float, parts: Sequence[Fluctuation] = acting) -> Float:
                    return np.asarray(functools.reduce(np.add, (part(time) for part in parts)))

                totals[name] = total
        return Courses(**totals)

    def measure_channels(
        self,
        channels: dict[str, Float],
        sampling_rate: float,
        random_state: np.random.SeedSequence,
        quantity: str = "output_torque",
    ) -> dict[str, Float]:
        """Return the channels of one run after all effects on the torque; no meter measures a current."""
        meter = CHANNELS[quantity] if quantity in TORQUES else None
        # A meter on the input has a smaller range, with smaller errors.
        scale = factor_to_output(quantity, self.gearbox.n_lobes)
        for effect, key in zip(self.effects, library.stream_keys(self.effects), strict=True):
            if not (effect.overrides("change_torque") or effect.overrides("resample")):
                continue
            measured = {}
            if meter is not None:
                context = TorqueContext(self.gearbox, channels["input_angle"])
                random = library.stream(random_state, *key, library.TORQUE)
                torque = effect.change_torque(scale * channels[meter], sampling_rate, random, context)
                measured = {meter: torque / scale}
            channels = {name: effect.resample(values, sampling_rate) for name, values in channels.items()}
            channels |= measured
        return channels


@dataclasses.dataclass(frozen=True, kw_only=True)
class PlannedRun:
    """A run that is still to be simulated; made by :meth:`cyclofeat.simulators.Rig.plan_run`."""

    machine: Machine
    arguments: dict[str, Any]  #: Of :func:`cyclofeat.simulators.simulate`
    random_state: np.random.SeedSequence = dataclasses.field(repr=False)  #: Seed of the run
    n_samples: int  #: Length of a record
    n_settling: int  #: Number of samples before it
    quantity: str = "output_torque"  #: Quantity that is measured

    def simulate(self) -> MachineRun:
        """Simulate the run; raise :class:`cyclofeat.simulators.SimulationFailed` if it diverges or locks.

        Raises ValueError if the motor does not hold the speed.
        """
        return self.finish_run(simulate(**self.arguments))

    def finish_run(self, run: SimulationRun) -> MachineRun:
        """Return the machine's run, made of its simulation."""
        motor = self.machine.motor
        if motor is not None:
            start = self.n_settling - math.ceil(motor.warm_up * run.sampling_rate)
            run = drive_run(run, motor, start, library.stream(self.random_state, _CURRENT))
        # Without the courses, which may be large.
        return MachineRun(dataclasses.replace(self, arguments={}), run)


@dataclasses.dataclass(frozen=True)
class MachineRun:
    """A run before measurement, for one or several chains of measurement.

    Made by :meth:`PlannedRun.simulate` or :func:`cyclofeat.simulators.sampling.sample_runs`.
    """

    plan: PlannedRun
    run: SimulationRun = dataclasses.field(repr=False)  #: Channels from the start on, settling included

    def record(self, effects: Sequence[Effect] = ()) -> SimulationRun:
        """Return the record of the chain of measurement, with ``effects`` in addition to the rig's.

        None of these may be one that the gearbox answers (:meth:`Effect.needs_simulation`). The record
        equals, to the last bit, that of a rig with these effects and the same seed; only for a converter that
        runs slow do drifts differ, as that rig's run is longer. ValueError if the gearbox answers an effect,
        or effects need more samples than the machine ran for.
        """
        plan, rate = self.plan, self.run.sampling_rate
        machine = plan.machine.measured_by(library.checked_effects(effects))
        needed = machine.samples_needed(plan.n_samples)
        channels = {
            name: values[plan.n_settling :]
            for name, values in vars(self.run).items()
            if isinstance(values, np.ndarray)
        }
        if (ran := len(channels["torque_out"])) < needed:
            raise ValueError(f"effects need {needed} samples, the machine ran for {ran}: state the chains")
        channels = {name: values[:needed] for name, values in channels.items()}
        measured = machine.measure_channels(channels, rate, plan.random_state, plan.quantity)
        changes: dict[str, Any] = {
            name: np.ascontiguousarray(values[: plan.n_samples]) for name, values in measured.items()
        }
        return dataclasses.replace(self.run, **changes)


def draw_effects(
    effects: Sequence[Effect], random_state: np.random.SeedSequence, before: Sequence[Effect] = ()
) -> tuple[Effect, ...]:
    """Return the effects with numbers drawn for a machine that already has the effects ``before``."""
    keys = library.stream_keys((*before, *effects))[len(before) :]
    return tuple(
        draw_for_assembly(effect, library.stream(random_state, *key, library.RANGES))
        if effect.has_spread
        else effect
        for effect, key in zip(effects, keys, strict=True)
    )
