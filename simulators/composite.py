"""The simulator with effects: from gearbox or rig to a record as a real rig would give it."""

from __future__ import annotations

import dataclasses
import math
import os
from collections.abc import Iterable, Sequence
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from sklearn.base import BaseEstimator

from cyclofeat.simulators.effects import _library as library
from cyclofeat.simulators.effects._base import Effect, Fluctuation, Place, TorqueContext
from cyclofeat.simulators.gearbox import CycloidalGearbox, LobeDefects
from cyclofeat.simulators.rig import LONGEST_SETTLING, Rig, rig_of, settling_time
from cyclofeat.simulators.simulation import SimulationRun, simulate

Float = NDArray[np.float64]

# An effect and the seed of its random numbers.
Step = tuple[Effect, np.random.SeedSequence]

# Children of a seed, as they are counted.
_ASSEMBLY, _DEFECTS, _START, _DRIFT, _NOISE = range(5)


class CompositeSimulator(BaseEstimator):
    """Gearbox or rig with effects, applied in the fixed order of the chain.

    The order is that of :class:`cyclofeat.simulators.Place`, whatever the order in which the effects are
    given; two effects of one place are applied in the order given. A rig's own drift adds to the load, its
    own noise comes last among the effects of the sensor, before the converter.

    Parameters
    ----------
    base : CycloidalGearbox or Rig, default ``CycloidalGearbox.steel()``
        What is simulated: one gearbox, the same in every run, or a rig from which each run draws an
        assembly. A rig's own effects come before those given here.
    effects : sequence of Effect
        Effects, whose ranges each run draws from anew.

    Notes
    -----
    A run's random numbers come from one seed, in separate streams: assembly, start, drift and noise of the
    rig, and for each effect streams that depend on its name (and on how many of that name came before) only.
    One effect more or less leaves the random numbers of all others as they are.

    Examples
    --------
    >>> from cyclofeat.simulators import Hum, Quantisation, TorqueMeterLowPass
    >>> effects = [Quantisation(0.05), TorqueMeterLowPass(300.0), Hum(0.1)]
    >>> simulator = CompositeSimulator(CycloidalGearbox.steel(), effects)
    >>> [effect.effect_id for effect in simulator.chain()]
    ['torque_meter_low_pass', 'hum', 'quantisation']
    >>> simulator.simulate(LobeDefects.worn(2), duration=0.1, seed=1).torque_out.shape
    (2560,)
    """

    def __init__(self, base: CycloidalGearbox | Rig | None = None, effects: Sequence[Effect] = ()) -> None:
        self.base = base
        self.effects = effects

    def get_params(self, deep: bool = True) -> dict[str, Any]:
        """Parameters by name.

        Parameters
        ----------
        deep : bool
            Whether to add the effects by their names (``"hum"``, and ``"hum_2"`` for a second one) and their
            parameters (``"hum__amplitude_nm"``), all of which ``set_params`` takes too, but for the effects
            themselves.
        """
        found: dict[str, Any] = {"base": self.base, "effects": self.effects}
        if deep:
            for (*_, count), effect in zip(library.stream_keys(self.effects), self.effects, strict=True):
                name = effect.effect_id + (f"_{count + 1}" if count else "")
                found[name] = effect
                found |= {f"{name}__{key}": value for key, value in effect.get_params().items()}
        return found

    def set_params(self, **params: Any) -> Self:
        """Set parameters by the names of :meth:`get_params`."""
        for own in ("base", "effects"):
            if own in params:
                setattr(self, own, params.pop(own))
        known = self.get_params()
        for key, value in params.items():
            name, _, parameter = key.partition("__")
            if not parameter or key not in known:
                raise ValueError(
                    f"unknown parameter {key!r} of CompositeSimulator: known are base, effects, "
                    + ", ".join(name for name in known if "__" in name)
                )
            known[name].set_params(**{parameter: value})
        return self

    def chain(self) -> tuple[Effect, ...]:
        """All effects, the rig's own too, checked and in the order in which they are applied."""
        return library.in_chain_order(self._given())

    def assemble(self, seed: int | np.random.SeedSequence = 0) -> tuple[CycloidalGearbox, tuple[Effect, ...]]:
        """What a run with this seed is made of.

        Parameters
        ----------
        seed : int or numpy.random.SeedSequence

        Returns
        -------
        gearbox : CycloidalGearbox
            With all effects on it.
        effects : tuple of Effect
            In the order of the chain, with a number drawn from each range.

        Examples
        --------
        >>> from cyclofeat.simulators import BrakeRotor
        >>> gearbox, (brake,) = CompositeSimulator(effects=[BrakeRotor(inertia=(0.01, 0.03))]).assemble(3)
        >>> gearbox.brake_inertia == brake.inertia
        True
        """
        sequence = _sequence(seed)
        gearbox, steps = self._assembled(sequence, library.child(sequence, _ASSEMBLY))
        return gearbox, tuple(effect for effect, _ in steps)

    def simulate(
        self,
        defects: LobeDefects | None = None,
        *,
        duration: float = 1.8,
        sampling_rate: float = 25_600.0,
        seed: int | np.random.SeedSequence = 0,
        start_angle: float | None = None,
        settled: bool = True,
        **options: Any,
    ) -> SimulationRun:
        """Simulate one record.

        Parameters
        ----------
        defects : LobeDefects, default healthy
            Worn or removed lobes.
        duration : float, default 1.8
            Length of the record in s.
        sampling_rate : float, default 25600
            In Hz, by the converter's own clock (:class:`cyclofeat.simulators.ClockError`).
        seed : int or numpy.random.SeedSequence
            Source of all that is random. The same seed gives the same record, to the last bit.
        start_angle : float, optional
            Angle of the input in rad when it starts from rest. Default: random within one output turn.
        settled : bool
            Whether the record begins when the assembly has settled
            (:func:`cyclofeat.simulators.settling_time`); ramp and settling are simulated, but not part of
            it. If not, it begins at rest, as that of :func:`cyclofeat.simulators.simulate`.
        **options
            All else that :func:`cyclofeat.simulators.simulate` takes, load and speed excepted.

        Returns
        -------
        SimulationRun
            ``round(duration * sampling_rate)`` samples; ``torque_out`` after all effects, the other channels
            at the same instants; ``gearbox`` with all effects on it.

        Raises
        ------
        TypeError, ValueError
            If an argument, the base or an effect is of the wrong type or outside its range; the message names
            it. Also if the assembly has too little damping to settle within a minute.
        SimulationDiverged
            If the simulation diverges.
        """
        return self.run_machine(
            defects, duration=duration, sampling_rate=sampling_rate, seed=seed, start_angle=start_angle,
            settled=settled, **options,
        ).record()  # fmt: skip

    def run_machine(
        self,
        defects: LobeDefects | None = None,
        *,
        duration: float = 1.8,
        sampling_rate: float = 25_600.0,
        seed: int | np.random.SeedSequence = 0,
        assembly: int | np.random.SeedSequence | None = None,
        start_angle: float | None = None,
        settled: bool = True,
        spare_s: float = 0.0,
        **options: Any,
    ) -> MachineRun:
        """Simulate the machine once, to be recorded by one or several chains of measurement.

        Parameters
        ----------
        defects, duration, sampling_rate, seed, start_angle, settled, **options
            As in :meth:`simulate`.
        assembly : int or numpy.random.SeedSequence, optional
            Source of what a rig draws for an assembly: runs with the same one are of the same assembly.
            Default: from ``seed``.
        spare_s : float, default 0
            How much longer the machine runs, in s, for chains whose converter runs slow
            (:class:`cyclofeat.simulators.ClockError`).

        Returns
        -------
        MachineRun

        Raises
        ------
        TypeError, ValueError, SimulationDiverged
            As :meth:`simulate`.

        Examples
        --------
        >>> from cyclofeat.simulators import Offset
        >>> run = CompositeSimulator().run_machine(duration=0.1)
        >>> shifted = run.record([Offset(0.5)])
        >>> float((shifted.torque_out - run.record().torque_out).mean().round(6))
        0.5
        """
        for name, value in (("duration", duration), ("sampling_rate", sampling_rate)):
            if not (math.isfinite(value) and value > 0):
                raise ValueError(f"{name} must be positive and finite, got {value!r}")
        for name in ("load", "load_fluctuation", "speed", "speed_fluctuation", "tolerances"):
            if name in options:
                raise TypeError(f"{name} is not taken here: gearbox, rig and effects state it")
        n_samples = round(duration * sampling_rate)
        if n_samples < 1:
            raise ValueError(f"duration {duration:g} s is shorter than one sample at {sampling_rate:g} Hz")
        sequence = _sequence(seed)
        of_assembly = library.child(sequence, _ASSEMBLY) if assembly is None else _sequence(assembly)
        gearbox, steps = self._assembled(sequence, of_assembly)
        n_settling = _settling_samples(gearbox, sampling_rate) if settled else 0
        n_run = _samples_needed(steps, n_samples) + math.ceil(spare_s * sampling_rate)
        total = (n_settling + n_run) / sampling_rate
        if start_angle is None:
            output_turn = 2 * np.pi * gearbox.n_lobes  # as an angle of the input
            start_angle = _random(library.child(sequence, _START)).uniform(0, output_turn)
        # The simulation runs on for some samples, for its anti-alias filter.
        options |= self._fluctuations(sequence, gearbox, steps, total + 64 / sampling_rate)
        run = simulate(
            gearbox, defects, duration=total, sampling_rate=sampling_rate, start_angle=start_angle, **options
        )
        stated = None if isinstance(seed, np.random.SeedSequence) else int(seed)
        run = dataclasses.replace(run, seed=stated)
        return MachineRun(
            self,
            run,
            steps,
            sequence,
            of_assembly,
            n_samples,
            n_settling,
            sampling_rate,
            from_rest=not settled,
        )

    def to_rig(self) -> Rig:
        """The same as a rig with effects; a bare gearbox is a rig without spread, drift and noise.

        Raises
        ------
        ValueError
            If the gearbox has errors of single pins or wheels, which a rig draws and does not state.
        """
        given = self._given()
        rig = self.base if isinstance(self.base, Rig) else rig_of(self.base or CycloidalGearbox.steel())
        return rig.replace(effects=given)

    def to_json(self, path: str | os.PathLike[str]) -> None:
        """Write base and effects to a JSON file, the description of :meth:`to_rig`.

        Parameters
        ----------
        path : path
            File to write; one that exists is replaced.
        """
        self.to_rig().to_json(path)

    @classmethod
    def from_json(cls, path: str | os.PathLike[str]) -> Self:
        """Read a description that :meth:`to_json` or :meth:`cyclofeat.simulators.Rig.to_json` wrote.

        Parameters
        ----------
        path : path
            File in UTF-8.

        Returns
        -------
        CompositeSimulator
            Its base is a rig without effects, and simulates the same as the base that was written.

        Raises
        ------
        FileNotFoundError, ValueError
            As :meth:`cyclofeat.simulators.Rig.from_json`.

        Examples
        --------
        >>> import pathlib, tempfile
        >>> from cyclofeat.simulators import Offset
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = pathlib.Path(folder) / "corrected.json"
        ...     CompositeSimulator(Rig.r1(), [Offset(0.3)]).to_json(path)
        ...     CompositeSimulator.from_json(path).effects
        (Offset(offset_nm=0.3),)
        """
        rig = Rig.from_json(path)
        return cls(rig.replace(effects=()), rig.effects)

    def _given(self) -> tuple[Effect, ...]:
        if self.base is not None and not isinstance(self.base, (CycloidalGearbox, Rig)):
            raise TypeError(f"base must be a CycloidalGearbox or a Rig, got {self.base!r}")
        own = self.base.effects if isinstance(self.base, Rig) else ()
        return (*own, *library.checked_effects(self.effects))

    def _fluctuations(
        self,
        seed: np.random.SeedSequence,
        gearbox: CycloidalGearbox,
        steps: Iterable[Step],
        duration: float,
    ) -> dict[str, Fluctuation]:
        """What rig and effects add to load and speed, as ``simulate`` takes it."""
        loads = []
        if isinstance(self.base, Rig):
            loads.append(self.base.drift(library.child(seed, _DRIFT), duration))
        speeds = []
        for effect, key in steps:
            load = effect.load_fluctuation(gearbox, duration, _random(key, library.LOAD))
            speed = effect.speed_fluctuation(gearbox, duration, _random(key, library.SPEED))
            loads += [] if load is None else [load]
            speeds += [] if speed is None else [speed]
        found = {"load_fluctuation": loads, "speed_fluctuation": speeds}
        return {name: _total(parts) for name, parts in found.items() if parts}

    def _assembled(
        self, seed: np.random.SeedSequence, of_assembly: np.random.SeedSequence
    ) -> tuple[CycloidalGearbox, list[Step]]:
        """Gearbox, and effects in the order of the chain with the seeds of their random numbers."""
        given = self._given()
        if isinstance(self.base, Rig):
            gearbox = self.base.assemble(of_assembly)
        else:
            gearbox = CycloidalGearbox.steel() if self.base is None else self.base
        seeds = [library.child(seed, *key) for key in library.stream_keys(given)]
        steps = [
            (effect.for_assembly(_random(own, library.RANGES)), own)
            for effect, own in sorted(zip(given, seeds, strict=True), key=lambda step: step[0].place)
        ]
        for effect, own in steps:
            gearbox = effect.change_gearbox(gearbox, _random(own, library.GEARBOX))
        return gearbox, steps


