"""What all files of channels have in common: names, units, numbers, and the errors about them."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]
Channel = str | int

TORQUE_NAMES = {
    "torque", "torque_out", "output_torque", "output torque", "drehmoment", "abtriebsmoment",
    "abtriebsdrehmoment", "ausgangsdrehmoment", "moment",
}  # fmt: skip
TIME_NAMES = {"time", "t", "zeit", "timestamp", "time stamp", "time_stamp", "zeitstempel", "datetime"}
DISC_ANGLE_NAMES = {"disc_angle", "disc angle", "scheibenwinkel"}
ANGLE_NAMES = DISC_ANGLE_NAMES | {
    "angle", "input_angle", "input angle", "shaft angle", "winkel", "drehwinkel", "antriebswinkel",
    "eingangswinkel",
}  # fmt: skip

TORQUE_UNITS = {"Nm": 1.0, "kNm": 1e3, "mNm": 1e-3, "Ncm": 1e-2, "Nmm": 1e-3}
TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
ANGLE_UNITS = {"rad": 1.0, "deg": math.pi / 180, "rev": 2 * math.pi}
UNITS = TORQUE_UNITS | TIME_UNITS | ANGLE_UNITS
_OTHER_SPELLINGS = {
    "µs": "us", "μs": "us", "sec": "s", "second": "s", "seconds": "s", "sekunden": "s", "msec": "ms",
    "°": "deg", "degree": "deg", "degrees": "deg", "grad": "deg", "radian": "rad", "radians": "rad",
    "rev.": "rev", "turn": "rev", "turns": "rev", "umdrehungen": "rev", "newtonmeter": "Nm",
}  # fmt: skip
# Units that may follow a name after an underscore, as in torque_nm.
_UNIT_SUFFIXES = {unit.lower(): unit for unit in UNITS}

# Deflate, the strongest of the compressions that these files use, packs no more than 1032:1. What claims more
# than that of a small file is damaged, or made to fill the memory.
_LARGEST_RATIO, _ALWAYS_ALLOWED = 1100, 2**26


class Source:
    """The channels of one file, converted to numbers when they are asked for.

    Parameters
    ----------
    path : pathlib.Path
    names : list of str
        As people see them.
    units : list of (str or None), optional
        As the file states them beside the name; where None, the name may state one.
    plain : list of str, optional
        Names without what only tells them apart (a TDMS channel without its group).
    """

    noun, plural = "channel", "channels"
    by_index = True  # whether channels have an order that people can count
    named = True
    labels: dict[str, Any] | None = None  # all labels, of a file that write_recording wrote
    other_labels: dict[str, Any]
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
        self.other_labels = {}

    # What each kind of file has to know.

    def raw(self, index: int) -> NDArray[Any]:
        """Values of one channel as the file holds them, shape (n,): numbers, or dates."""
        raise NotImplementedError

    def usable(self, index: int) -> bool:
        """Whether a channel may hold a record: asked where no name tells which is the torque."""
        return True

    def stated_rate(self, torque: int) -> tuple[float, str] | None:
        """Sampling rate in Hz that the file states for a channel, and where it does."""
        return None

    def meta(self, torque: int) -> dict[str, Any]:
        """What else the file says of a channel."""
        return {}

    def check_torque(self, torque: int, scale: float | None) -> None:
        """Raise ``ValueError`` where the torque's channel holds raw counts and no scale is given."""

    def where(self, sample: int) -> str:
        """Where a sample stands, for messages."""
        return f"sample {sample}"

    # What follows from it.

    def column(self, index: int) -> Float:
        """Numbers of one channel, checked: real, finite, at least two."""
        values = self.raw(index)
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
            raise ValueError(f"{called} must be finite, got {numbers[where]} at {self.where(where)}")
        return numbers

    def times(self, index: int) -> NDArray[Any]:
        """Numbers or dates of a column of times."""
        values = self.raw(index)
        return values if values.dtype.kind in "mM" else self.column(index)

    def listed(self) -> str:
        """Names of all channels, for messages."""
        names = [repr(name) for name in self.names[:40]] if self.named else self.names[:40]
        more = f" and {len(self.names) - 40} more" if len(self.names) > 40 else ""
        return (", ".join(names) or "none") + more + ("" if self.named else " (no names in the file)")

    def find(self, argument: str, wanted: Any, usual: set[str]) -> int | None:
        """Index of the channel that is asked for, else of the one with a usual name, else None."""
        if wanted is None:
            matches = [i for i, base in enumerate(self.bases) if base in usual]
            if len(matches) > 1:
                names = ", ".join(repr(self.names[i]) for i in matches)
                raise ValueError(
                    f"{self.file}: {argument} must be given, since several {self.plural} fit: {names}"
                )
            return matches[0] if matches else None
        if not self.by_index and not isinstance(wanted, str):
            raise TypeError(
                f"{argument} must be the name of {self.a_noun()}, got {wanted!r}; {self.plural} are "
                f"{self.listed()}"
            )
        if isinstance(wanted, (bool, np.bool_)) or not isinstance(wanted, (str, int, np.integer)):
            raise TypeError(f"{argument} must be a {self.noun}'s name or index from 0, got {wanted!r}")
        if not isinstance(wanted, str):
            if not 0 <= wanted < len(self.names):
                raise self._unknown(argument, wanted)
            return int(wanted)
        matches = [i for i, name in enumerate(self.names) if name == wanted]
        matches = matches or [i for i, name in enumerate(self.plain) if name == wanted]
        matches = matches or [i for i, base in enumerate(self.bases) if base == wanted.strip().lower()]
        if not matches and self.by_index and wanted.isdecimal() and int(wanted) < len(self.names):
            matches = [int(wanted)]
        if not matches:
            raise self._unknown(argument, wanted)
        if len(matches) > 1:
            if self.by_index:
                raise ValueError(
                    f"{self.file}: {argument} = {wanted!r} fits {self.plural} {matches}; give one index"
                )
            names = ", ".join(repr(self.names[i]) for i in matches)
            raise ValueError(f"{self.file}: {argument} = {wanted!r} fits several {self.plural}: {names}")
        return matches[0]

    def torque(self, wanted: Channel | None, others: set[int | None]) -> int:
        """Index of the torque's channel."""
        if not self.names:
            raise ValueError(f"{self.file} holds no {self.noun}")
        found = self.find("channel", wanted, TORQUE_NAMES)
        if found is None:
            left = [i for i in range(len(self.names)) if i not in others and self.usable(i)]
            if len(left) != 1:
                raise ValueError(
                    f"{self.file}: channel must be given, to say which {self.noun} is the torque: "
                    f"{self.listed()}"
                )
            found = left[0]
        return found

    def torque_factor(self, index: int, scale: float | None) -> tuple[float, bool]:
        """Nm per unit of a channel, and whether that is assumed."""
        if scale is not None:
            return float(scale), False
        unit = self.units[index]
        if unit is None:
            return 1.0, True
        if unit not in TORQUE_UNITS:
            raise ValueError(
                f"{self.file}: channel {self.names[index]!r} is in {unit!r}, known are "
                f"{', '.join(TORQUE_UNITS)}; give scale= (Nm per unit)"
            )
        return TORQUE_UNITS[unit], False

    def angle_factor(self, index: int, angle_unit: str | None) -> tuple[float, bool]:
        """Radians per unit of the angle's channel, and whether that is assumed."""
        stated = self.units[index]
        name = self.names[index]
        if stated in ANGLE_UNITS and angle_unit is not None and stated != angle_unit:
            raise ValueError(
                f"{self.file}: angle_unit = {angle_unit!r} contradicts the {self.noun} {name!r}, which is in "
                f"{stated}"
            )
        unit = angle_unit or stated or self.angle_unit
        if unit not in ANGLE_UNITS:
            raise ValueError(
                f"{self.file}: {self.noun} {name!r} does not say whether it is in rad or deg; give "
                "angle_unit='rad' or 'deg', or angle_channel=False to leave it out"
            )
        return ANGLE_UNITS[unit], angle_unit is None and stated is None

    def a_noun(self) -> str:
        return f"{'an' if self.noun[0] in 'aeiou' else 'a'} {self.noun}"

    def _unknown(self, argument: str, wanted: Any) -> ValueError:
        return ValueError(
            f"{self.file}: {argument} = {wanted!r} does not exist; {self.plural} are {self.listed()}"
        )


