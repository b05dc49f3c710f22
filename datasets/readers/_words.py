"""Names, units and labels by which files say what they hold."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Collection, Iterable, Mapping
from contextlib import suppress
from typing import Any

from cyclofeat._base import checks
from cyclofeat._base.quantities import QUANTITIES, from_1
from cyclofeat.recordings import Recording

TORQUE_UNITS = {
    "Nm": 1.0, "kNm": 1e3, "mNm": 1e-3, "Ncm": 1e-2, "Nmm": 1e-3,
    "lbf ft": 1.3558179483314, "lbf in": 0.11298482902762, "kgf m": 9.80665,
}  # fmt: skip
CURRENT_UNITS = {"A": 1.0, "mA": 1e-3}
# Of the rated current: kept as they are, since a count does not depend on the scale.
RELATIVE_UNITS = {"%": 1.0, "p.u.": 1.0, "0.1%": 0.1}
UNITS_OF = {"output_torque": TORQUE_UNITS, "input_torque": TORQUE_UNITS, "motor_current": CURRENT_UNITS}

_TORQUE, _CURRENT = "torque|(?:dreh)?moment", "current|strom"
_OUT, _IN = "out(?:put)?|abtriebs?|ausgangs?", "in(?:put)?|motor|drive|antriebs?|eingangs?"
# Names by which a channel is taken for a quantity; a torque that names no side is the output's.
_USUAL = {
    "output_torque": f"(?:{_OUT})? ?(?:{_TORQUE})|(?:{_TORQUE}) (?:{_OUT})",
    "input_torque": f"(?:{_IN}) ?(?:{_TORQUE})|(?:{_TORQUE}) (?:{_IN})",
    "motor_current": f"(?:motor)? ?(?:{_CURRENT})|(?:{_CURRENT}) motor|i ?q|i motor|motor i",
    "rpm": f"(?:{_IN}|shaft)? ?(?:speed|rpm|drehzahl)|(?:speed|drehzahl) (?:{_IN})|n(?: (?:{_IN}))?",
}
# Words that state the quantity in any other name.
_WORDS = {
    "motor_current": rf"{_CURRENT}|\bi ?q\b",
    "input_torque": rf"\b(?:{_IN})\b|motor|antrieb|eingang",
    "output_torque": rf"\b(?:{_OUT})\b|abtrieb|ausgang",
}

TIME_NAMES = {
    "time", "t", "zeit", "timestamp", "timestamps", "time stamp", "zeitstempel", "datetime", "date time",
    "x value", "x axis", "second", "uhrzeit", "elapsed time", "time of day", "datum uhrzeit",
}  # fmt: skip
DISC_ANGLE_NAMES = {"disc_angle", "disc angle", "scheibenwinkel"}
ANGLE_NAMES = DISC_ANGLE_NAMES | {
    "angle", "input_angle", "input angle", "shaft angle", "winkel", "drehwinkel", "antriebswinkel",
    "eingangswinkel",
}  # fmt: skip

COUNT_NAMES = {"position", "position actual value", "actual position", "encoder", "counts"}
PULSE_NAMES = {
    "pulse", "pulses", "tacho", "tachometer", "index", "index pulse", "z pulse", "trigger", "impulse",
    "drehzahlimpulse",
}  # fmt: skip

TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0, "d": 86_400.0}
RATE_UNITS = {"Hz": 1.0, "kHz": 1e3, "MHz": 1e6}
ANGLE_UNITS = {"rad": 1.0, "deg": math.pi / 180, "rev": 2 * math.pi}
UNITS = TORQUE_UNITS | CURRENT_UNITS | RELATIVE_UNITS | TIME_UNITS | ANGLE_UNITS | RATE_UNITS | {"rpm": 1.0}
_OTHER_SPELLINGS = {
    "µs": "us", "μs": "us", "sec": "s", "second": "s", "seconds": "s", "sekunden": "s", "msec": "ms",
    "°": "deg", "degree": "deg", "degrees": "deg", "grad": "deg", "radian": "rad", "radians": "rad",
    "sek": "s", "hertz": "Hz", "hz": "Hz", "khz": "kHz", "mhz": "MHz", "s/s": "Hz", "sa/s": "Hz", "1/s": "Hz",
    "rev.": "rev", "turn": "rev", "turns": "rev", "umdrehungen": "rev", "newtonmeter": "Nm",
    "newtonmeters": "Nm", "ampere": "A", "amp": "A", "amps": "A", "pu": "p.u.", "percent": "%",
    "prozent": "%", **dict.fromkeys(("rpm", "1/min", "min1", "min⁻¹", "min^1", "u/min", "r/min"), "rpm"),
    **dict.fromkeys(("lbfft", "lbft", "ftlb", "ftlbf", "ftlbs"), "lbf ft"),
    **dict.fromkeys(("lbfin", "lbin", "inlb", "inlbf", "inlbs"), "lbf in"), "kgfm": "kgf m",
}  # fmt: skip
# Units that may follow a name after an underscore, as in torque_nm.
# phase_a is the first of three, torque_min the least.
_UNIT_SUFFIXES = {unit.lower(): unit for unit in UNITS if unit not in ("A", "min", "h", "d")}

_RATE = r"fs|f s|f sample|(sampl(e|ing)|scan) ?(rate|freq|frequency)|(abtast|mess)(rate|frequenz)"
_STEP = (
    r"dt|ts|delta ?[xt]|time ?(step|interval)|sampl(e|ing) ?(time|period|interval)|(x ?)?incr(ement)?|xinc|"
    r"abtast(zeit|intervall|periode)|horizontal interval|zeitschritt"
)
FORMAT, FORMAT_KEY = "cyclofeat recording", "cyclofeat_recording"
VERSION = 2  # 1 counted lobes from 0
# Parameters of Recording that a caller may give, and that written files hold.
LABELS = (
    "quantity", "angle_of", "angle_is_absolute", "assembly", "run", "defect_count", "worn_lobes", "n_lobes",
    "speed_rpm", "load_nm", "source", "meta",
)  # fmt: skip
# The label of worn lobes in files, which says how they are counted.
WORN = "worn_lobes_from_1"
FILE_LABELS = tuple(WORN if name == "worn_lobes" else name for name in LABELS)


def name_and_unit(name: str) -> tuple[str, str | None]:
    """Lower-case base name and unit of a channel: ``Torque [Nm]`` gives ("torque", "Nm")."""
    match = re.fullmatch(
        r"(.+?)\s*(?:\[([^]]*)\]|\(([^)]*)\)|/\s*(\S+)|\bin\s+([^\s[(]\S*))\s*", name.strip()
    )
    if match:
        unit = next(group for group in match.groups()[1:] if group is not None)
        return match[1].strip().lower(), clean_unit(unit)
    base, _, suffix = name.strip().lower().rpartition("_")
    if base and suffix in _UNIT_SUFFIXES:
        return base, _UNIT_SUFFIXES[suffix]
    return name.strip().lower(), None


def clean_unit(unit: str | None) -> str | None:
    """A unit in the spelling used here, e.g. "Nm" for "N·m"; unknown ones stay as they are."""
    if unit is None:
        return None
    bare = re.sub(r"[\s·⋅*\-]|(?<!\d)\.", "", unit.strip().strip("[]()"))
    return _OTHER_SPELLINGS.get(bare.lower(), bare) or None


def whole_rate(rate: float, share: float = 1e-9) -> float:
    """Return a rate in Hz, as a whole number if one lies within this share of it."""
    return float(round(rate)) if abs(rate - round(rate)) <= rate * share and round(rate) > 0 else rate


def named_rate(name: str, value: float, unit: str | None = None) -> float | None:
    """Return the sampling rate in Hz that a number states by its name, such as ``fs`` or ``dt [ms]``."""
    base, own = name_and_unit(name)
    unit, base = unit or own, with_spaces(base)
    if not 0 < value < math.inf:
        return None
    if re.fullmatch(_RATE, base) and (unit is None or unit in RATE_UNITS):
        return value * RATE_UNITS.get(unit or "Hz", 1.0)
    if re.fullmatch(_STEP, base) and (unit is None or unit in TIME_UNITS):
        return whole_rate(1 / (value * TIME_UNITS[unit or "s"]))
    return None


def list_rates(numbers: Iterable[tuple[str, float, str | None, str]]) -> list[tuple[float, str]]:
    """Return the rates that numbers state by name, value and unit, each with where the file states it."""
    rates = ((named_rate(name, value, unit), where) for name, value, unit, where in numbers)
    return [(rate, where) for rate, where in rates if rate is not None]


def is_usual(name: str, quantity: str) -> bool:
    """Return True for a usual name of a quantity, in lower case and without its unit."""
    return re.fullmatch(_USUAL[quantity], with_spaces(name)) is not None


def is_time_name(name: str) -> bool:
    """Return True for a usual name of times, such as "time", or "time 1 default sample rate" of catman."""
    name = with_spaces(name)
    return name in TIME_NAMES or re.match(r"(time|zeit) \d+ ", name) is not None


def named_quantity(name: str) -> str | None:
    """Return the quantity that words in a channel's name state, or None."""
    name = with_spaces(name)
    return next((quantity for quantity, words in _WORDS.items() if re.search(words, name)), None)


