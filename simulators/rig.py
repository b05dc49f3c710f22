"""Gearbox and test rig in one readable description, from which single assemblies are drawn."""

from __future__ import annotations

import dataclasses
import difflib
import json
import math
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cyclofeat.simulators._checks import check_type, generator, is_whole, number, pair, short
from cyclofeat.simulators.contact import joint_effective_radius, stiffness_factor
from cyclofeat.simulators.effects import BrakeRotor, Effect, _noise
from cyclofeat.simulators.effects._library import checked_effects, effects_from_list
from cyclofeat.simulators.gearbox import CycloidalGearbox
from cyclofeat.simulators.tolerances import AssemblyTolerances

Float = NDArray[np.float64]
Range = tuple[float, float]
Seed = int | np.random.SeedSequence | np.random.Generator

_BRAKE = ("brake_inertia", "meter_stiffness", "meter_damping_ratio")
_FACTORS = ("contact_stiffness_factor", "contact_damping_factor")
# What an assembly replaces in the gearbox, and where a rig states it instead.
_DRAWN = {
    "clearance": "tolerances.clearance",
    "brake_inertia": "brake_inertia of the rig",
    "meter_stiffness": "meter_stiffness of the rig",
    "meter_damping": "meter_damping_ratio of the rig",
    "pin_radial_errors": "tolerances.pin_position",
    "pin_tangential_errors": "tolerances.pin_position",
    "wheel_runouts": "tolerances.runout",
    "cam_errors": "tolerances.cam_position",
    "lobe_pitch_errors": "tolerances.lobe_pitch",
}

_FORMAT = "cyclofeat rig 2"
# As the newest, but without effects.
_FIRST_FORMAT = "cyclofeat rig 1"
_NOTE = (
    "SI units: m, kg, kg m2, s, rad/s, Nm, Nm/rad, Pa; keys in _nm are Nm, in _hz Hz. [low, high] is a range "
    "from which each assembly draws; equal ends are a known value. Keys left out keep their default. effects "
    'is a list like [{"effect": "hum", "amplitude_nm": 0.2}], whose values are numbers or ranges.'
)

# Time constants of the slowest torsional mode until a start counts as settled: exp(-5) = 0.7 % is left.
_SETTLED = 5.0
# Longest settling, in s, that is simulated: rigs with next to no damping would run for hours.
LONGEST_SETTLING = 60.0


