"""Channels of files, their names, units and numbers, and the labels of a recording as files hold them."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from cyclofeat._base import checks
from cyclofeat._base.quantities import QUANTITIES, from_1, in_words
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
Channel = str | int

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


@dataclass(frozen=True)
class ReadingOptions:
    """Options of :func:`~cyclofeat.datasets.read_recording`, checked; it documents them."""

    channel: Channel | None = None
    quantity: str | None = None
    sampling_rate: float | None = None
    time_channel: Channel | Literal[False] | None = None
    time_unit: str | None = None
    angle_channel: Channel | Literal[False] | None = None
    angle_unit: str | None = None
    pulses_per_turn: int | None = None
    scale: float | None = None
    counts_per_turn: int | None = None
    delimiter: str | None = None
    decimal: str | None = None
    table_line: int | None = None

    def __post_init__(self) -> None:
        if self.sampling_rate is not None:
            check_rate(self.sampling_rate)
        if self.quantity is not None:
            checks.one_of("quantity", self.quantity, QUANTITIES)
        idle = "angle_channel=False" if self.angle_channel is False else "angle_unit=" * bool(self.angle_unit)
        for name in ("table_line", "pulses_per_turn", "counts_per_turn"):
            if getattr(self, name) is not None:
                checks.whole(name, getattr(self, name), 1)
                if idle and name != "table_line":
                    raise ValueError(f"{name}= has no effect with {idle}")
        scale_fits = self.scale is None or (checks.is_number(self.scale) and 0 < abs(self.scale) < math.inf)
        for argument, fits, expected in (
            ("scale", scale_fits, "a finite number other than 0 (Nm per unit)"),
            ("time_unit", self.time_unit in (None, *TIME_UNITS), f"one of {', '.join(TIME_UNITS)}"),
            ("angle_unit", self.angle_unit in (None, *ANGLE_UNITS), "'rad', 'deg' or 'rev'"),
            ("decimal", self.decimal in (None, ",", "."), "',' or '.'"),
            ("delimiter", self.delimiter in (None, ",", ";", "\t", " "), "',', ';', a tab or a space"),
        ):
            if not fits:
                raise ValueError(f"{argument} must be {expected}, got {getattr(self, argument)!r}")

    @property
    def of_table(self) -> dict[str, Any]:
        """What is stated of the table of a text."""
        stated = {name: getattr(self, name) for name in ("delimiter", "decimal", "table_line")}
        return {name: value for name, value in stated.items() if value is not None}

    @property
    def without_times(self) -> bool:
        """True where the file's times are left out."""
        return self.time_channel is False or self.time_channel == "none"


