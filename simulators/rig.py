"""Rigs: a gearbox and the effects of a test rig on it."""

from __future__ import annotations

import dataclasses
import json
import math
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from scipy.stats import rayleigh, uniform

from cyclofeat._base.checks import Replaceable, check_type, is_number, number_pair, one_of, positive, repr_of
from cyclofeat._base.displays import Card, WithCard
from cyclofeat._base.files import write_whole
from cyclofeat._base.quantities import QUANTITIES
from cyclofeat.simulators._simulator import Simulator
from cyclofeat.simulators.defects import LobeDefects
from cyclofeat.simulators.effects import (
    BrakeRotor,
    Clearance,
    Drift,
    Effect,
    GearboxParameter,
    Noise,
    PinErrors,
    RunOut,
    Scale,
    library,
)
from cyclofeat.simulators.effects._gearbox import GEARBOX_NUMBERS
from cyclofeat.simulators.effects.effect import is_distribution, reject_unknown, to_plain, value_text
from cyclofeat.simulators.gearbox import CycloidalGearbox
from cyclofeat.simulators.machine import Machine, PlannedRun, RandomState, draw_effects, seed_sequence
from cyclofeat.simulators.motor import Motor
from cyclofeat.simulators.simulation import SimulationRun, settling_time

Made = TypeVar("Made")

# Children of a run's seed. Those of an effect begin with the bytes of its name, which are larger numbers.
DEFECTS, _START, _VARIANT = 1, 2, 3
_GEARBOX = "gearbox."
_RECORDED_AT = ("speeds_rpm", "loads_nm")
FORMAT = "cyclofeat rig"
_NOTE = (
    "SI units: m, kg, kg m2, s, rad/s, Nm, Nm/rad, Pa; keys in _nm are Nm, in _hz Hz. effects is a list like "
    '[{"effect": "hum", "amplitude_nm": 0.2}]. A value may be a number, a range [low, high], or a '
    'distribution {"distribution": "norm", "loc": 0.2, "scale": 0.05}, from which each assembly draws. Keys '
    "left out keep their default."
)
# Samples for which speed and load are known after the end of a run, for the anti-alias filter.
_SPARE_SAMPLES = 64
# Longest settling time that is simulated, in s: rigs with almost no damping would run for hours.
_LONGEST_SETTLING = 60.0
# Time in s by which a motor may run ahead of the given speed.
_LEAD_S = 0.1