@dataclass(frozen=True)
class Rig:
    """A kind of gearbox on a kind of test rig: nominal values and spread between assemblies.

    The defaults are rig R0. Everything here that the papers do not state is an *assumption*, the three
    presets included; a torque record made with a rig is a surrogate for a measured one.

    Parameters
    ----------
    name : str
        Name of the rig; begins the names of its assemblies.
    gearbox : CycloidalGearbox
        Nominal gearbox, speed and load. Clearance, pin errors, run-outs and brake stay at their defaults
        here: they are drawn.
    tolerances : AssemblyTolerances
        Spread between assemblies.
    brake_inertia : (float, float) or None
        Lowest and highest inertia of the brake's rotor behind the torque meter, in kg m2. Ranges are drawn
        log-uniformly, once per assembly; equal ends are a known value. None, with both of the next: no
        brake, the free output of the papers.
    meter_stiffness : (float, float) or None
        Torsional stiffness of shaft and torque meter, in Nm/rad.
    meter_damping_ratio : (float, float) or None
        Share of critical damping of the rotor on that stiffness, below 1.
    contact_stiffness_factor, contact_damping_factor : (float, float)
        Factor on contact stiffness and damping, on top of the relative spread in ``tolerances``.
    load_drift_nm : float
        Rms in Nm of the brake's slow drift. It acts as load: the whole drive answers to it.
    load_drift_cutoff_hz : float
        Cutoff (-3 dB) of the drift's low-pass, in Hz, up to 1000.
    load_drift_order : int
        Order of that low-pass (Butterworth, on white noise), from 1 to 8.
    broad_drift_nm, broad_drift_cutoff_hz : float
        A second drift, independent of the first and of the same order: rms in Nm and cutoff in Hz.
    noise_nm : float
        Standard deviation in Nm of the torque meter's white noise.
    effects : sequence of Effect
        What else this rig does (:mod:`cyclofeat.simulators.effects`). Kept as a tuple of copies.
        :meth:`assemble` and :meth:`drift` know nothing of them:
        :class:`cyclofeat.simulators.CompositeSimulator` applies them.

    Raises
    ------
    TypeError
        If a parameter is of the wrong type.
    ValueError
        If a parameter is outside its range or contradicts another. The message names it.

    Examples
    --------
    >>> rig = Rig.r2()
    >>> assembly = rig.assemble(seed=1)
    >>> 0.005 <= assembly.brake_inertia <= 0.05
    True
    >>> rig.assemble(seed=1) == assembly
    True
    """

    name: str = "R0"
    gearbox: CycloidalGearbox = field(default_factory=CycloidalGearbox.steel)
    tolerances: AssemblyTolerances = field(default_factory=AssemblyTolerances)
    brake_inertia: Range | None = None
    meter_stiffness: Range | None = None
    meter_damping_ratio: Range | None = None
    contact_stiffness_factor: Range = (1.0, 1.0)
    contact_damping_factor: Range = (1.0, 1.0)
    load_drift_nm: float = 3.0
    load_drift_cutoff_hz: float = 1.5
    load_drift_order: int = 2
    broad_drift_nm: float = 0.0
    broad_drift_cutoff_hz: float = 25.0
    noise_nm: float = 0.2
    effects: tuple[Effect, ...] = ()

    def __post_init__(self) -> None:
        if not isinstance(self.name, str):
            raise TypeError(f"name must be text, got {self.name!r}")
        if not self.name or not self.name.isprintable():
            raise ValueError(f"name must be a line of printable text, got {self.name!r}")
        for name, kind in (("gearbox", CycloidalGearbox), ("tolerances", AssemblyTolerances)):
            check_type(name, getattr(self, name), kind)
        for preset in dataclasses.fields(CycloidalGearbox):
            value = getattr(self.gearbox, preset.name)
            if preset.name in _DRAWN and value != preset.default:
                raise ValueError(
                    f"gearbox.{preset.name} is drawn for each assembly and must be left out, got {value!r}: "
                    f"give {_DRAWN[preset.name]}"
                )
        for name in _BRAKE:
            below = 1.0 if name == "meter_damping_ratio" else math.inf
            if getattr(self, name) is not None:
                object.__setattr__(self, name, _range(name, getattr(self, name), below))
        given = [name for name in _BRAKE if getattr(self, name) is not None]
        if given and len(given) < len(_BRAKE):
            missing = [name for name in _BRAKE if name not in given]
            raise ValueError(
                f"{' and '.join(missing)} must be given with {' and '.join(given)}, got None: a brake needs "
                "all three, a free output none"
            )
        for name in _FACTORS:
            object.__setattr__(self, name, _range(name, getattr(self, name), math.inf))
        for name in ("load_drift_nm", "broad_drift_nm", "noise_nm"):
            value = number(name, getattr(self, name), "a number of Nm")
            if value < 0:
                raise ValueError(f"{name} must not be negative (Nm), got {value!r}")
            object.__setattr__(self, name, value)
        for name in ("load_drift_cutoff_hz", "broad_drift_cutoff_hz"):
            value = number(name, getattr(self, name), "a number of Hz")
            if not 0 < value <= _noise.HIGHEST_CUTOFF:
                raise ValueError(
                    f"{name} must lie above 0 and up to {_noise.HIGHEST_CUTOFF:g} Hz, got {value!r}"
                )
            object.__setattr__(self, name, value)
        order = self.load_drift_order
        if not is_whole(order):
            raise TypeError(f"load_drift_order must be a whole number, got {order!r}")
        if not 1 <= order <= _noise.HIGHEST_ORDER:
            raise ValueError(f"load_drift_order must lie between 1 and {_noise.HIGHEST_ORDER}, got {order!r}")
        object.__setattr__(self, "load_drift_order", int(order))
        object.__setattr__(self, "effects", checked_effects(self.effects))
        rotors = self.has_brake + sum(isinstance(effect, BrakeRotor) for effect in self.effects)
        if rotors > 1:
            raise ValueError(
                f"effects must hold no {BrakeRotor.effect_id} where the rig has a brake, and one at most, "
                f"got {rotors} brakes in all"
            )

    @classmethod
    def r0(cls) -> Rig:
        """Rig R0: the free output of the papers; 3 Nm drift below 1.5 Hz, 0.2 Nm noise. *Assumptions.*"""
        return cls(name="R0")

    @classmethod
    def r1(cls) -> Rig:
        """Rig R1: as R0, with one known brake for all assemblies. *Assumptions.*

        Rotor of 0.02 kg m2 behind a torque meter of 10 kNm/rad, 2 % damping.
        """
        return cls(
            name="R1",
            brake_inertia=(0.02, 0.02),
            meter_stiffness=(1e4, 1e4),
            meter_damping_ratio=(0.02, 0.02),
        )

    @classmethod
    def r2(cls) -> Rig:
        """Rig R2: brake and contacts differ between assemblies and are not known. *Assumptions.*

        Rotor 0.005-0.05 kg m2, meter 3-30 kNm/rad, 1-5 % damping; contact stiffness and damping within a
        factor of 2 (which takes the place of the +-25 % of R0 and R1); a second drift of 0.3 Nm rms below
        25 Hz, so that the brake disturbs the lobes' own frequencies too.
        """
        return cls(
            name="R2",
            tolerances=AssemblyTolerances(stiffness=0.0, damping=0.0),
            brake_inertia=(0.005, 0.05),
            meter_stiffness=(3e3, 3e4),
            meter_damping_ratio=(0.01, 0.05),
            contact_stiffness_factor=(0.5, 2.0),
            contact_damping_factor=(0.5, 2.0),
            broad_drift_nm=0.3,
        )

    @property
    def has_brake(self) -> bool:
        """Whether a brake's rotor turns behind the torque meter."""
        return self.brake_inertia is not None

    def replace(self, **changes: Any) -> Rig:
        """A copy with single fields changed, checked anew."""
        return dataclasses.replace(self, **changes)

    def assemble(self, seed: Seed) -> CycloidalGearbox:
        """One assembly: the gearbox with its own errors, contacts, speed, load and brake.

        Parameters
        ----------
        seed : int, numpy.random.SeedSequence or numpy.random.Generator
            The same int or SeedSequence gives the same assembly, in any process; a Generator moves on.

        Returns
        -------
        CycloidalGearbox

        Examples
        --------
        >>> Rig.r1().assemble(0).meter_stiffness
        10000.0
        """
        random = generator(seed)
        # Drawn whether needed or not: rigs that differ in one range keep everything else of an assembly.
        shares = random.random(len(_FACTORS) + len(_BRAKE))
        stiffness, damping = (
            _log_uniform(getattr(self, name), share) for name, share in zip(_FACTORS, shares, strict=False)
        )
        drawn = self.tolerances.draw(self.gearbox, random)
        drawn = drawn.replace(
            stiffness_scale=drawn.stiffness_scale * stiffness,
            contact_damping=drawn.contact_damping * damping,
        )
        if not self.has_brake:
            return drawn
        brake = [
            _log_uniform(getattr(self, name), share)
            for name, share in zip(_BRAKE, shares[len(_FACTORS) :], strict=True)
        ]
        return drawn.with_brake(*brake)

    def drift(self, seed: Seed, duration: float) -> Callable[[Float], Float]:
        """Fluctuation of the load around its mean, as a function of time: ``load_fluctuation`` of a run.

        White noise through a Butterworth low-pass (200 samples per period of the cutoff, joined by straight
        lines), stationary from t = 0 and scaled so that its expected mean square is exactly
        ``load_drift_nm**2``; likewise, and independently, for the broad drift.

        Parameters
        ----------
        seed : int, numpy.random.SeedSequence or numpy.random.Generator
            A longer drift of the same seed begins like a shorter one.
        duration : float
            Time in s for which it is needed.

        Returns
        -------
        callable
            Takes times of shape (n,) in s, from 0 to one second beyond ``duration``, and returns Nm of shape
            (n,). Times outside raise ValueError.

        Raises
        ------
        ValueError
            If ``duration`` is not positive and finite.

        Examples
        --------
        >>> load = Rig.r1().drift(seed=0, duration=2.0)
        >>> load(np.linspace(0, 2, 5)).shape
        (5,)
        """
        duration = number("duration", duration, "a number of s")
        if duration <= 0:
            raise ValueError(f"duration must be positive (s), got {duration!r}")
        slow, broad = _noise.streams(generator(seed), 2)
        end = duration + _noise.MARGIN
        parts = [
            _noise.low_passed_noise(stream, rms, cutoff, self.load_drift_order, end)
            for stream, rms, cutoff in (
                (slow, self.load_drift_nm, self.load_drift_cutoff_hz),
                (broad, self.broad_drift_nm, self.broad_drift_cutoff_hz),
            )
            if rms > 0
        ]
        return _noise.sum_of(parts, end)

    def to_json(self, path: str | os.PathLike[str]) -> None:
        """Write the description to a JSON file, every value explicit.

        Parameters
        ----------
        path : path
            File to write; one that exists is replaced.

        See Also
        --------
        from_json : What the file may hold.
        """
        Path(path).write_text(self.to_text(), encoding="utf-8")

    def to_text(self) -> str:
        """The description that :meth:`to_json` writes.

        Returns
        -------
        str
            JSON, the same for equal rigs.
        """
        lines = [f'  "format": {json.dumps(_FORMAT)}', f'  "note": {json.dumps(_NOTE)}']
        for item in dataclasses.fields(self):
            value = getattr(self, item.name)
            if item.name == "effects":
                text = _list_of([effect.to_dict() for effect in self.effects])
            elif dataclasses.is_dataclass(value):
                inner = (
                    f"    {json.dumps(name)}: {_json_value(getattr(value, name), default)}"
                    for name, default in _scalars(type(value)).items()
                )
                text = "{\n" + ",\n".join(inner) + "\n  }"
            else:
                text = _json_value(value, value)
            lines.append(f'  "{item.name}": {text}')
        return "{\n" + ",\n".join(lines) + "\n}\n"

    @classmethod
    def from_json(cls, path: str | os.PathLike[str]) -> Rig:
        """Read a description from a JSON file.

        The file holds one object. Its keys are the parameters of :class:`Rig`; ``"gearbox"`` and
        ``"tolerances"`` are objects with the parameters of :class:`CycloidalGearbox` and
        :class:`AssemblyTolerances`, in the same SI units. Ranges are ``[low, high]``, no brake is ``null``.
        ``"effects"`` is a list of objects: the effect's name under ``"effect"``, then its parameters, numbers
        or ranges (:func:`cyclofeat.simulators.effect_library` has them all). All keys may be left out.
        ``"note"`` is free text. Files of the first format, without effects, are read too.

        Parameters
        ----------
        path : path
            File in UTF-8.

        Returns
        -------
        Rig
            Equal to the one that was written.

        Raises
        ------
        FileNotFoundError
            If there is no such file.
        ValueError
            If the file is not JSON, or a key or value is wrong. The message names file, key and value, and
            says what would be right.

        Examples
        --------
        >>> import pathlib, tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = pathlib.Path(folder) / "rig.json"
        ...     Rig.r2().to_json(path)
        ...     Rig.from_json(path) == Rig.r2()
        True
        """
        try:
            return _rig_from(_read_json(path), cls)
        except (TypeError, ValueError) as error:
            raise ValueError(f"{os.fspath(path)}: {error}") from None


