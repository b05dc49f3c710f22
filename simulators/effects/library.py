"""The effects by name, those of users and their Python files included."""

from __future__ import annotations

import copy
import inspect
import linecache
import os
import re
import sys
import traceback
import types
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeVar

import numpy as np

from cyclofeat._base.checks import list_members, repr_of
from cyclofeat.simulators._simulator import Simulator
from cyclofeat.simulators.effects import _drive, _gearbox, _meter
from cyclofeat.simulators.effects.effect import (
    HOOKS,
    PLACES,
    Effect,
    EffectParameter,
    file_keys,
    from_plain,
    reject_unknown,
    settings_of_file,
    suggest_key,
)

Kind = TypeVar("Kind", bound=type[Effect])
T = TypeVar("T")

# Each effect of the toolkit with its default values, in the order of the chain.
_OF_TOOLKIT: dict[str, Effect] = {
    effect.effect_id: effect
    for effect in (
        _gearbox.GearboxParameter(), _gearbox.PinErrors(), _gearbox.LobePitchErrors(), _gearbox.RunOut(),
        _gearbox.CamRunOut(), _gearbox.Clearance(), _gearbox.Scale("contact_stiffness", 2.0),
        _gearbox.Scale("contact_damping", 2.0), _gearbox.ContactDampingForm(),
        _drive.Drift(), _drive.ProportionalDrift(), _gearbox.Scale("load", 1.02),
        _gearbox.Scale("speed", 1.01), _drive.SpeedWander(), _drive.StickSlip(), _drive.Rattle(),
        _drive.WarmUp(), _gearbox.SleeveFriction(), _gearbox.BearingFriction(), _gearbox.BrakeRotor(),
        _meter.TorqueMeterLowPass(), _drive.WarmUp(of="sensor"), _drive.Drift(of="sensor"), _meter.Gain(),
        _meter.Offset(), _meter.Noise(), _meter.Hum(), _meter.ShaftLine(), _meter.ShaftLine(of="output"),
        _meter.ClockError(), _meter.Quantisation(), _meter.Clipping(), _meter.LostSamples(),
        _drive.ServoMotor(), _drive.TorqueConstantRipple(), _drive.Cogging(), _drive.MotorFriction(),
        _drive.CurrentSensor(),
    )
}  # fmt: skip
_KNOWN = dict(_OF_TOOLKIT)

# Modules of users' files, by their paths.
_PREFIX = "cyclofeat_effects_"

# Keys of the random streams of the hooks, appended to the key of their effect.
RANGES, GEARBOX, LOAD, SPEED, TORQUE, SIMULATOR, MOTOR = range(7)


def known_effects(*, proposed: bool = False) -> Mapping[str, Effect]:
    """Return all effects that rigs and files can name, with their default values.

    Parameters
    ----------
    proposed : bool, default False
        Return only the effects that a search proposes when it adds one at a time: one of look-alikes is
        enough. The gap workflow weighs more of them, ``cyclofeat.gap.World().effects``. Registered effects
        with a fitted parameter are among them (:func:`register_effect`).

    Returns
    -------
    mapping from str to Effect
        By name, in the order of the chain; cannot be changed.

    Examples
    --------
    >>> known_effects()["hum"].with_parameters(amplitude_nm=0.1)
    Hum(amplitude_nm=0.1)
    """
    return MappingProxyType(
        {
            effect.effect_id: copy.copy(effect)
            for effect in in_chain(_KNOWN.values())
            if not proposed or (effect.proposed and effect.vector_names())
        }
    )


def look_alikes() -> tuple[tuple[str, ...], ...]:
    """Return groups of effects that look alike at one speed, load and direction, the proposed ones first."""
    groups: dict[str, list[str]] = {}
    for effect in sorted(in_chain(_KNOWN.values()), key=lambda effect: not effect.proposed):
        groups.setdefault(effect.shows_as, []).append(effect.effect_id)
    return tuple(tuple(groups[name]) for name in sorted(groups) if name)


