"""Rigs as JSON files."""

from __future__ import annotations

import dataclasses
import json
import math
import os
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, TypeVar

from cyclofeat._base.checks import number, repr_of
from cyclofeat.simulators._simulator import Simulator
from cyclofeat.simulators.effects import Effect
from cyclofeat.simulators.effects._parameter import suggest_key, to_plain
from cyclofeat.simulators.effects.library import effects_from_list, read_variants
from cyclofeat.simulators.gearbox import CycloidalGearbox

Made = TypeVar("Made")
FORMAT = "cyclofeat rig"
_NOTE = (
    "SI units: m, kg, kg m2, s, rad/s, Nm, Nm/rad, Pa; keys in _nm are Nm, in _hz Hz. effects is a list like "
    '[{"effect": "hum", "amplitude_nm": 0.2}]. A value may be a number, a range [low, high], or a '
    'distribution {"distribution": "norm", "loc": 0.2, "scale": 0.05}, from which each assembly draws. Keys '
    "left out keep their default."
)


def rig_to_dict(name: str, gearbox: CycloidalGearbox, effects: Iterable[Effect]) -> dict[str, Any]:
    """Return the content of a rig's file in types that JSON knows, without format and note."""
    fields = {item.name: getattr(gearbox, item.name) for item in dataclasses.fields(gearbox)}
    plain = {
        key: _plain_value(value) for key, value in fields.items() if not isinstance(value, tuple) or value
    }
    return {"name": name, "gearbox": plain, "effects": [effect.to_dict() for effect in effects]}


def rig_to_text(content: Mapping[str, Any]) -> str:
    """Return the file of a rig, one field of the gearbox and one effect to a line."""

    def line(value: Any) -> str:
        return json.dumps(value, ensure_ascii=False, allow_nan=False)

    gearbox = ",\n".join(f"    {line(key)}: {line(value)}" for key, value in content["gearbox"].items())
    lists = {
        name: ",\n".join(f"    {line(item)}" for item in content[name])
        for name in ("effects", "variants")
        if name in content
    }
    parts = {
        "format": line(FORMAT),
        "note": line(_NOTE),
        "name": line(content["name"]),
        "gearbox": f"{{\n{gearbox}\n  }}",
    } | {name: f"[\n{items}\n  ]" if items else "[]" for name, items in lists.items()}
    if "simulator" in content:
        parts["simulator"] = line(content["simulator"])
    return "{\n" + ",\n".join(f'  "{key}": {text}' for key, text in parts.items()) + "\n}\n"


def rig_from_dict(content: Any) -> dict[str, Any]:
    """Return the arguments of a Rig from the content of a file."""
    given = dict(_check_object("the file", content))
    reject_unknown(given, ["format", "note", "name", "gearbox", "effects", "variants", "simulator"])
    note, form = given.pop("note", ""), given.pop("format", FORMAT)
    if not isinstance(note, str):
        raise TypeError(f"note must be text, got {repr_of(note)}")
    if form != FORMAT:
        raise ValueError(f"format must be {FORMAT!r}, got {repr_of(form)}")
    if "gearbox" in given:
        fields = _check_object("gearbox", given["gearbox"])
        defaults = {item.name: item.default for item in dataclasses.fields(CycloidalGearbox)}
        reject_unknown(fields, defaults, "gearbox.")
        values = {key: _check_field(defaults[key], f"gearbox.{key}", value) for key, value in fields.items()}
        try:
            given["gearbox"] = CycloidalGearbox(**values)
        except (TypeError, ValueError) as error:
            raise type(error)(f"gearbox: {error}") from None
    if "effects" in given:
        given["effects"] = effects_from_list(given["effects"])
    if "variants" in given:
        given["variants"] = read_variants(given["variants"], effects_from_list)
    if given.get("simulator") is not None:
        given["simulator"] = Simulator.from_dict(_check_object("simulator", given["simulator"]))
    return given


def read_json(path: str | os.PathLike[str], make: Callable[[Any], Made], what: str, example: str) -> Made:
    """Return what ``make`` makes of the content of a JSON file in UTF-8 without repeated keys.

    ``what`` names the description in messages ("a rig"), ``example`` is one in a line. Errors name the file.
    """
    name = os.fspath(path)
    try:
        text = Path(path).read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise FileNotFoundError(f"{name}: no such file; to_json writes a description of {what}") from None
    except UnicodeDecodeError as error:
        raise ValueError(
            f"{name}: is not text in UTF-8 (byte {error.start}); a description of {what} is a JSON file"
        ) from None
    except OSError as error:
        raise OSError(f"{name}: cannot be read ({error.strerror}); give a JSON file") from None
    try:
        return make(json.loads(text, object_pairs_hook=_unique_keys, parse_int=_parse_whole))
    except json.JSONDecodeError as error:
        raise ValueError(
            f"{name}: is not valid JSON: {error.msg} at line {error.lineno}, column {error.colno}; "
            f"a description of {what} looks like {example}"
        ) from None
    except RecursionError:
        raise ValueError(f"{name}: is not a description of {what}: brackets are nested too deeply") from None
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name}: {error}") from None


def reject_unknown(given: Mapping[str, Any], known: Iterable[str], prefix: str = "") -> None:
    """Raise ValueError for the first unknown key; the message has the nearest."""
    names = list(known)
    for key, value in given.items():
        if key not in names:
            right = suggest_key(key, names, prefix)
            raise ValueError(f"unknown key {prefix + key!r} with value {repr_of(value)}: {right}")


def _plain_value(value: Any) -> Any:
    """Return a field of the gearbox as JSON; complex numbers become [re, im]."""
    if isinstance(value, tuple):
        return [[one.real, one.imag] if isinstance(one, complex) else float(one) for one in value]
    return to_plain(value, is_parameter=False)


def _check_field(default: Any, name: str, value: Any) -> Any:
    """Return the value if it is of the kind of the default."""
    if isinstance(default, tuple):
        if not isinstance(value, list):
            raise TypeError(f"{name} must be a list of numbers, or of pairs [re, im], got {repr_of(value)}")
        return tuple(
            complex(*(number(name, part) for part in one))
            if isinstance(one, list) and len(one) == 2
            else number(name, one)
            for one in value
        )
    if isinstance(default, float):
        return number(name, value, "a number")
    kind, what = (int, "a whole number") if isinstance(default, int) else (str, "text")
    if not isinstance(value, kind) or isinstance(value, bool):
        raise TypeError(f"{name} must be {what}, got {repr_of(value)}")
    return value


def _check_object(name: str, content: Any) -> Mapping[str, Any]:
    if not isinstance(content, dict):
        raise TypeError(f"{name} must hold a JSON object {{...}}, got {repr_of(content)}")
    return content


def _parse_whole(digits: str) -> float:
    try:
        return int(digits)
    except ValueError:  # more digits than Python converts
        return math.inf


def _unique_keys(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    distinct: dict[str, Any] = {}
    for key, value in pairs:
        if key in distinct:
            raise ValueError(
                f"key {key!r} must stand only once in its object, got it with {repr_of(distinct[key])} and "
                f"with {repr_of(value)}"
            )
        distinct[key] = value
    return distinct
