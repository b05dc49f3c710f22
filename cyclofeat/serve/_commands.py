"""Command lines for what the page asks."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from cyclofeat._base.words import number
from cyclofeat.datasets.readers import MANIFEST, folder_entries
from cyclofeat.serve._store import Refused, Store

_READING = {
    "channel": "--channel", "quantity": "--quantity", "speed": "--speed", "scale": "--scale",
    "sampling_rate": "--sampling-rate",
    "time_channel": "--time-channel", "angle_channel": "--angle-channel", "angle_unit": "--angle-unit",
    "pulses_per_turn": "--pulses-per-turn", "n_lobes": "--n-lobes", "delimiter": "--delimiter",
}  # fmt: skip
_SWITCHES = {"no_angle": "--no-angle", "angle_is_absolute": "--angle-absolute"}
_TITLES = {"inspect": "Inspection", "count": "Count", "gap": "Gap"}
_LONGEST_VALUE = 200


class Order(NamedTuple):
    """One command to run.

    Parameters
    ----------
    command : str
    title : str
        What the page calls it.
    arguments : list of str
        Of the command, ``--json`` left out.
    recordings : tuple of str
        Names of the recordings that it reads.
    outputs : tuple of str
        Names of the files that it writes into its folder and that can be downloaded.
    """

    command: str
    title: str
    arguments: list[str]
    recordings: tuple[str, ...] = ()
    outputs: tuple[str, ...] = ()


def order(asked: Mapping[str, Any], store: Store, model: list[str], folder: Path) -> Order:
    """Return the command for a request of the page.

    Parameters
    ----------
    asked : mapping
        ``command``, ``recordings`` (names), ``options`` (name to text).
    store : Store
    model : list of str
        Options that name the model; empty for the packaged ones.
    folder : pathlib.Path
        For the files that the command writes.

    Raises
    ------
    Refused
        If the page may not ask this.
    """
    makers: dict[Any, Callable[[], Order]] = {
        "simulate": lambda: _example(store),
        "inspect": lambda: _of_recordings(asked, store, "inspect", [], ()),
        "count": lambda: _count(asked, store, model, folder),
        "gap": lambda: _gap(asked, store, folder),
    }
    command = asked.get("command")
    if not isinstance(command, str) or command not in makers:
        raise Refused(400, f"command must be one of {', '.join(makers)}, got {command!r}")
    return makers[command]()


def _example(store: Store) -> Order:
    name = store.claim("example.csv")
    worn = ["--worn-count", "3", "--rig", "r2", "--duration", "9"]
    arguments = [*worn, "--out", name, "--force"]
    return Order("simulate", "Simulation of an example with 3 worn lobes", arguments, (name,))


def _count(asked: Mapping[str, Any], store: Store, model: list[str], folder: Path) -> Order:
    page = "count.html"
    arguments = [*model, "--report", str(folder / page)]
    return _of_recordings(asked, store, "count", arguments, (page,), {"skip": "--skip"})


def _gap(asked: Mapping[str, Any], store: Store, folder: Path) -> Order:
    outputs: tuple[str, ...] = ("gap.html",)
    options = _options(asked)
    simulated, held_out = options.get("simulated"), options.get("hold_out", "")
    # Both can be paths, of which only uploaded ones are read.
    if held_out and not re.fullmatch(r"speed|load|0?[.]\d+", held_out):
        _names([held_out], store)
    if simulated is not None:
        _names([simulated], store)
    else:
        outputs += ("corrected.json",)
    targets = zip(("--out", "--save-simulator"), outputs, strict=False)
    arguments = [word for option, name in targets for word in (option, str(folder / name))]
    more = {"hold_out": "--hold-out", "simulated": "--simulated"}
    return _of_recordings(asked, store, "gap", arguments, outputs, more)


def _of_recordings(
    asked: Mapping[str, Any],
    store: Store,
    command: str,
    arguments: list[str],
    outputs: tuple[str, ...],
    more: Mapping[str, str] | None = None,
) -> Order:
    names = _names(asked.get("recordings"), store)
    spelled = _spelled(_options(asked), _READING | dict(more or {}))
    what = names[0] if len(names) == 1 else number(len(names), "recording")
    return Order(command, f"{_TITLES[command]} of {what}", [*arguments, *spelled, *names], names, outputs)


def _options(asked: Mapping[str, Any]) -> dict[str, str]:
    """Return the options that are not empty."""
    options = asked.get("options") or {}
    if not isinstance(options, dict):
        raise Refused(400, f"options must be names with values, got {options!r}")
    for name, value in options.items():
        if not isinstance(value, str) or len(value) > _LONGEST_VALUE or not value.isprintable():
            raise Refused(400, f"{name} must be a text of up to {_LONGEST_VALUE} printable characters")
    return {name: value.strip() for name, value in options.items() if value.strip()}


def _spelled(options: Mapping[str, str], known: Mapping[str, str]) -> list[str]:
    """Return options as a command takes them; a value never becomes an option of its own."""
    unknown = options.keys() - known.keys() - _SWITCHES.keys()
    if unknown:
        raise Refused(400, f"unknown option {min(unknown)!r}; known are {', '.join([*known, *_SWITCHES])}")
    spelled = [f"{known[name]}={value}" for name, value in options.items() if name in known]
    return spelled + [_SWITCHES[name] for name in options if name in _SWITCHES]


def _names(asked: Any, store: Store) -> tuple[str, ...]:
    """Return the names of stored recordings; those of folders name nothing outside."""
    if not isinstance(asked, list) or not asked:
        raise Refused(400, "choose at least one recording")
    for name in asked:
        if not isinstance(name, str) or name not in store.items:
            raise Refused(404, f"no such recording: {name!r}")
        if store.items[name]:
            _check_manifest(store.recordings / name)
    return tuple(dict.fromkeys(asked))


def _check_manifest(folder: Path) -> None:
    """Refuse a manifest that names files outside its folder, which was uploaded, not read where it lies."""
    with contextlib.suppress(ValueError, OSError):  # of which the command speaks better
        for entry in folder_entries(folder):
            if not entry.path.resolve().is_relative_to(folder.resolve()):
                raise Refused(
                    400, f"{folder.name}/{MANIFEST} names a file outside the folder: {entry.path.name}"
                )