def rig_of(gearbox: CycloidalGearbox) -> Rig:
    """The rig whose assemblies are all this gearbox: without spread, drift and noise.

    Parameters
    ----------
    gearbox : CycloidalGearbox

    Raises
    ------
    ValueError
        If it has errors of single pins or wheels, which a rig draws, or a brake without damping.
    """
    defaults = {item.name: item.default for item in dataclasses.fields(gearbox)}
    changed = {name: defaults[name] for name in _DRAWN if name in defaults}
    for name, default in changed.items():
        if isinstance(default, tuple) and getattr(gearbox, name) != default:
            raise ValueError(
                f"gearbox.{name} must be empty to be described as a rig, which draws such errors for each "
                f"assembly: give {_DRAWN[name]}"
            )
    none: dict[str, Any] = {
        item.name: (0.0, 0.0) if isinstance(item.default, tuple) else 0.0
        for item in dataclasses.fields(AssemblyTolerances)
    }
    none["clearance"] = (gearbox.clearance, gearbox.clearance)
    brake: dict[str, Any] = {}
    if gearbox.brake_inertia > 0:
        critical = 2 * math.sqrt(gearbox.meter_stiffness * gearbox.brake_inertia)
        values = (gearbox.brake_inertia, gearbox.meter_stiffness, gearbox.meter_damping / critical)
        brake = {name: (value, value) for name, value in zip(_BRAKE, values, strict=True)}
    return Rig(
        name="gearbox",
        gearbox=gearbox.replace(**changed),
        tolerances=AssemblyTolerances(**none),
        load_drift_nm=0.0,
        noise_nm=0.0,
        **brake,
    )