def states_quantity(name: str, unit: str | None) -> bool:
    """Return True for a usual name or a unit of a torque or a current."""
    return unit in TORQUE_UNITS | CURRENT_UNITS or any(is_usual(name, quantity) for quantity in UNITS_OF)


def with_spaces(name: str) -> str:
    """Return a name with one space in place of each underscore, point, dash or run of spaces."""
    return re.sub(r"[\s_.\-]+", " ", name).strip()


def labels_of_file(stated: Mapping[str, Any], version: Any = None) -> dict[str, Any]:
    """Return the labels that a file states, with lobes counted from 0.

    ``version`` is that of the format, None in files that other programs wrote. ``ValueError`` if version or
    quantity are unknown, or the file's worn lobes are not counted from 1.
    """
    if version not in (None, 1, VERSION):
        raise ValueError(f"it is of format {version!r}, but 1 and {VERSION} can be read; update cyclofeat")
    labels = dict(stated)
    if "quantity" in labels:
        checks.one_of("quantity", labels["quantity"], QUANTITIES)
    if version == 1:
        return labels
    check_no_bare_lobes(labels)
    if WORN in labels:
        lobes = labels.pop(WORN)
        whole = isinstance(lobes, (list, tuple)) and all(map(checks.is_whole, lobes))
        if not whole or min(lobes, default=1) < 1:
            got = checks.repr_of(lobes)
            raise ValueError(f"{WORN} must be lobes counted from 1, like [1, 5], got {got}")
        labels["worn_lobes"] = tuple(lobe - 1 for lobe in lobes)
    return labels


