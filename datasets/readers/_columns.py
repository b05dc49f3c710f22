"""Channels of files, their names, units and numbers, and the labels of a recording as files hold them."""

from __future__ import annotations

import json
import math
import re
import reprlib
import warnings
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from cyclofeat._base import checks
from cyclofeat._base.quantities import QUANTITIES, from_1, in_words, some_of
from cyclofeat.recordings import Recording

TORQUE_UNITS = {"Nm": 1.0, "kNm": 1e3, "mNm": 1e-3, "Ncm": 1e-2, "Nmm": 1e-3}
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
}
# Words that state the quantity in any other name.
_WORDS = {
    "motor_current": rf"{_CURRENT}|\bi ?q\b",
    "input_torque": rf"\b(?:{_IN})\b|motor|antrieb|eingang",
    "output_torque": rf"\b(?:{_OUT})\b|abtrieb|ausgang",
}

Float = NDArray[np.float64]

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
UNITS = TORQUE_UNITS | CURRENT_UNITS | RELATIVE_UNITS | TIME_UNITS | ANGLE_UNITS | RATE_UNITS
_OTHER_SPELLINGS = {
    "µs": "us", "μs": "us", "sec": "s", "second": "s", "seconds": "s", "sekunden": "s", "msec": "ms",
    "°": "deg", "degree": "deg", "degrees": "deg", "grad": "deg", "radian": "rad", "radians": "rad",
    "sek": "s", "hertz": "Hz", "hz": "Hz", "khz": "kHz", "mhz": "MHz", "s/s": "Hz", "sa/s": "Hz", "1/s": "Hz",
    "rev.": "rev", "turn": "rev", "turns": "rev", "umdrehungen": "rev", "newtonmeter": "Nm",
    "newtonmeters": "Nm", "ampere": "A", "amp": "A", "amps": "A", "pu": "p.u.", "percent": "%",
    "prozent": "%",
}  # fmt: skip
# Units that may follow a name after an underscore, as in torque_nm.
# phase_a is the first of three, torque_min the least.
_UNIT_SUFFIXES = {unit.lower(): unit for unit in UNITS if unit not in ("A", "min", "h", "d")}

# What to do about an angle of unknown unit.
ANGLE_REMEDY = "give angle_unit='rad', 'deg' or 'rev', or angle_channel=False to leave it out"

# Deflate, the strongest compression of these files, packs at most 1032:1. A small file that claims more is
# damaged, or made to fill the memory.
_LARGEST_RATIO, _ALWAYS_ALLOWED = 1100, 2**26
# Names that a message lists, and what it quotes of each.
_MOST_NAMES, _SHORT_NAMES = 40, reprlib.Repr()
_SHORT_NAMES.maxstring = 100
# Records pack at most so tightly; what unpacks to more is refused above a size that memories hold.
_USUAL_RATIO, LARGEST_UNPACKED = 30, 2 * 10**9

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
_CHOICES: dict[str, Collection[str]] = {
    "quantity": QUANTITIES, "time_unit": TIME_UNITS, "angle_unit": ANGLE_UNITS, "decimal": (",", "."),
    "delimiter": (",", ";", "\t", " "), "gaps": ("refuse", "cut"),
}  # fmt: skip


@dataclass(frozen=True)
class ReadingOptions:
    """Options of :func:`~cyclofeat.datasets.read_recording`, checked; it documents them."""

    channel: str | int | None = None
    quantity: str | None = None
    sampling_rate: float | None = None
    time_channel: str | int | Literal[False] | None = None
    time_unit: str | None = None
    angle_channel: str | int | Literal[False] | None = None
    angle_unit: str | None = None
    pulses_per_turn: int | None = None
    scale: float | None = None
    counts_per_turn: int | None = None
    delimiter: str | None = None
    decimal: str | None = None
    table_line: int | None = None
    gaps: str = "refuse"

    def __post_init__(self) -> None:
        if self.sampling_rate is not None:
            check_rate(self.sampling_rate)
        if self.scale is not None and not (checks.is_number(self.scale) and 0 < abs(self.scale) < math.inf):
            raise ValueError(f"scale must be a finite number other than 0 (Nm per unit), got {self.scale!r}")
        idle = "angle_channel=False" if self.angle_channel is False else "angle_unit=" * bool(self.angle_unit)
        for name in ("table_line", "pulses_per_turn", "counts_per_turn"):
            if getattr(self, name) is not None:
                checks.whole(name, getattr(self, name), 1)
                if idle and name != "table_line":
                    raise ValueError(f"{name}= has no effect with {idle}")
        for name, known in _CHOICES.items():
            if (value := getattr(self, name)) is not None:
                checks.one_of(name, value, known)

    @property
    def without_times(self) -> bool:
        """True where the file's times are left out."""
        return self.time_channel is False or self.time_channel == "none"