def register_effect(kind: Kind, *, replace: bool = False) -> Kind:
    """Make an effect known to files, commands, campaigns and the gap workflow, and return its class.

    Use it as a decorator, or call it with the class. A class that is defined again in the same place (a
    notebook's cell run again) replaces the earlier one.

    Parameters
    ----------
    kind : Effect subclass
        Has a default for every argument of its constructor.
    replace : bool, default False
        Replace another registered effect of that name; effects of the toolkit are never replaced.

    Returns
    -------
    Effect subclass
        The class itself.

    Raises
    ------
    TypeError, ValueError
        If ``kind`` is no subclass of :class:`Effect`, its name, place, hooks, parameters or constructor are
        not those of an effect, or the name is taken.

    Examples
    --------
    >>> from scipy.stats import loguniform
    >>> @register_effect
    ... class Cube(Effect):
    ...     "Cubic error of the torque meter."
    ...
    ...     parameters = {"share": EffectParameter("1", 0.0, 1.0, neutral=0.0, prior=loguniform(1e-4, 0.1))}
    ...
    ...     def change_torque(self, torque, sampling_rate, random, context=None):
    ...         return torque + self.share * torque**3 / 22**2
    >>> known_effects()["cube"].parameters["share"].unit
    '1'
    >>> unregister_effect("cube")
    """
    if not (inspect.isclass(kind) and issubclass(kind, Effect)) or kind is Effect:
        raise TypeError(f"register_effect needs a subclass of Effect, got {repr_of(kind)}")
    name = kind.__name__
    parameters = kind.parameters
    if not isinstance(parameters, Mapping) or not all(
        isinstance(one, EffectParameter) for one in parameters.values()
    ):
        what = "a mapping from names to EffectParameter"
        raise ValueError(f"parameters of {name} must be {what}, got {repr_of(parameters)}")
    arguments = inspect.signature(kind).parameters
    for key, argument in arguments.items():
        if argument.kind in (argument.VAR_POSITIONAL, argument.VAR_KEYWORD):
            raise ValueError(f"{name}.__init__ must name its arguments, got *{key}")
        if argument.default is argument.empty:
            raise TypeError(f"{name}.__init__ must have a default for {key!r}: {name}() must be possible")
    for key, parameter in parameters.items():
        if not parameter.low < parameter.high:
            raise ValueError(f"{key} of {name} must have low < high, got {parameter!r}")
        if key not in arguments:
            raise ValueError(f"{name}.__init__ must take the parameter {key!r}, got {', '.join(arguments)}")
        if parameter.prior is not None:
            parameter._check(f"prior of {key} of {name}", parameter.prior)
    effect = kind()
    if not isinstance(effect.effect_id, str) or not re.fullmatch(r"[a-z][a-z0-9_]*", effect.effect_id):
        raise ValueError(f"effect_id of {name} must be a name in snake_case, got {effect.effect_id!r}")
    if not any(effect.overrides(hook) for hook in HOOKS):
        raise ValueError(f"{name} must override one of {', '.join(HOOKS)}: else it does nothing")
    place = getattr(effect, "place", None)
    if place not in PLACES:
        raise ValueError(f"place of {name} must be stated, one of {', '.join(PLACES)}, got {place!r}")
    effect._check()
    if missing := [key for key in arguments if not hasattr(effect, key)]:
        raise ValueError(f"{name}.__init__ must store {', '.join(missing)} under the same name")
    taken = type(_KNOWN.get(effect.effect_id, effect))
    places = [f"{one.__module__}.{one.__qualname__}" for one in (taken, kind)]
    if taken is not kind and (effect.effect_id in _OF_TOOLKIT or not (places[0] == places[1] or replace)):
        what = f"{effect.effect_id!r}, which is that of {places[0]}"
        raise ValueError(f"effect_id of {name} must be a name of its own, got {what}")
    _KNOWN[effect.effect_id] = effect
    return kind


def unregister_effect(effect_id: str) -> None:
    """Remove a registered effect from those known.

    Parameters
    ----------
    effect_id : str
        Registered before; effects of the toolkit stay.
    """
    registered = [name for name in _KNOWN if name not in _OF_TOOLKIT]
    if effect_id not in registered:
        raise ValueError(f"effect_id must be one of the effects registered, {registered}, got {effect_id!r}")
    del _KNOWN[effect_id]


def checked_effects(effects: Any) -> tuple[Effect, ...]:
    """Return checked copies of the effects, in the order given."""
    given = list_members(effects)
    if given is None or not all(isinstance(effect, Effect) for effect in given):
        raise TypeError(f"effects must be several effects like Hum(amplitude_nm=0.2), got {repr_of(effects)}")
    return tuple(effect.with_parameters() for effect in given)