@dataclasses.dataclass(frozen=True)
class MachineRun:
    """What the machine did, before anything measured it; made by :meth:`CompositeSimulator.run_machine`.

    Attributes
    ----------
    simulator : CompositeSimulator
        What ran.
    run : SimulationRun
        From the start, settling included.
    steps : list of (Effect, numpy.random.SeedSequence)
        The simulator's effects as drawn for this assembly, in the order of the chain, and their seeds.
    seed, assembly : numpy.random.SeedSequence
        Sources of all that is random in the measurement, and in the assembly.
    n_samples, n_settling : int
        Length of a record, and samples before it.
    sampling_rate : float
        In Hz.
    from_rest : bool
        Whether the record begins with the start.
    """

    simulator: CompositeSimulator
    run: SimulationRun = dataclasses.field(repr=False)
    steps: list[Step] = dataclasses.field(repr=False)
    seed: np.random.SeedSequence = dataclasses.field(repr=False)
    assembly: np.random.SeedSequence = dataclasses.field(repr=False)
    n_samples: int
    n_settling: int
    sampling_rate: float
    from_rest: bool

    def record(self, effects: Sequence[Effect] = ()) -> SimulationRun:
        """What the chain of measurement records.

        Parameters
        ----------
        effects : sequence of Effect
            In addition to the simulator's own; only such as the gearbox does not answer
            (:meth:`Effect.needs_simulation`).

        Returns
        -------
        SimulationRun
            The same, to the last bit, as a simulator with these effects gives from the same seed; where it
            would have run for longer (a converter that runs slow), but for drift of another length.

        Raises
        ------
        ValueError
            If an effect needs a simulation of its own, or more samples than the machine ran for.
        """
        for effect in effects:
            if effect.needs_simulation():
                raise ValueError(f"effects must act on the torque only; the gearbox answers {effect!r}")
        whole = CompositeSimulator(self.simulator.base, (*self.simulator.effects, *effects))
        gearbox, steps = self.run.gearbox, self.steps
        if effects:
            gearbox, steps = whole._assembled(self.seed, self.assembly)
        needed = _samples_needed(steps, self.n_samples)
        channels = {
            item.name: getattr(self.run, item.name)[self.n_settling :]
            for item in dataclasses.fields(self.run)
            if isinstance(getattr(self.run, item.name), np.ndarray)
        }
        ran = len(channels["torque_out"])
        if ran < needed:
            raise ValueError(
                f"effects need {needed} samples, the machine ran for {ran}: its spare_s must be "
                f"{(needed - ran) / self.sampling_rate:.3g} s longer"
            )
        base = whole.base
        measured = _measured(
            {name: values[:needed] for name, values in channels.items()},
            gearbox,
            self.sampling_rate,
            steps,
            base.noise_nm if isinstance(base, Rig) else 0.0,
            _random(library.child(self.seed, _NOISE)),
            from_rest=self.from_rest,
        )
        changes: dict[str, Any] = {
            name: np.ascontiguousarray(values[: self.n_samples]) for name, values in measured.items()
        }
        return dataclasses.replace(self.run, **changes)