def settling_time(gearbox: CycloidalGearbox) -> float:
    """Time from a start at rest until a run counts as steady: ramp and decay of the slowest torsional mode.

    With a brake that mode is the rotor (inertia J) on torque meter (k, c) and gearbox (k_g, c_g) in series:
    it decays with time constant 2 J / c_e, c_e = c (k_g / (k + k_g))^2 + c_g (k / (k + k_g))^2. The gearbox's
    share is estimated for all sleeves of the loaded half in Hertzian contact at the mean load. What was left
    of the start in the first output turn after that time, over the ripple (std, 96 simulated assemblies of
    R1 and R2 with 0 to 7 worn lobes): 0.1 % in the median, below 0.4 % in nine of ten, 4 % in the worst.

    Parameters
    ----------
    gearbox : CycloidalGearbox
        One assembly.

    Returns
    -------
    float
        Time in s: the ramp, then five time constants (0.7 % of the start's ringing is left), or one turn of
        the input where that is longer; infinite for a rig without any damping.

    Examples
    --------
    >>> round(settling_time(CycloidalGearbox.steel()), 2)
    0.32
    >>> 0.5 < settling_time(CycloidalGearbox.steel().with_brake(0.02, 1e4, 0.02)) < 1.5
    True
    """
    check_type("gearbox", gearbox, CycloidalGearbox)
    turn = 1 / gearbox.input_speed_hz
    if gearbox.brake_inertia == 0:
        return gearbox.ramp_time + turn
    # Lever arms of the loaded half: largest, and the sine's share of it, sleeve by sleeve.
    stages = (
        (gearbox.n_pins, gearbox.eccentricity * gearbox.n_lobes, gearbox.pin_radius),
        (gearbox.n_internal_sleeves, gearbox.internal_pitch_radius, joint_effective_radius(gearbox)),
    )
    stiffness, damping = np.array([_contact_stage(gearbox, *stage) for stage in stages]).T
    gear_share = stiffness.prod() / stiffness.sum() if stiffness.all() else 0.0
    gear_damping = damping.prod() / damping.sum() if damping.all() else 0.0
    meter_part = gear_share / (gear_share + gearbox.meter_stiffness)
    mode_damping = gearbox.meter_damping * meter_part**2 + gear_damping * (1 - meter_part) ** 2
    if mode_damping == 0:
        return math.inf
    decay = 2 * gearbox.brake_inertia / mode_damping
    return gearbox.ramp_time + float(max(turn, _SETTLED * decay))