def read_variants(content: Any, read: Callable[[Any], tuple[Effect, ...]]) -> tuple[tuple[Effect, ...], ...]:
    """Return the sets of effects that ``read`` makes of each item of a sequence."""
    if not isinstance(content, Sequence) or isinstance(content, str):
        raise TypeError(f"variants must be a list of lists of effects, got {repr_of(content)}")
    return _read_items("variants", content, read)


def _read_items(name: str, content: Sequence[Any], read: Callable[[Any], T]) -> tuple[T, ...]:
    """Return what ``read`` makes of each item of a list in a file; name the item in errors."""
    items = []
    for index, item in enumerate(content):
        try:
            items.append(read(item))
        except (TypeError, ValueError) as error:
            raise type(error)(f"{name}[{index}]: {error}") from None
    return tuple(items)


def in_chain(effects: Iterable[Effect]) -> tuple[Effect, ...]:
    """Return the effects in the order of the chain; those of one place stay in the order given."""
    return tuple(sorted(effects, key=lambda effect: PLACES.index(effect.place)))


def label_effects(effects: Iterable[Effect]) -> dict[str, Effect]:
    """Return the effects of a rig by labels such as ``"hum_2"``, as :meth:`Rig.parameters` names them."""
    seen: Counter[str] = Counter()
    of_label = {}
    for effect in effects:
        label = effect.effect_id
        if isinstance(effect, _gearbox.GearboxParameter):
            label += f"_{effect.parameter}"
        seen[label] += 1
        of_label[label if seen[label] == 1 else f"{label}_{seen[label]}"] = effect
    return of_label


def stream_keys(effects: Iterable[Effect]) -> list[tuple[int, ...]]:
    """Return the key of each effect's random numbers: its name, and how many of that name precede it.

    So adding an effect does not change the random numbers of the others.
    """
    seen: Counter[str] = Counter()
    keys = []
    for effect in effects:
        # Bytes of a name are larger than the numbers of a seed's other children.
        keys.append((*effect.effect_id.encode(), 0, seen[effect.effect_id]))
        seen[effect.effect_id] += 1
    return keys


def child_seed(seed: np.random.SeedSequence, *key: int) -> np.random.SeedSequence:
    """Return a child of a seed; unlike ``spawn``, which counts its calls, leave the seed as it is."""
    return np.random.SeedSequence(
        entropy=seed.entropy, spawn_key=(*seed.spawn_key, *key), pool_size=seed.pool_size
    )


def stream(seed: np.random.SeedSequence, *key: int) -> np.random.Generator:
    """Return the random numbers of the seed's child of that key."""
    return np.random.default_rng(child_seed(seed, *key))


def effects_from_list(content: Any) -> tuple[Effect, ...]:
    """Return effects from a list of objects, as :meth:`Effect.to_dict` writes them."""
    if not isinstance(content, list):
        raise TypeError(f'effects must be a list of objects like {{"effect": "hum"}}, got {repr_of(content)}')
    return _read_items("effects", content, effect_from_dict)


def effect_from_dict(content: Any) -> Effect:
    """Return the effect of an object as :meth:`Effect.to_dict` writes it; other keys keep their default."""
    if not isinstance(content, dict) or not isinstance(content.get("effect"), str):
        raise TypeError(f'must be an object like {{"effect": "hum", ...}}, got {repr_of(content)}')
    name = content["effect"]
    effect = _KNOWN.get(name)
    if effect is None:
        raise ValueError(f"unknown effect {repr_of(name)}: {suggest_key(name, _KNOWN)}")
    given, values = settings_of_file(content), {}
    del given["effect"]
    reject_unknown(given, file_keys(effect), of=f" of {name}")
    for key, value in given.items():
        try:
            value = from_plain(value)
        except (TypeError, ValueError) as error:
            raise type(error)(f"{key} of {name}: {error}") from None
        parameter = effect.parameters.get(key)
        values[key] = np.inf if value is None and parameter and np.isinf(parameter.high) else value
    return effect.with_parameters(**values)