def check_no_bare_lobes(names: Collection[str]) -> None:
    """Raise ``ValueError`` for a name that does not say from where the lobes are counted."""
    if "worn_lobes" in names:
        raise ValueError(
            f"worn_lobes does not say whether lobes count from 0 or from 1: name it {WORN} and count from 1"
        )


def samples_name(recording: Recording) -> str:
    """Return the name of the samples in files: ``torque`` is the output's."""
    return "torque" if recording.quantity == "output_torque" else recording.quantity


def labels_to_write(recording: Recording) -> dict[str, Any]:
    """Labels of a recording, as JSON can hold them, without those that files need not state."""
    usual = {"n_lobes": 15, "quantity": "output_torque", "meta": {}}
    values = {key: getattr(recording, key) for key in LABELS}
    labels = {"sampling_rate": recording.sampling_rate} | {
        key: value
        for key, value in values.items()
        if value not in (None, usual.get(key))
        and (recording.angle is not None or not key.startswith("angle"))
    }
    if "worn_lobes" in labels:
        labels[WORN] = from_1(labels.pop("worn_lobes"))
    meta = labels.get("meta", {})
    with suppress(TypeError, ValueError):
        if json.loads(json.dumps(meta, allow_nan=False)) == meta:
            return labels
    raise TypeError(
        "meta must hold only text, finite numbers, booleans, None, lists and dictionaries with text "
        f"keys, to be written to a file; got {meta!r}"
    )