def name_and_unit(name: str) -> tuple[str, str | None]:
    """Lower-case base name and unit of a channel: ``Torque [Nm]`` gives ("torque", "Nm")."""
    found = re.fullmatch(r"(.+?)\s*(?:\[([^]]*)\]|\(([^)]*)\)|/\s*(\S+)|\bin\s+(\S+))\s*", name.strip())
    if found:
        unit = next(group for group in found.groups()[1:] if group is not None)
        return found[1].strip().lower(), clean_unit(unit)
    base, _, suffix = name.strip().lower().rpartition("_")
    if base and suffix in _UNIT_SUFFIXES:
        return base, _UNIT_SUFFIXES[suffix]
    return name.strip().lower(), None


def clean_unit(unit: str | None) -> str | None:
    """A unit in the spelling used here, e.g. "Nm" for "N·m"; unknown ones stay as they are."""
    if unit is None:
        return None
    bare = re.sub(r"[\s·⋅*.\-]", "", unit.strip().strip("[]()"))
    return _OTHER_SPELLINGS.get(bare.lower(), bare) or None


def is_number(value: Any) -> bool:
    """Whether a value is a finite real number."""
    number = isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool)
    return number and math.isfinite(value)


def check_rate(name: str, value: Any) -> None:
    """Raise ``ValueError`` for what is no sampling rate."""
    if not (is_number(value) and value > 0):
        raise ValueError(f"{name} must be a positive, finite number (Hz), got {value!r}")


def check_same_rate(file: str, given: float | None, stated: float, where: str, *, tolerance: float) -> None:
    """Raise ``ValueError`` where two statements of the rate contradict each other."""
    if given is not None and not math.isclose(given, stated, rel_tol=tolerance):
        raise ValueError(
            f"{file}: sampling_rate = {given:g} Hz contradicts {where}, which says {stated:g} Hz"
        )


def check_claim(path: Path, n_bytes: int) -> None:
    """Raise ``ValueError`` where a file claims more data than one of its size can hold."""
    if n_bytes > max(_LARGEST_RATIO * path.stat().st_size, _ALWAYS_ALLOWED):
        raise ValueError(
            f"{path.name} is damaged: it claims {n_bytes / 1e9:.3g} GB of data in {path.stat().st_size} bytes"
        )


def whole_rate(step_s: float) -> float:
    """Rate in Hz of a step in s; a whole number where rounding of the step is all that speaks against it."""
    rate = 1 / step_s
    return float(round(rate)) if abs(rate - round(rate)) <= 1e-9 * rate and round(rate) > 0 else rate


def missing_library(suffix: str, library: str) -> ImportError:
    """What to say where a library of the extra is not installed."""
    return ImportError(f"reading {suffix} files needs {library}: pip install 'cyclofeat[io]'")