def _contact_stage(
    gearbox: CycloidalGearbox, n_sleeves: int, largest_arm: float, radius: float
) -> tuple[float, float]:
    """Torsional stiffness (Nm/rad) and damping (Nms/rad) of one ring of contacts, both wheels together."""
    loaded = max(n_sleeves // 2, 1)
    arms = largest_arm * np.sin(np.pi * (np.arange(loaded) + 0.5) / loaded)
    contact = stiffness_factor(gearbox) * math.sqrt(radius)
    torque = gearbox.load_torque / 2  # per wheel
    # torque = contact * twist^1.5 * sum(arm^2.5), and the stiffness is its derivative
    levers = contact * float(np.sum(arms**2.5))
    stiffness = 1.5 * torque ** (1 / 3) * levers ** (2 / 3)
    weights = np.ones(loaded)
    if gearbox.contact_law == "hunt_crossley":
        weights = contact * ((torque / levers) ** (2 / 3) * arms) ** 1.5
    return 2 * stiffness, 2 * gearbox.contact_damping * float(np.sum(weights * arms**2))


def _log_uniform(ends: Range, share: float) -> float:
    """Value at ``share`` (0 to 1) of the way from the lower to the upper end, in logarithms."""
    low, high = ends
    return low if low == high else min(low * (high / low) ** float(share), high)


def _range(name: str, value: Any, below: float) -> Range:
    ends = pair(name, value)
    if not 0 < ends[0] <= ends[1] < below:
        limit = "" if below == math.inf else f" < {below:g}"
        raise ValueError(f"{name} must be (low, high) with 0 < low <= high{limit}, got {ends!r}")
    return ends


# Reading and writing JSON.


def _scalars(kind: type[Any]) -> dict[str, Any]:
    """Fields of gearbox or tolerances that a file may hold, with their defaults."""
    drawn: Mapping[str, str] = _DRAWN if kind is CycloidalGearbox else {}
    return {item.name: item.default for item in dataclasses.fields(kind) if item.name not in drawn}


def _json_value(value: Any, default: Any) -> str:
    if isinstance(default, tuple):
        return json.dumps([float(end) for end in value])
    if isinstance(default, (float, int)):
        return json.dumps(type(default)(value))
    return json.dumps(value, ensure_ascii=False)


def _list_of(objects: list[dict[str, Any]]) -> str:
    """A JSON list of objects, one to a line."""
    if not objects:
        return "[]"
    lines = (f"    {json.dumps(one, ensure_ascii=False, allow_nan=False)}" for one in objects)
    return "[\n" + ",\n".join(lines) + "\n  ]"


def _read_json(path: str | os.PathLike[str]) -> Any:
    try:
        text = Path(path).read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise FileNotFoundError(
            f"{os.fspath(path)}: no such file; Rig.to_json writes a description of a rig"
        ) from None
    except UnicodeDecodeError as error:
        raise ValueError(
            f"is not text in UTF-8 (byte {error.start}); a description of a rig is a JSON file"
        ) from None
    except OSError as error:
        raise OSError(f"{os.fspath(path)}: cannot be read ({error.strerror}); give a JSON file") from None
    try:
        return json.loads(text, object_pairs_hook=_distinct, parse_int=_whole)
    except json.JSONDecodeError as error:
        raise ValueError(
            f"is not valid JSON: {error.msg} at line {error.lineno}, column {error.colno}; "
            'a description of a rig looks like {"name": "mine", "load_drift_nm": 3.0}'
        ) from None
    except RecursionError:
        raise ValueError("is not a description of a rig: brackets are nested too deeply") from None


def _whole(digits: str) -> float:
    try:
        return int(digits)
    except ValueError:  # more digits than Python converts
        return math.inf


def _distinct(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for key, value in pairs:
        if key in found:
            raise ValueError(
                f"key {key!r} must stand only once in its object, got it with {short(found[key])} and with "
                f"{short(value)}"
            )
        found[key] = value
    return found


def _rig_from(content: Any, kind: type[Rig]) -> Rig:
    known = {item.name: None for item in dataclasses.fields(kind)}
    given = dict(_object("the file", content))
    note, form = given.pop("note", ""), given.pop("format", _FORMAT)
    if not isinstance(note, str):
        raise TypeError(f"note must be text, got {short(note)}")
    if form not in (_FORMAT, _FIRST_FORMAT):
        raise ValueError(f"format must be {_FORMAT!r} or {_FIRST_FORMAT!r}, got {short(form)}")
    if form == _FIRST_FORMAT and "effects" in given:
        raise ValueError(f"effects need the format {_FORMAT!r}, got {form!r}")
    _reject_unknown(given, [*known, "format", "note"], "")
    for name, part in (("gearbox", CycloidalGearbox), ("tolerances", AssemblyTolerances)):
        if name in given:
            given[name] = _part_from(name, part, given[name])
    if "effects" in given:
        given["effects"] = effects_from_list(given["effects"])
    for name in (*_BRAKE, *_FACTORS):
        if given.get(name) is not None:
            given[name] = pair(name, given[name])
    return kind(**given)


def _part_from(section: str, kind: type[Any], content: Any) -> Any:
    """Gearbox or tolerances from an object of the file."""
    defaults = _scalars(kind)
    given = _object(section, content)
    for key, value in given.items():
        if kind is CycloidalGearbox and key in _DRAWN:
            raise ValueError(
                f"{section}.{key} is drawn for each assembly and must be left out, got {short(value)}: "
                f"give {_DRAWN[key]}"
            )
    _reject_unknown(given, list(defaults), section + ".")
    values = {key: _like(defaults[key], f"{section}.{key}", value) for key, value in given.items()}
    try:
        return kind(**values)
    except ValueError as error:
        raise ValueError(f"{section}: {error}") from None


def _like(default: Any, name: str, value: Any) -> Any:
    """The value, if it is of the same kind as the default."""
    if isinstance(default, tuple):
        return pair(name, value)
    if isinstance(default, float):
        return number(name, value, "a number")
    kind, what = (int, "a whole number") if isinstance(default, int) else (str, "text")
    if not isinstance(value, kind) or isinstance(value, bool):
        raise TypeError(f"{name} must be {what}, got {short(value)}")
    return value


def _object(name: str, content: Any) -> Mapping[str, Any]:
    if not isinstance(content, dict):
        raise TypeError(f"{name} must hold a JSON object {{...}}, got {short(content)}")
    return content


def _reject_unknown(given: Mapping[str, Any], known: list[str], prefix: str) -> None:
    for key, value in given.items():
        if key not in known:
            near = difflib.get_close_matches(key, known, n=1)
            right = f"did you mean {prefix + near[0]!r}?" if near else f"known are {', '.join(known)}"
            raise ValueError(f"unknown key {prefix + key!r} with value {short(value)}: {right}")