def _samples_needed(steps: Sequence[Step], n_samples: int) -> int:
    for effect, _ in reversed(steps):
        n_samples = effect.samples_needed(n_samples)
    return n_samples


def _settling_samples(gearbox: CycloidalGearbox, sampling_rate: float) -> int:
    settling = settling_time(gearbox)
    if settling > LONGEST_SETTLING:
        raise ValueError(
            f"the gearbox must have more damping: it settles in {settling:.3g} s, more than "
            f"{LONGEST_SETTLING:g} s; raise the damping of brake or contacts"
        )
    return math.ceil(settling * sampling_rate)


def _measured(
    channels: dict[str, Float],
    gearbox: CycloidalGearbox,
    sampling_rate: float,
    steps: Iterable[Step],
    noise_nm: float,
    noise_of: np.random.Generator,
    *,
    from_rest: bool,
) -> dict[str, Float]:
    """The channels after all effects on the torque."""
    channels = dict(channels)
    noisy = False

    def with_noise() -> Float:
        return np.asarray(
            channels["torque_out"] + noise_nm * noise_of.normal(0, 1, len(channels["torque_out"]))
        )

    for effect, own in steps:
        if effect.place > Place.SENSOR and not noisy:
            channels["torque_out"], noisy = with_noise(), True
        context = TorqueContext(gearbox, channels["input_angle"], from_rest)
        torque = effect.change_torque(
            channels["torque_out"], sampling_rate, _random(own, library.TORQUE), context
        )
        channels = {name: effect.resample(values, sampling_rate) for name, values in channels.items()}
        channels["torque_out"] = torque
    if not noisy:
        channels["torque_out"] = with_noise()
    return channels


def _total(parts: Sequence[Fluctuation]) -> Fluctuation:
    if len(parts) == 1:
        return parts[0]

    def total(time: Float) -> Float:
        return np.asarray(sum(part(time) for part in parts))

    return total


def _random(seed: np.random.SeedSequence, *key: int) -> np.random.Generator:
    return np.random.default_rng(library.child(seed, *key))


def _sequence(seed: Any) -> np.random.SeedSequence:
    if isinstance(seed, np.random.SeedSequence):
        return seed
    if isinstance(seed, (bool, np.bool_)) or not isinstance(seed, (int, np.integer)):
        raise TypeError(f"seed must be a whole number or a SeedSequence, got {seed!r}")
    if seed < 0:
        raise ValueError(f"seed must not be negative, got {seed!r}")
    return np.random.SeedSequence(int(seed))
