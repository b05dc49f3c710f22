"""Effects from a user's Python file, for this and other processes."""

from __future__ import annotations

import importlib.util
import inspect
import linecache
import os
import sys
import traceback
import types
from pathlib import Path
from typing import Any

from cyclofeat.simulators._simulator import Simulator
from cyclofeat.simulators.effects.effect import Effect
from cyclofeat.simulators.effects.library import is_known, register_effect

_PREFIX = "cyclofeat_effects_"


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
    FileNotFoundError
        If there is no such file.
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
        raise FileNotFoundError(
            f"{file}: no such file; give a Python file with subclasses of Effect"
        ) from None
    except UnicodeDecodeError as error:
        raise ValueError(f"{file}: is not text in UTF-8 (byte {error.start})") from None
    module = _run(str(file.resolve()), text)
    kinds = _effects_in(module)
    if not kinds:
        raise ValueError(f"{file}: defines no subclass of Effect")
    for kind in kinds:
        _register(kind, str(file.resolve()))  # again, in case it was unregistered
    return {kind.effect_id: kind for kind in kinds}


def _run(file: str, text: str, *, replace: bool = False) -> types.ModuleType:
    """Return the module of a file's text, run and registered once in each process."""
    name = _PREFIX + "".join(letter if letter.isalnum() else "_" for letter in file)
    module = sys.modules.get(name)
    if module is not None and vars(module).get("__effects_text__") == text:
        return module
    spec = importlib.util.spec_from_loader(name, loader=None, origin=file)
    assert spec is not None
    before, module = module, importlib.util.module_from_spec(spec)
    module.__file__ = file
    vars(module)["__effects_text__"] = text
    sys.modules[name] = module  # dataclasses and pickle look there
    # Tracebacks and inspect can show the text even if this process does not have the file.
    linecache.cache[file] = (len(text), None, text.splitlines(keepends=True), file)
    try:
        exec(compile(text, file, "exec"), vars(module))
        for kind in _effects_in(module):
            _register(kind, file, replace=replace)
        for simulator in _classes_in(module, Simulator):
            simulator.__reduce__ = _reduce  # type: ignore[assignment]
    except BaseException as error:
        sys.modules.pop(name)
        if before is not None:
            sys.modules[name] = before
        if isinstance(error, _NotAnEffect) or not isinstance(error, Exception):
            raise
        if isinstance(error, SyntaxError):
            line = error.lineno or 1
        else:
            trace = traceback.extract_tb(error.__traceback__)
            line = next((frame.lineno for frame in reversed(trace) if frame.filename == file), None) or 1
        raise ValueError(f"{file}, line {line}: {type(error).__name__}: {error}") from error
    return module


class _NotAnEffect(ValueError):
    """Class of a file that cannot be registered; the message names file and line."""


def _register(kind: type[Effect], file: str, *, replace: bool = False) -> None:
    """Register an effect of a file, and make its instances picklable."""
    if is_known(kind):
        return
    try:
        register_effect(kind, replace=replace)
    except (TypeError, ValueError) as error:
        line = inspect.getsourcelines(kind)[1]
        raise _NotAnEffect(f"{file}, line {line}: {error}") from None
    kind.__reduce__ = _reduce  # type: ignore[assignment]


def _classes_in(module: types.ModuleType, base: type[Any]) -> list[type[Any]]:
    """Return the subclasses of a base that a module defines."""
    return [
        kind
        for kind in vars(module).values()
        if inspect.isclass(kind) and issubclass(kind, base) and kind.__module__ == module.__name__
    ]


def _effects_in(module: types.ModuleType) -> list[type[Effect]]:
    return [kind for kind in _classes_in(module, Effect) if not kind.__name__.startswith("_")]


def _reduce(instance: Effect | Simulator) -> tuple[Any, ...]:
    """Pickle with the text that defines the class: other processes do not have the module."""
    module = sys.modules[type(instance).__module__]
    text = vars(module)["__effects_text__"]
    kind: Any = type(instance)
    parameters = {name: getattr(instance, name) for name in inspect.signature(kind).parameters}
    return _rebuild, (module.__file__, text, kind.__qualname__, parameters)


def _rebuild(file: str, text: str, name: str, parameters: dict[str, Any]) -> Effect | Simulator:
    """Return what :func:`_reduce` took; an effect replaces one of another file with the same name."""
    kind = getattr(_run(file, text, replace=True), name)
    if issubclass(kind, Effect):
        _register(kind, file, replace=True)
    instance: Effect | Simulator = kind(**parameters)
    return instance