@dataclass(frozen=True)
class Rig(Replaceable, WithCard):
    """A nominal gearbox and the effects of the rig that it runs on: the complete input of a simulation.

    An effect's parameter is a number, or a range or distribution from which each assembly draws
    (:class:`cyclofeat.simulators.Effect`). Values that the papers do not state are *assumptions*, those of
    the three presets included.

    Parameters
    ----------
    gearbox : CycloidalGearbox
        Nominal gearbox, speed and load. Default: paper B's of steel.
    effects : sequence of Effect
        Copied and sorted into the order of the chain (:attr:`cyclofeat.simulators.Effect.place`); effects of
        one place act in the order given. Several of one kind are allowed, but at most one brake.
    name : str, default "rig"
        Prefix of the names of its surrogate recordings.
    variants : sequence of sequences of Effect
        Sets of further effects. Each assembly has one set, drawn with equal chances: for effects that occur
        with some probability, exclude each other, or have correlated sizes. Default: none.
    simulator : Simulator, optional
        User's simulator. The gearbox then states speed, load and number of lobes.
    speeds_rpm, loads_nm : pair of float, optional
        Lowest and highest speed and load at which the rig was recorded, which training covers.

    Raises
    ------
    TypeError, ValueError
        If a parameter is of the wrong type, outside its range or contradicts another; the message names it.

    Notes
    -----
    The seed of the assembly determines errors and ranges, the seed of the run start angle, drift and noise.
    The random numbers of an effect depend on its name and on the number of effects of that name before it:
    adding or removing an effect does not change the random numbers of the others.

    Examples
    --------
    >>> from cyclofeat.simulators import Hum, TorqueMeterLowPass
    >>> rig = Rig(effects=[Hum((0.05, 0.3)), TorqueMeterLowPass(300.0)], name="mine")
    >>> [effect.effect_id for effect in rig.effects]
    ['torque_meter_low_pass', 'hum']
    >>> rig.simulate(LobeDefects.worn(2), duration=0.1, random_state=1).torque_out.shape
    (2560,)
    >>> 0.005 <= Rig.r2().draw(1).gearbox.brake_inertia <= 0.05
    True
    """

    gearbox: CycloidalGearbox = field(default_factory=CycloidalGearbox.steel)
    effects: tuple[Effect, ...] = ()
    name: str = "rig"
    variants: tuple[tuple[Effect, ...], ...] = ()
    simulator: Simulator | None = None
    speeds_rpm: tuple[float, float] | None = None
    loads_nm: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        check_type("gearbox", self.gearbox, CycloidalGearbox)
        for name in _RECORDED_AT:
            if getattr(self, name) is not None:
                low, high = ends = number_pair(name, getattr(self, name))
                if not 0 < low <= high:
                    raise ValueError(f"{name} must be a pair (low, high) with 0 < low <= high, got {ends}")
                object.__setattr__(self, name, ends)
        check_type("name", self.name, str)
        if not self.name or not self.name.isprintable():
            raise ValueError(f"name must be a line of printable text, got {self.name!r}")
        object.__setattr__(self, "effects", library.in_chain(library.checked_effects(self.effects)))
        if self.simulator is not None:
            check_type("simulator", self.simulator, Simulator)
            self.simulator._check()
        variants = library.read_variants(self.variants, library.checked_effects)
        object.__setattr__(self, "variants", variants)
        for index, effects in enumerate(self.effect_sets()):
            name = f"effects and variants[{index}]" if variants else "effects"
            motors = [effect.effect_id for effect in effects if effect.place == "motor"]
            if len(set(motors)) < len(motors):
                raise ValueError(f"{name} must hold each motor effect once at most, got {', '.join(motors)}")
            if motors and self.simulator is not None:
                raise ValueError(f"simulator must be None for a rig with a motor, got {self.simulator!r}")
            brakes = (self.gearbox.brake_inertia > 0) + sum(isinstance(one, BrakeRotor) for one in effects)
            if brakes > 1:
                raise ValueError(f"{name} must hold one brake_rotor at most, in all, got {brakes} brakes")
            for effect in effects:
                if isinstance(effect, GearboxParameter):
                    for share in (0.0, 1.0):  # the gearbox rejects wrong values
                        value = effect.parameters["value"].draw(effect.value, share)
                        self.gearbox.replace(**{effect.parameter: value})
                if self.simulator is None and effect.overrides("change_simulator"):
                    raise ValueError(f"simulator must be given for {effect!r}, which changes it, got None")

    @classmethod
    def r0(cls) -> Rig:
        """Return rig R0: the free output of the papers with errors, drift and noise (all *assumptions*).

        Position errors of 10 um rms (pins) and 5 um rms by component (wheels), clearance up to 30 um,
        contacts within 25 %, load within 3 % and speed within 1 % of nominal, load drift of 3 Nm rms below
        1.5 Hz, white noise of 0.2 Nm.

        Returns
        -------
        Rig
        """
        spread = uniform(0.75, 0.5)
        contacts = Scale("contact_stiffness", spread), Scale("contact_damping", spread)
        return cls(effects=(*_assembly_errors(), *contacts), name="R0")

    @classmethod
    def r1(cls) -> Rig:
        """Return rig R1: R0 with one known brake for all assemblies (*assumptions*).

        Rotor of 0.02 kg m2 behind a torque meter of 10 kNm/rad, 2 % damping.

        Returns
        -------
        Rig
        """
        return cls.r0().replace(name="R1").with_effects(BrakeRotor(0.02, 1e4, 0.02))

    @classmethod
    def r2(cls) -> Rig:
        """Return rig R2: brake and contacts differ between assemblies (*assumptions*).

        Rotor 0.005-0.05 kg m2, meter 3-30 kNm/rad, 1-5 % damping; contact stiffness and damping within a
        factor of 2; a second drift of 0.3 Nm rms below 25 Hz, which reaches the lobes' frequencies.

        Returns
        -------
        Rig
        """
        differing = (
            Scale("contact_stiffness", (0.5, 2.0)),
            Scale("contact_damping", (0.5, 2.0)),
            BrakeRotor((0.005, 0.05), (3e3, 3e4), (0.01, 0.05)),
            Drift(0.3, 25.0),
        )
        return cls(effects=(*_assembly_errors(), *differing), name="R2")

    def __repr__(self) -> str:
        """Return name, gearbox and effects, but only the number of variants, which may be hundreds."""
        more = f", {len(self.variants)} variants" if self.variants else ""
        more += f", simulator={self.simulator!r}" if self.simulator else ""
        effects = ", ".join(map(repr, self.effects))
        return f"<Rig {self.name!r}: {self.gearbox!r}, effects=[{effects}]{more}>"

    def _card(self) -> Card:
        gearbox = self.gearbox
        rows: dict[str, object] = {
            "gearbox": f"{gearbox.n_lobes} lobes, {gearbox.n_pins} pins on a circle of "
            f"{1e3 * gearbox.pin_circle_radius:.4g} mm",
            "input speed": f"{gearbox.input_speed * 30 / math.pi:.5g} RPM",
            "load": f"{gearbox.load_torque:.4g} Nm",
            "simulator": "" if self.simulator is None else repr(self.simulator),
        }
        for label, effect in library.label_effects(self.effects).items():
            texts = []
            for name, value in effect.get_params(deep=False).items():
                text = value_text(value) if is_distribution(value) else repr_of(value)
                if is_number(value):
                    text = f"{value:.4g}"
                elif isinstance(value, tuple) and len(value) == 2 and all(map(is_number, value)):
                    text = f"{value[0]:.4g} to {value[1]:.4g}"
                unit = effect.parameters[name].unit if name in effect.parameters else "1"
                texts.append(f"{name} {text}" + (f" {unit}" if unit != "1" else ""))
            rows[label] = ", ".join(texts)
        if self.variants:
            rows["variants"] = f"{len(self.variants)} sets of further effects, of which each assembly has one"
        title = "Rig" if self.name == "rig" else f"Rig {self.name}"
        return Card(title, rows, code="rig.simulate(LobeDefects.worn(3))")

    @property
    def has_brake(self) -> bool:
        """True if a brake's rotor turns behind the torque meter, if only in a variant."""
        brakes = (isinstance(one, BrakeRotor) for effects in self.effect_sets() for one in effects)
        return self.gearbox.brake_inertia > 0 or any(brakes)

    @property
    def has_motor(self) -> bool:
        """True if a motor with control turns the input shaft, if only in a variant, and not a given speed."""
        return any(effect.place == "motor" for effects in self.effect_sets() for effect in effects)

    def with_effects(self, *effects: Effect) -> Rig:
        """Return a copy with effects added, each instead of those of the same name.

        Parameters
        ----------
        *effects : Effect
            Effects of these names in the variants are left out too.

        Returns
        -------
        Rig

        Examples
        --------
        >>> from cyclofeat.simulators import Hum
        >>> changed = Rig.r0().with_effects(Noise(0.5), Hum(0.1))
        >>> changed.effects[-2:]
        (Noise(rms_nm=0.5), Hum(amplitude_nm=0.1))
        """
        given = library.checked_effects(effects)
        others = self.without(*(effect.effect_id for effect in given))
        return others.replace(effects=(*others.effects, *given))

    def with_added(self, *effects: Effect) -> Rig:
        """Return a copy with more effects.

        Parameters
        ----------
        *effects : Effect
            Added to those of the rig, also to those of the same name.

        Returns
        -------
        Rig
        """
        return self.replace(effects=(*self.effects, *effects))

    def without(self, *effect_ids: str) -> Rig:
        """Return a copy without the effects of these names.

        Parameters
        ----------
        *effect_ids : str
            Names of no effect of the rig are ignored.

        Returns
        -------
        Rig
            Without them in its variants either.
        """
        effects, *variants = (
            [one for one in part if one.effect_id not in effect_ids]
            for part in (self.effects, *self.variants)
        )
        return self.replace(effects=effects, variants=variants)

    def parameters(self) -> dict[str, Any]:
        """Return all numeric parameters by name.

        Returns
        -------
        dict
            ``"gearbox.<field>"`` to numbers; ``"<effect>.<parameter>"``, like ``"hum.amplitude_nm"``, to
            numbers, ranges and distributions. The second hum is ``"hum_2"``; a :class:`GearboxParameter` is
            ``"gearbox_parameter_<field>"``.
        """
        values = {_GEARBOX + name: getattr(self.gearbox, name) for name in GEARBOX_NUMBERS}
        for label, effect in library.label_effects(self.effects).items():
            values |= {f"{label}.{name}": getattr(effect, name) for name in effect.parameters}
        return values

    def effect_sets(self) -> list[tuple[Effect, ...]]:
        """Return the effects with those of each variant, in the order of the chain.

        Returns
        -------
        list of tuple of Effect
            One tuple for each variant; a single one without variants.
        """
        return [library.in_chain((*self.effects, *variant)) for variant in self.variants or ((),)]

    def with_parameters(self, values: Mapping[str, Any]) -> Rig:
        """Return a copy with single parameters changed.

        Parameters
        ----------
        values : mapping
            From names of :meth:`parameters` to numbers or, for effects, ranges and distributions.

        Returns
        -------
        Rig

        Raises
        ------
        ValueError
            If a name is unknown (the message has the nearest), or a value is wrong.

        Examples
        --------
        >>> rig = Rig.r1().with_parameters({"gearbox.load_torque": 18.0, "noise.rms_nm": (0.1, 0.4)})
        >>> rig.gearbox.load_torque
        18.0
        """
        reject_unknown(values, self.parameters(), of=f" of rig {self.name!r}")
        effects = library.label_effects(self.effects)
        changed: dict[str, dict[str, Any]] = {label: {} for label in effects}
        gearbox: dict[str, Any] = {}
        for name, value in values.items():
            label, _, rest = name.rpartition(".")
            (gearbox if name.startswith(_GEARBOX) else changed[label])[rest] = value
        return self.replace(
            gearbox=self.gearbox.replace(**gearbox),
            effects=[one.with_parameters(**changed[label]) for label, one in effects.items()],
        )

    def at(self, speed_rpm: float | None = None, load_nm: float | None = None) -> Rig:
        """Return a copy at another nominal speed and load.

        Parameters
        ----------
        speed_rpm, load_nm : float, optional
            Input speed in RPM and load torque in Nm. Default: those of the gearbox.

        Returns
        -------
        Rig
        """
        changes = {} if speed_rpm is None else {"input_speed": speed_rpm * np.pi / 30}
        changes |= {} if load_nm is None else {"load_torque": load_nm}
        return self.replace(gearbox=self.gearbox.replace(**changes))

    def draw(self, random_state: RandomState) -> Machine:
        """Draw one machine: its variant, the errors of its gearbox, a number from each distribution.

        Parameters
        ----------
        random_state : int or numpy.random.SeedSequence
            Seed of the assembly.

        Returns
        -------
        Machine
            The machine that :meth:`simulate` runs with the same ``random_state``.
        """
        seed, sets = seed_sequence(random_state), self.effect_sets()
        variant = library.stream(seed, _VARIANT).integers(len(sets))
        effects = draw_effects(sets[variant], seed)
        gearbox, simulator, motor = self.gearbox, self.simulator, None
        for effect, key in zip(effects, library.stream_keys(effects), strict=True):
            if effect.overrides("change_gearbox"):
                gearbox = effect.change_gearbox(gearbox, library.stream(seed, *key, library.GEARBOX))
            if effect.overrides("change_simulator"):
                simulator = effect.change_simulator(simulator, library.stream(seed, *key, library.SIMULATOR))
                check_type(f"the result of change_simulator of {effect.effect_id}", simulator, Simulator)
            if effect.overrides("change_motor"):
                motor = effect.change_motor(motor or Motor(), library.stream(seed, *key, library.MOTOR))
        return Machine(gearbox, effects, seed, simulator, motor)

    def simulate(
        self,
        defects: LobeDefects | None = None,
        *,
        duration: float = 1.8,
        sampling_rate: float = 25_600.0,
        random_state: RandomState | None = None,
        start_angle: float | None = None,
        quantity: str = "output_torque",
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
            Stated rate of the converter in Hz (:class:`cyclofeat.simulators.ClockError`).
        random_state : int or numpy.random.SeedSequence, optional
            Equal seeds give equal records, to the last bit. Default: another record each time.
        start_angle : float, optional
            Angle of the input in rad when it starts from rest. Default: random within one output turn.
        quantity : {"output_torque", "input_torque", "motor_current"}, default "output_torque"
            Quantity that is measured: ``torque_out``, ``torque_in`` or ``motor_current`` of the result. The
            torque meter's effects act on the torque measured; on the input they are smaller by the reduction,
            as is the range of a meter there. They do not act on a current, which needs a motor
            (:func:`cyclofeat.simulators.motor_effects`) and has a sensor of its own
            (the effect ``current_sensor``).
        **options
            Other arguments of :func:`cyclofeat.simulators.simulate`, except ``courses``.

        Returns
        -------
        SimulationRun
            ``round(duration * sampling_rate)`` samples from when the assembly has settled; the quantity and
            ``gearbox`` with all effects on them, the other channels at the same instants.

        Raises
        ------
        TypeError, ValueError
            If an argument or a combination of effects is wrong, the assembly does not settle within a
            minute, or the motor does not hold the speed.
        SimulationDiverged
            If the simulation diverges.
        """
        planned = self.plan_run(
            defects, duration=duration, sampling_rate=sampling_rate, random_state=random_state,
            start_angle=start_angle, quantity=quantity, **options,
        )  # fmt: skip
        return planned.simulate().record()

    def plan_run(
        self,
        defects: LobeDefects | None = None,
        *,
        duration: float = 1.8,
        sampling_rate: float = 25_600.0,
        random_state: RandomState | None = None,
        assembly: RandomState | None = None,
        start_angle: float | None = None,
        quantity: str = "output_torque",
        chains: Sequence[Sequence[Effect]] = (),
        **options: Any,
    ) -> PlannedRun:
        """Draw a machine and state its run, without simulating it.

        Parameters
        ----------
        defects, duration, sampling_rate, random_state, start_angle, quantity, **options
            See :meth:`simulate`.
        assembly : int or numpy.random.SeedSequence, optional
            Seed of the assembly; equal seeds give the same machine. Default: ``random_state``.
        chains : sequence of sequences of Effect
            Effects of later records (:meth:`MachineRun.record`), for which the run has to be long enough.

        Returns
        -------
        PlannedRun
            Its ``simulate`` makes it; :func:`cyclofeat.simulators.sampling.sample_runs` makes many at once.
        """
        duration = positive("duration", duration, "a number of s")
        sampling_rate = positive("sampling_rate", sampling_rate, "a number of Hz")
        if "courses" in options:
            raise TypeError("courses is not taken here: the rig's gearbox and effects state load and speed")
        n_samples = round(duration * sampling_rate)
        if n_samples < 1:
            raise ValueError(f"duration {duration:g} s is shorter than one sample at {sampling_rate:g} Hz")
        seed = seed_sequence(random_state)
        machine = self.draw(seed if assembly is None else seed_sequence(assembly, "assembly"))
        gearbox = machine.gearbox
        # The machine of a user's simulator already ran.
        settling = settling_time(gearbox) if self.simulator is None else 0.0
        if settling > _LONGEST_SETTLING:
            raise ValueError(f"the gearbox must have more damping: it settles in {settling:.3g} s, above 60")
        n_settling = math.ceil(settling * sampling_rate)
        motor = machine.motor
        check_quantity(self, quantity)
        if quantity == "motor_current" and motor is None:
            raise ValueError("quantity motor_current needs a motor: add motor_effects() to the effects")
        n_run = max(machine.measured_by(chain).samples_needed(n_samples) for chain in ((), *chains))
        if motor is not None:
            n_settling += math.ceil(motor.warm_up * sampling_rate)
            n_run += math.ceil(_LEAD_S * sampling_rate)
        total = (n_settling + n_run) / sampling_rate
        if start_angle is None:
            output_turn = 2 * np.pi * gearbox.n_lobes  # as an angle of the input
            start_angle = library.stream(seed, _START).uniform(0, output_turn)
        arguments = options | {
            "gearbox": gearbox,
            "defects": defects,
            "duration": total,
            "sampling_rate": sampling_rate,
            "start_angle": start_angle,
            "courses": machine.fluctuations(seed, total + _SPARE_SAMPLES / sampling_rate),
        }
        if machine.simulator is not None:
            arguments["simulator"] = machine.simulator
        if motor is not None or quantity == "input_torque":
            arguments["torque_in"] = True
        return PlannedRun(
            machine=machine, arguments=arguments, random_state=seed, n_samples=n_samples,
            n_settling=n_settling, quantity=quantity,
        )  # fmt: skip

    def to_dict(self) -> dict[str, Any]:
        """Return the content of a rig's file, without format and note.

        Returns
        -------
        dict
            In types that JSON knows; its keys are described at :meth:`from_json`.
        """
        gearbox: dict[str, Any] = {}
        for name, value in vars(self.gearbox).items():
            if not isinstance(value, tuple):
                gearbox[name] = to_plain(value, is_parameter=False)
            elif value:
                gearbox[name] = [[x.real, x.imag] if isinstance(x, complex) else float(x) for x in value]
        content: dict[str, Any] = {
            "name": self.name,
            "gearbox": gearbox,
            "effects": [one.to_dict() for one in self.effects],
        }
        if self.simulator is not None:
            content["simulator"] = self.simulator._to_dict()
        content |= {name: list(ends) for name in _RECORDED_AT if (ends := getattr(self, name)) is not None}
        if self.variants:
            content["variants"] = [[effect.to_dict() for effect in variant] for variant in self.variants]
        return content

    def to_text(self) -> str:
        """Return the JSON text that :meth:`to_json` writes, equal for equal rigs.

        Returns
        -------
        str
            One line for each field of the gearbox, each effect and each variant.
        """
        line = partial(json.dumps, ensure_ascii=False, allow_nan=False)
        content = self.to_dict()
        parts = {name: line(value) for name, value in {"format": FORMAT, "note": _NOTE, **content}.items()}
        fields = ",\n".join(f"    {line(key)}: {line(value)}" for key, value in content["gearbox"].items())
        parts["gearbox"] = f"{{\n{fields}\n  }}"
        for name in ("effects", "variants"):
            if content.get(name):
                parts[name] = "[\n" + ",\n".join(f"    {line(item)}" for item in content[name]) + "\n  ]"
        if "simulator" in parts:
            parts["simulator"] = parts.pop("simulator")  # the last
        return "{\n" + ",\n".join(f'  "{key}": {text}' for key, text in parts.items()) + "\n}\n"

    def to_json(self, path: str | os.PathLike[str]) -> None:
        """Write the rig to a JSON file, every value explicit.

        Parameters
        ----------
        path : path
            File to write; an existing file is replaced.
        """
        write_whole(Path(path), lambda file: file.write(self.to_text().encode()))

    @classmethod
    def from_dict(cls, content: Any) -> Rig:
        """Return the rig of a content as :meth:`to_dict` gives it.

        Parameters
        ----------
        content : dict
            May leave out keys; may hold format and note too.

        Returns
        -------
        Rig

        Raises
        ------
        TypeError, ValueError
            If a key or value is wrong; the message names it.
        """
        given = dict(_check_object("the file", content))
        reject_unknown(given, ["format", "note", *(item.name for item in dataclasses.fields(cls))])
        given.pop("note", None)
        if (form := given.pop("format", FORMAT)) != FORMAT:
            raise ValueError(f"format must be {FORMAT!r}, got {repr_of(form)}")
        if "gearbox" in given:
            values = dict(_check_object("gearbox", given["gearbox"]))
            defaults = {item.name: item.default for item in dataclasses.fields(CycloidalGearbox)}
            reject_unknown(values, defaults, _GEARBOX)
            for name, value in values.items():
                if isinstance(value, list):
                    values[name] = [
                        complex(*x) if isinstance(x, list) and len(x) == 2 and all(map(is_number, x)) else x
                        for x in value
                    ]
                elif isinstance(defaults[name], float) and is_number(value):
                    values[name] = float(value)
            try:
                given["gearbox"] = CycloidalGearbox(**values)
            except (TypeError, ValueError) as error:
                raise type(error)(f"gearbox: {error}") from None
        if "effects" in given:
            given["effects"] = library.effects_from_list(given["effects"])
        if "variants" in given:
            given["variants"] = library.read_variants(given["variants"], library.effects_from_list)
        if given.get("simulator") is not None:
            given["simulator"] = Simulator._from_dict(_check_object("simulator", given["simulator"]))
        return cls(**given)

    @classmethod
    def from_json(cls, path: str | os.PathLike[str]) -> Rig:
        """Read a rig from a JSON file.

        The file holds one object with the keys ``"name"``, ``"gearbox"`` (the parameters of
        :class:`CycloidalGearbox` in SI units) and ``"effects"``: a list of objects, the effect's name under
        ``"effect"``, then its parameters (:func:`cyclofeat.simulators.known_effects`). A parameter is a
        number, a range ``[low, high]``, or a distribution of scipy by its name and arguments,
        ``{"distribution": "norm", "loc": 0.2, "scale": 0.05}``. ``"variants"`` is a list of such lists of
        effects, of which each assembly has one; ``"speeds_rpm"`` and ``"loads_nm"`` are pairs, the lowest and
        the highest at which the rig was recorded. All keys may be left out. ``"note"`` is free text.

        Parameters
        ----------
        path : path
            File in UTF-8.

        Returns
        -------
        Rig
            Equal to the rig that was written.

        Raises
        ------
        FileNotFoundError
            If there is no such file.
        ValueError
            If the file is not JSON, or a key or value is wrong; the message names file, key and value.

        Examples
        --------
        >>> import pathlib, tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = pathlib.Path(folder) / "rig.json"
        ...     Rig.r2().to_json(path)
        ...     Rig.from_json(path) == Rig.r2()
        True
        """
        example = '{"name": "mine", "effects": [{"effect": "noise", "rms_nm": 0.2}]}'
        return read_json(path, cls.from_dict, "a rig", example)


def check_quantity(rig: Rig, quantity: str) -> str:
    """Return a quantity if records of the rig can have it; a user's simulator gives the output torque."""
    one_of("quantity", quantity, QUANTITIES)
    if rig.simulator is not None and quantity != QUANTITIES[0]:
        raise ValueError(f"quantity must be {QUANTITIES[0]!r} for a user's simulator, got {quantity!r}")
    return quantity


def _assembly_errors() -> tuple[Effect, ...]:
    """Return the effects of all three presets."""
    return (
        PinErrors(10e-6),
        RunOut(rayleigh(scale=5e-6), wheels=(0,)),
        RunOut(rayleigh(scale=5e-6), wheels=(1,)),
        Clearance(uniform(0.0, 30e-6)),
        Scale("load", (0.97, 1.03)),
        Scale("speed", (0.99, 1.01)),
        Drift(3.0, 1.5),
        Noise(0.2),
    )


def read_json(path: str | os.PathLike[str], make: Callable[[Any], Made], what: str, example: str) -> Made:
    """Return what ``make`` makes of the content of a JSON file in UTF-8 without repeated keys.

    ``what`` names the description in messages ("a rig"), ``example`` is one in a line. Errors name the file.
    """
    name = os.fspath(path)

    def unique_keys(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        distinct: dict[str, Any] = {}
        for key, value in pairs:
            if key in distinct:
                values = f"{repr_of(distinct[key])} and with {repr_of(value)}"
                raise ValueError(f"key {key!r} must stand only once in its object, got it with {values}")
            distinct[key] = value
        return distinct

    try:
        text = Path(path).read_text(encoding="utf-8-sig")
        return make(json.loads(text, object_pairs_hook=unique_keys))
    except FileNotFoundError:
        raise FileNotFoundError(f"{name}: no such file; to_json writes a description of {what}") from None
    except OSError as error:
        raise OSError(f"{name}: cannot be read ({error.strerror}); give a JSON file") from None
    except UnicodeDecodeError as error:
        raise ValueError(f"{name}: is not text in UTF-8 (byte {error.start}); give a JSON file") from None
    except json.JSONDecodeError as error:
        raise ValueError(
            f"{name}: is not valid JSON: {error.msg} at line {error.lineno}, column {error.colno}; "
            f"a description of {what} looks like {example}"
        ) from None
    except RecursionError:
        raise ValueError(f"{name}: is not a description of {what}: brackets are nested too deeply") from None
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name}: {error}") from None


def _check_object(name: str, content: Any) -> Mapping[str, Any]:
    if not isinstance(content, dict):
        raise TypeError(f"{name} must hold a JSON object {{...}}, got {repr_of(content)}")
    return content