@dataclass(eq=False)
class Channel:
    """One channel of a file; ``read`` returns its numbers or dates as the file holds them, shape (n,).

    ``name`` is what users type, ``plain`` the name without its ``group`` (struct, sheet), of which a time
    channel may be. ``length`` is None where all channels have one, ``usable`` False for what holds no record,
    ``rates`` what the file states in Hz, and where. ``raw`` says of counts without a scale what they are,
    and ``segments`` returns the first sample and rate of each where several rates are stated.
    """

    name: str
    read: Callable[[], NDArray[Any]]
    unit: str | None = None
    plain: str = ""
    group: str | None = None
    length: int | None = None
    usable: bool = True
    rates: Sequence[tuple[float, str]] = ()
    meta: dict[str, Any] = field(default_factory=dict)
    raw: str = ""
    segments: Callable[[], list[tuple[int, float]]] | None = None
    place: Callable[[int], str] = "sample {}".format

    def __post_init__(self) -> None:
        self.plain = self.plain or self.name
        self.base, named = name_and_unit(self.plain)
        self.unit = clean_unit(self.unit) or named
        if self.group is None:
            self.group = self.name[: self.name.rfind(self.plain)]


@dataclass
class Source:
    """Channels of a file, and its labels: in ``labels`` if :func:`write_recording` wrote it."""

    file: str
    channels: list[Channel]
    noun: str = "channel"
    by_index: bool = True  # channels have an order that people can count
    named: bool = True
    labels: dict[str, Any] | None = None
    other_labels: dict[str, Any] = field(default_factory=dict)
    angle_unit: str | None = None  # of an angle that states none

    @property
    def names(self) -> list[str]:
        return [channel.name for channel in self.channels]

    def call(self, channel: Channel) -> str:
        """Return what messages call a channel."""
        return f"{self.file}: {self.noun} {channel.name!r}"

    def column_values(self, channel: Channel, read: NDArray[Any] | None = None) -> Float:
        """Return a channel's numbers; raise ``ValueError`` unless real, finite and at least two."""
        called, values = self.call(channel), channel.read() if read is None else read
        if values.dtype.kind not in "iuf" or values.ndim != 1:
            raise ValueError(
                f"{called} must be 1-D and hold real numbers, got shape {values.shape} of dtype "
                f"{values.dtype}"
            )
        if values.size < 2:
            raise ValueError(f"{called} must hold at least 2 samples, got {values.size}")
        numbers = np.asarray(values, dtype=np.float64)
        if not np.all(np.isfinite(numbers)):
            where = int(np.argmax(~np.isfinite(numbers)))
            raise ValueError(f"{called} must be finite, got {numbers[where]} at {channel.place(where)}")
        return numbers

    def list_names(self, channels: Sequence[Channel] | None = None) -> str:
        """Return the names of channels, by default of all, for messages."""
        names = [channel.name for channel in self.channels if channels is None or channel in channels]
        text = some_of(names, _MOST_NAMES, _SHORT_NAMES.repr if self.named else str) or "none"
        return text + ("" if self.named else " (no names in the file)")

    def find_channel(self, argument: str, wanted: Any, usual: Collection[str] = ()) -> Channel | None:
        """Return the wanted channel, else the one with a usual name, else None."""
        if wanted is None:
            return self._only_match(argument, [channel for channel in self.channels if channel.base in usual])
        exist = f"{self.noun}s are {self.list_names()}"
        if not isinstance(wanted, str) and not (self.by_index and checks.is_whole(wanted)):
            index = " or index from 0" if self.by_index else ""
            raise TypeError(f"{argument} must be the {self.noun}'s name{index}, got {wanted!r}; {exist}")
        matches: list[Channel] = []
        for name in ("name", "plain", "base"):
            asked = str(wanted).strip().lower() if name == "base" else wanted
            matches = matches or [channel for channel in self.channels if getattr(channel, name) == asked]
        if not matches and self.by_index and str(wanted).isdecimal() and int(wanted) < len(self.channels):
            matches = [self.channels[int(wanted)]]
        if len(matches) == 1:
            return matches[0]
        if not matches:
            raise ValueError(f"{self.file}: {argument} = {wanted!r} does not exist; {exist}")
        which = self.list_names(matches)
        if self.by_index:
            which = f"{[self.channels.index(channel) for channel in matches]}; give one index"
        raise ValueError(f"{self.file}: {argument} = {wanted!r} fits several {self.noun}s: {which}")

    def find_torque(
        self, wanted: str | int | None, others: set[Channel | None], quantity: str | None
    ) -> Channel:
        """Return the channel that holds the quantity, by default the output torque.

        Its name decides, then its unit, then that it is the only one. A channel that names another quantity
        is taken only if both the channel and the quantity were stated.
        """
        if not self.channels:
            raise ValueError(f"{self.file} holds no {self.noun}")
        sought = quantity or "output_torque"
        if wanted is not None:
            channel = self.find_channel("channel", wanted)
            assert channel is not None
            return channel if quantity else self._check_quantity(channel, sought)
        free = [channel for channel in self.channels if channel not in others]
        usable = [channel for channel in free if channel.usable]
        suitable = [channel for channel in usable if named_quantity(channel.base) in (None, sought)]
        for fitting in (
            [channel for channel in free if is_usual(channel.base, sought)],
            [channel for channel in suitable if channel.unit in UNITS_OF[sought]],
        ):
            if match := self._only_match("channel", fitting):
                return match
        known = [
            channel for channel in usable
            if channel.unit in TORQUE_UNITS | CURRENT_UNITS
            or any(is_usual(channel.base, quantity) for quantity in UNITS_OF)
        ]  # fmt: skip
        for only in (usable, known):
            if len(only) == 1:
                return self._check_quantity(only[0], sought)
        raise ValueError(
            f"{self.file}: channel= must be given, to say which {self.noun} is the "
            f"{in_words(quantity) if quantity else 'torque'}: {self.list_names()}"
        )

    def _only_match(self, argument: str, matches: list[Channel]) -> Channel | None:
        """Return the only match, or None without one; raise ``ValueError`` for several."""
        if len(matches) > 1:
            raise ValueError(
                f"{self.file}: {argument}= must be given, since several {self.noun}s fit: "
                f"{self.list_names(matches)}"
            )
        return matches[0] if matches else None

    def _check_quantity(self, channel: Channel, sought: str) -> Channel:
        """Return the channel; raise ``ValueError`` if its name or unit is of another quantity."""
        stated = named_quantity(channel.base)
        if stated is None and channel.unit in CURRENT_UNITS:
            stated = "motor_current"
        if stated in (None, sought):
            return channel
        raise ValueError(
            f"{self.call(channel)} holds {in_words(stated)} by its name or unit, not {in_words(sought)}: "
            f"give quantity={stated!r}, or channel= and quantity={sought!r}"
            + " and scale=" * (channel.unit in CURRENT_UNITS)
            + " if the name is wrong"
        )

    def unit_factor(self, channel: Channel, scale: float | None, quantity: str) -> tuple[float, str | None]:
        """Nm or A per unit of a channel, and which of them; None where Nm, or A of a current, is assumed.

        A share of the rated current stays as it is. A scale of a current in A or mA is its torque constant,
        after which the samples are in Nm.
        """
        unit, usual = channel.unit, next(iter(UNITS_OF[quantity]))
        known = UNITS_OF[quantity] | (RELATIVE_UNITS | TORQUE_UNITS if quantity == "motor_current" else {})
        if scale is not None:
            return float(scale), "Nm" if unit in CURRENT_UNITS else usual
        if channel.raw:
            raise ValueError(f"{self.call(channel)} holds {channel.raw}")
        if unit is None:
            return 1.0, None
        if unit not in known:
            raise ValueError(
                f"{self.call(channel)} is in {unit!r}, known are {', '.join(known)}; "
                f"give scale= ({usual} per unit)"
                + ", or quantity='motor_current'"
                * (unit in CURRENT_UNITS | RELATIVE_UNITS)
            )
        if unit in RELATIVE_UNITS:
            return known[unit], unit.removeprefix("0.1")
        return known[unit], "Nm" if unit in TORQUE_UNITS else "A"

    def angle_factor(self, channel: Channel, angle_unit: str | None) -> tuple[float, bool]:
        """Radians per unit of the angle's channel, and whether that is assumed."""
        stated = channel.unit
        if stated in ANGLE_UNITS and angle_unit is not None and stated != angle_unit:
            raise ValueError(
                f"{self.file}: angle_unit = {angle_unit!r} contradicts the {self.noun} {channel.name!r}, "
                f"which is in {stated}"
            )
        unit = angle_unit or stated or self.angle_unit
        if unit not in ANGLE_UNITS:
            raise ValueError(
                f"{self.call(channel)} does not state its unit (rad, deg or rev); {ANGLE_REMEDY}"
            )
        return ANGLE_UNITS[unit], angle_unit is None and stated is None


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