class Source:
    """Channels of one file, converted to numbers on demand.

    Parameters
    ----------
    path : pathlib.Path
    names : list of str
    units : list of (str or None), optional
        As the file states them beside the name; where None, the name may state one.
    plain : list of str, optional
        Names without a qualifier (a TDMS channel without its group).
    """

    noun, a_noun, plural = "channel", "a channel", "channels"
    by_index = True  # channels have an order that people can count
    named = True
    labels: dict[str, Any] | None = None  # all labels, of a file that write_recording wrote
    angle_unit: str | None = None  # of an angle that states none

    def __init__(
        self,
        path: Path,
        names: list[str],
        units: list[str | None] | None = None,
        plain: list[str] | None = None,
    ) -> None:
        self.path, self.file, self.names = path, path.name, names
        self.plain = names if plain is None else plain
        split = [name_and_unit(name) for name in self.plain]
        self.bases = [base for base, _ in split]
        stated = [None] * len(names) if units is None else [clean_unit(unit) for unit in units]
        self.units = [unit or named for unit, (_, named) in zip(stated, split, strict=True)]
        self.other_labels: dict[str, Any] = {}

    # What each kind of file defines.

    def raw_values(self, index: int) -> NDArray[Any]:
        """Values of one channel as the file holds them, shape (n,): numbers, or dates."""
        raise NotImplementedError

    def is_usable(self, index: int) -> bool:
        """Return True if a channel may hold a record; used if no name identifies the torque."""
        return True

    def stated_rates(self, torque: int) -> list[tuple[float, str]]:
        """Sampling rates in Hz that the file states for a channel, and where it does."""
        return []

    def length(self, index: int) -> int | None:
        """Number of values of a channel; None in files whose channels are all of one length."""
        return None

    def group_of(self, index: int) -> str:
        """Name of the group, struct or sheet of a channel."""
        return self.names[index][: self.names[index].rfind(self.plain[index])]

    def channel_meta(self, torque: int) -> dict[str, Any]:
        """Return other statements of the file about a channel."""
        return {}

    def check_torque(self, torque: int, scale: float | None) -> None:
        """Raise ``ValueError`` where the torque's channel holds raw counts and no scale is given."""

    def sample_place(self, sample: int) -> str:
        """Return the place of a sample in the file, for messages."""
        return f"sample {sample}"

    def column_values(self, index: int) -> Float:
        """Numbers of one channel, checked: real, finite, at least two."""
        values = self.raw_values(index)
        called = f"{self.file}: {self.noun} {self.names[index]!r}"
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
            raise ValueError(f"{called} must be finite, got {numbers[where]} at {self.sample_place(where)}")
        return numbers

    def time_values(self, index: int) -> NDArray[Any]:
        """Numbers or dates of a column of times."""
        values = self.raw_values(index)
        return values if values.dtype.kind in "mM" else self.column_values(index)

    def channel_names(self) -> str:
        """Return the names of all channels, for messages."""
        text = ", ".join(map(repr if self.named else str, self.names[:40])) or "none"
        text += f" and {len(self.names) - 40} more" if len(self.names) > 40 else ""
        return text + ("" if self.named else " (no names in the file)")

    def find_channel(self, argument: str, wanted: Any, usual: set[str]) -> int | None:
        """Index of the wanted channel, else of the one with a usual name, else None."""
        if wanted is None:
            return self._only_match(argument, [i for i, base in enumerate(self.bases) if base in usual])
        if not isinstance(wanted, str) and not (self.by_index and checks.is_whole(wanted)):
            index = " or index from 0" if self.by_index else ""
            raise TypeError(
                f"{argument} must be {self.a_noun}'s name{index}, got {wanted!r}; {self.plural} are "
                f"{self.channel_names()}"
            )
        matches: list[int] = []
        if isinstance(wanted, str):
            named = ((self.names, wanted), (self.plain, wanted), (self.bases, wanted.strip().lower()))
            for names, name in named:
                matches = matches or [i for i, candidate in enumerate(names) if candidate == name]
        if not matches and self.by_index and str(wanted).isdecimal() and int(wanted) < len(self.names):
            matches = [int(wanted)]
        if not matches:
            raise ValueError(
                f"{self.file}: {argument} = {wanted!r} does not exist; {self.plural} are "
                f"{self.channel_names()}"
            )
        if len(matches) > 1:
            listed = ", ".join(repr(self.names[i]) for i in matches)
            which = f"{matches}; give one index" if self.by_index else listed
            raise ValueError(f"{self.file}: {argument} = {wanted!r} fits several {self.plural}: {which}")
        return matches[0]

    def find_torque(
        self, wanted: Channel | None, others: set[int | None], quantity: str | None = None
    ) -> int:
        """Index of the channel that holds the quantity, by default the output torque.

        Its name decides, then its unit, then that it is the only one. A channel that names another quantity
        is taken only if both the channel and the quantity were stated.
        """
        if not self.names:
            raise ValueError(f"{self.file} holds no {self.noun}")
        sought = quantity or "output_torque"
        if wanted is not None:
            index = self.find_channel("channel", wanted, set())
            assert index is not None
            return index if quantity else self._check_quantity(index, sought)
        free = [i for i in range(len(self.names)) if i not in others]
        suitable = [i for i in free if named_quantity(self.bases[i]) in (None, sought)]
        index = self._only_match("channel", [i for i in free if is_usual(self.bases[i], sought)])
        if index is None:
            by_unit = [i for i in suitable if self.units[i] in UNITS_OF[sought] and self.is_usable(i)]
            index = self._only_match("channel", by_unit)
        if index is not None:
            return index
        usable = [i for i in free if self.is_usable(i)]
        known_units = TORQUE_UNITS | CURRENT_UNITS
        named = [i for i in usable if any(is_usual(self.bases[i], quantity) for quantity in UNITS_OF)]
        for only in (usable, [i for i in usable if i in named or self.units[i] in known_units]):
            if len(only) == 1:
                return self._check_quantity(only[0], sought)
        raise ValueError(
            f"{self.file}: channel= must be given, to say which {self.noun} is the "
            f"{in_words(quantity) if quantity else 'torque'}: {self.channel_names()}"
        )

    def _only_match(self, argument: str, matches: list[int]) -> int | None:
        """Return the only match, or None without one; raise ``ValueError`` for several."""
        if len(matches) > 1:
            names = ", ".join(repr(self.names[i]) for i in matches)
            raise ValueError(
                f"{self.file}: {argument}= must be given, since several {self.plural} fit: {names}"
            )
        return matches[0] if matches else None

    def _check_quantity(self, index: int, sought: str) -> int:
        """Return the channel; raise ``ValueError`` if its name or unit is of another quantity."""
        stated = named_quantity(self.bases[index])
        if stated is None and self.units[index] in CURRENT_UNITS:
            stated = "motor_current"
        if stated in (None, sought):
            return index
        raise ValueError(
            f"{self.file}: {self.noun} {self.names[index]!r} holds {in_words(stated)} by its name or unit, "
            f"not {in_words(sought)}: give quantity={stated!r}, or channel= and quantity={sought!r} if the "
            "name is wrong"
        )

    def unit_factor(self, index: int, scale: float | None, quantity: str) -> tuple[float, str | None]:
        """Nm or A per unit of a channel, and which of them; None where Nm, or A of a current, is assumed.

        A share of the rated current stays as it is. A scale of a current in A or mA is its torque constant,
        after which the samples are in Nm.
        """
        unit, usual = self.units[index], next(iter(UNITS_OF[quantity]))
        known = UNITS_OF[quantity] | (RELATIVE_UNITS | TORQUE_UNITS if quantity == "motor_current" else {})
        if scale is not None:
            return float(scale), "Nm" if unit in CURRENT_UNITS else usual
        if unit is None:
            return 1.0, None
        if unit not in known:
            raise ValueError(
                f"{self.file}: channel {self.names[index]!r} is in {unit!r}, known are {', '.join(known)}; "
                f"give scale= ({usual} per unit)" + ", or quantity='motor_current'" * (unit in CURRENT_UNITS)
            )
        if unit in RELATIVE_UNITS:
            return known[unit], unit.removeprefix("0.1")
        return known[unit], "Nm" if unit in TORQUE_UNITS else "A"

    def angle_factor(self, index: int, angle_unit: str | None) -> tuple[float, bool]:
        """Radians per unit of the angle's channel, and whether that is assumed."""
        stated, name = self.units[index], self.names[index]
        if stated in ANGLE_UNITS and angle_unit is not None and stated != angle_unit:
            raise ValueError(
                f"{self.file}: angle_unit = {angle_unit!r} contradicts the {self.noun} {name!r}, which is in "
                f"{stated}"
            )
        unit = angle_unit or stated or self.angle_unit
        if unit not in ANGLE_UNITS:
            raise ValueError(
                f"{self.file}: {self.noun} {name!r} does not state its unit (rad, deg or rev); {ANGLE_REMEDY}"
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


def largest_unpacked(path: Path) -> int:
    """Return the bytes that a compressed file of this size may unpack to: 2 GB, or 30 times its size."""
    return max(LARGEST_UNPACKED, _USUAL_RATIO * path.stat().st_size)


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


def check_no_bare_lobes(file: str, names: Iterable[str]) -> None:
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