def load_effects(path: str | os.PathLike[str]) -> dict[str, type[Effect]]:
    """Run a Python file and register every effect that it defines.

    Worker processes of joblib and Dask need not have the file: they receive its text and run it.

    Parameters
    ----------
    path : path
        Python file in UTF-8. Classes whose name begins with an underscore are not registered. Rig files may
        name its subclasses of :class:`cyclofeat.simulators.Simulator`.

    Returns
    -------
    dict from str to Effect subclass
        The effects of the file by name. An unchanged file is run once.

    Raises
    ------
    ValueError
        If the file cannot be run, defines no effect or a wrong one (:func:`register_effect`); the message
        names file and line.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> text = '''
    ... from cyclofeat.simulators import Effect
    ...
    ... class UpsideDown(Effect):
    ...     "Torque meter that is wired the wrong way round."
    ...
    ...     def change_torque(self, torque, sampling_rate, random, context=None):
    ...         return -torque
    ... '''
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = pathlib.Path(folder) / "mine.py"
    ...     _ = path.write_text(text)
    ...     list(load_effects(path))
    ['upside_down']
    >>> from cyclofeat.simulators.effects import unregister_effect
    >>> unregister_effect("upside_down")
    """
    file = Path(path)
    try:
        text = file.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise FileNotFoundError(f"{file}: no such file; give one with subclasses of Effect") from None
    except UnicodeDecodeError as error:
        raise ValueError(f"{file}: is not text in UTF-8 (byte {error.start})") from None
    kinds = _classes_in(_run_file(str(file.resolve()), text), Effect)
    if not kinds:
        raise ValueError(f"{file}: defines no subclass of Effect")
    return {kind.effect_id: kind for kind in kinds}


def _run_file(file: str, text: str, *, replace: bool = False) -> types.ModuleType:
    """Return the module of a file's text, which is run once in each process; register its effects."""
    name = _PREFIX + "".join(letter if letter.isalnum() else "_" for letter in file)
    before = sys.modules.get(name)
    kind: type[Effect] | None = None
    module = before or types.ModuleType(name)
    try:
        if vars(module).get("__effects_text__") != text:
            module = types.ModuleType(name)
            module.__file__ = file
            vars(module)["__effects_text__"] = text
            sys.modules[name] = module  # dataclasses and pickle look there
            # Tracebacks and inspect can show the text even if this process does not have the file.
            linecache.cache[file] = (len(text), None, text.splitlines(keepends=True), file)
            exec(compile(text, file, "exec"), vars(module))
            for defined in (*_classes_in(module, Effect), *_classes_in(module, Simulator)):
                defined.__reduce__ = _reduce_to_text  # type: ignore[assignment]
        for kind in _classes_in(module, Effect):
            if type(_KNOWN.get(kind.effect_id)) is not kind:
                register_effect(kind, replace=replace)
    except BaseException as error:
        what = f"{type(error).__name__}: {error}"
        if kind is not None:
            line, what = inspect.getsourcelines(kind)[1], str(error)
        elif isinstance(error, SyntaxError):
            line = error.lineno or 1
        else:
            trace = traceback.extract_tb(error.__traceback__)
            line = next((frame.lineno for frame in reversed(trace) if frame.filename == file), None) or 1
        sys.modules.pop(name)
        if before is not None:
            sys.modules[name] = before
        if not isinstance(error, Exception):
            raise
        raise ValueError(f"{file}, line {line}: {what}") from error
    return module


def _classes_in(module: types.ModuleType, base: type[Any]) -> list[type[Any]]:
    """Return the subclasses of a base that a module defines under public names."""
    kinds = [kind for kind in vars(module).values() if inspect.isclass(kind) and issubclass(kind, base)]
    return [kind for kind in kinds if kind.__module__ == module.__name__ and kind.__name__[0] != "_"]


def _reduce_to_text(instance: Effect | Simulator) -> tuple[Any, ...]:
    """Pickle with the text that defines the class: other processes do not have the module."""
    module = sys.modules[type(instance).__module__]
    text = vars(module)["__effects_text__"]
    kind: Any = type(instance)
    parameters = {name: getattr(instance, name) for name in inspect.signature(kind).parameters}
    return _rebuild_from_text, (module.__file__, text, kind.__qualname__, parameters)


def _rebuild_from_text(file: str, text: str, name: str, parameters: dict[str, Any]) -> Effect | Simulator:
    """Return what :func:`_reduce_to_text` took; an effect replaces one of another file with the same name."""
    instance: Effect | Simulator = getattr(_run_file(file, text, replace=True), name)(**parameters)
    return instance