def check_rate(value: Any, place: str = "sampling_rate") -> None:
    """Raise ``ValueError`` for what is no sampling rate: of the argument, or as ``place`` states it."""
    if not (checks.is_number(value) and 0 < value < math.inf):
        raise ValueError(f"{place} must be a positive, finite number (Hz), got {value!r}")


def check_claim(path: Path, n_bytes: int) -> None:
    """Raise ``ValueError`` where a file claims more data than one of its size can hold."""
    if n_bytes > max(_LARGEST_RATIO * path.stat().st_size, _ALWAYS_ALLOWED):
        raise ValueError(
            f"{path.name} is damaged: it claims {n_bytes / 1e9:.3g} GB of data in {path.stat().st_size} bytes"
        )


def check_unpacked(path: Path, n_bytes: int, of_it: str = "") -> None:
    """Raise ``ValueError`` where a compressed file unpacks to over 2 GB and over 30 times its size."""
    limit = max(LARGEST_UNPACKED, _USUAL_RATIO * path.stat().st_size)
    if n_bytes > limit:
        raise ValueError(
            f"{path.name} takes {n_bytes / 1e9:.3g} GB when unpacked{of_it}; at most {limit / 1e9:.3g} GB "
            f"are unpacked from {path.stat().st_size / 1e6:.3g} MB: split it, or save it unpacked"
        )


@contextmanager
def explain_damage(path: Path, kind: str) -> Iterator[None]:
    """Raise ``ValueError`` that calls the file damaged for whatever a library raises while it reads."""
    try:
        yield
    except (MemoryError, PermissionError, ImportError):
        raise
    except Exception as error:  # libraries let all kinds of exceptions through where a file is damaged
        if isinstance(error, ValueError) and path.name in str(error):
            raise
        text = " ".join(str(error).split())
        text = text if len(text) <= 200 else f"{text[:200]}..."  # some quote what they found, at any length
        raise ValueError(
            f"{path.name} is damaged, it cannot be read as {kind} ({type(error).__name__}: {text})"
        ) from None


def whole_rate(rate: float, share: float = 1e-9) -> float:
    """Return a rate in Hz, as a whole number if one lies within this share of it."""
    return float(round(rate)) if abs(rate - round(rate)) <= rate * share and round(rate) > 0 else rate


def import_library(module: str, suffix: str, library: str) -> Any:
    """Return the module that reads files of a kind; the error names the library that has it."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # of libraries that these import
            return import_module(module)
    except ImportError:
        raise ImportError(f"reading {suffix} files needs {library}: pip install {library}") from None


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


def with_spaces(name: str) -> str:
    """Return a name with one space in place of each underscore, point, dash or run of spaces."""
    return re.sub(r"[\s_.\-]+", " ", name).strip()


def labels_of_file(file: str, stated: Mapping[str, Any], version: Any = None) -> dict[str, Any]:
    """Return the labels that a file states, with lobes counted from 0.

    ``version`` is that of the format, None in files that other programs wrote. ``ValueError`` if version or
    quantity are unknown, or the file's worn lobes are not counted from 1.
    """
    if version not in (None, 1, VERSION):
        raise ValueError(
            f"{file} is of format {version!r}, but 1 and {VERSION} can be read; update cyclofeat"
        )
    labels = dict(stated)
    if "quantity" in labels:
        checks.one_of(f"{file}: quantity", labels["quantity"], QUANTITIES)
    if version == 1:
        return labels
    check_no_bare_lobes(file, labels)
    if WORN in labels:
        lobes = labels.pop(WORN)
        whole = isinstance(lobes, (list, tuple)) and all(map(checks.is_whole, lobes))
        if not whole or min(lobes, default=1) < 1:
            raise ValueError(
                f"{file}: {WORN} must be lobes counted from 1, like [1, 5], got {checks.repr_of(lobes)}"
            )
        labels["worn_lobes"] = tuple(lobe - 1 for lobe in lobes)
    return labels


def check_no_bare_lobes(file: str, names: Collection[str]) -> None:
    """Raise ``ValueError`` for a name that does not say from where the lobes are counted."""
    if "worn_lobes" in names:
        raise ValueError(
            f"{file}: worn_lobes does not say whether lobes count from 0 or from 1: name it {WORN} and "
            "count from 1"
        )


def samples_name(recording: Recording) -> str:
    """Return the name of the samples in files: ``torque`` is the output's."""
    return "torque" if recording.quantity == "output_torque" else recording.quantity


def labels_to_write(recording: Recording) -> dict[str, Any]:
    """Labels of a recording, as JSON can hold them."""
    labels: dict[str, Any] = {"sampling_rate": recording.sampling_rate}
    for key in LABELS:
        value = getattr(recording, key)
        skipped = (
            (key == "meta" and not value)
            or (recording.angle is None and key.startswith("angle"))
            or (key, value) in (("n_lobes", 15), ("quantity", "output_torque"))  # the defaults of files
        )
        if value is not None and not skipped:
            labels[key] = value
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
