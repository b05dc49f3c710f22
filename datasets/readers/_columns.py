"""Channels of files, which of them holds the torque, and how files are opened and their values read."""

from __future__ import annotations

import math
import re
import reprlib
import warnings
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from cyclofeat._base import checks
from cyclofeat._base.quantities import QUANTITIES, in_words, some_of
from cyclofeat.datasets.readers import _words as words

Float = NDArray[np.float64]
# What to do about an angle of unknown unit.
ANGLE_REMEDY = "give angle_unit='rad', 'deg' or 'rev', or angle_channel=False to leave it out"
# Names that a message lists, and what it quotes of each.
_MOST_NAMES, _SHORT_NAMES = 40, reprlib.Repr()
_SHORT_NAMES.maxstring = 100
# Deflate, the strongest compression of these files, packs at most 1032:1. A small file that claims more is
# damaged, or made to fill the memory.
_LARGEST_RATIO, _ALWAYS_ALLOWED = 1100, 2**26
# Records pack at most so tightly; what unpacks to more is refused above a size that memories hold.
_USUAL_RATIO, LARGEST_UNPACKED = 30, 2 * 10**9
_CHOICES: dict[str, Collection[str]] = {
    "quantity": QUANTITIES, "time_unit": words.TIME_UNITS, "angle_unit": words.ANGLE_UNITS,
    "decimal": (",", "."), "delimiter": (",", ";", "|", "\t", " "), "gaps": ("refuse", "cut"),
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
            checks.positive("sampling_rate", self.sampling_rate, "a number of Hz")
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
        self.base, named = words.name_and_unit(self.plain)
        self.unit = words.clean_unit(self.unit) or named
        if self.group is None:
            self.group = self.name[: self.name.rfind(self.plain)]


@dataclass
class Source:
    """Channels and labels of a file; its name is added to all errors by ``name_errors``."""

    file: str
    channels: list[Channel]
    noun: str = "channel"
    by_index: bool = True  # channels have an order that people can count
    named: bool = True
    labels: dict[str, Any] = field(default_factory=dict)
    is_own: bool = False  # written by write_recording
    angle_unit: str | None = None  # of an angle that states none

    def call(self, channel: Channel) -> str:
        """Return what messages call a channel."""
        return f"{self.noun} {channel.name!r}"

    def column_values(self, channel: Channel, read: NDArray[Any] | None = None) -> Float:
        """Return a channel's numbers; raise ``ValueError`` unless real, finite and at least two."""
        values = channel.read() if read is None else read
        try:
            return checks.number_series(self.call(channel), values, 2)
        except (TypeError, ValueError) as error:
            where = re.sub(r"sample (\d+)$", lambda match: channel.place(int(match[1])), str(error))
            raise ValueError(where) from None

    def list_names(self, channels: Sequence[Channel] | None = None) -> str:
        """Return the names of channels, by default of all, for messages."""
        names = [channel.name for channel in self.channels if channels is None or channel in channels]
        text = some_of(names, _MOST_NAMES, _SHORT_NAMES.repr if self.named else str) or "none"
        return text + ("" if self.named else " (no names in the file)")

    def find_channel(self, argument: str, wanted: Any) -> Channel:
        """Return the channel that an argument names, or counts."""
        exist = f"{self.noun}s are {self.list_names()}"
        if not isinstance(wanted, str) and not (self.by_index and checks.is_whole(wanted)):
            index = " or index from 0" if self.by_index else ""
            raise TypeError(f"{argument} must be the {self.noun}'s name{index}, got {wanted!r}; {exist}")
        matches: list[Channel] = []
        for name in ("name", "plain", "base"):
            asked = str(wanted).strip().lower() if name == "base" else wanted
            matches = matches or [channel for channel in self.channels if getattr(channel, name) == asked]
        if not matches and self.by_index and str(wanted).isdecimal():
            matches = self.channels[int(wanted) :][:1]
        if len(matches) == 1:
            return matches[0]
        problem = f"does not exist; {exist}"
        if matches:
            which = self.list_names(matches)
            if self.by_index:
                which = f"{[self.channels.index(channel) for channel in matches]}; give one index"
            problem = f"fits several {self.noun}s: {which}"
        raise ValueError(f"{argument} = {wanted!r} {problem}")

    def find_only(self, argument: str, matches: Sequence[Channel]) -> Channel | None:
        """Return the only match, or None without one; raise ``ValueError`` for several."""
        if len(matches) > 1:
            which = self.list_names(matches)
            raise ValueError(f"{argument}= must be given, since several {self.noun}s fit: {which}")
        return matches[0] if matches else None

    def find_torque(
        self, wanted: str | int | None, others: Collection[Channel | None], quantity: str | None
    ) -> Channel:
        """Return the channel that holds the quantity, by default the output torque.

        Its name decides, then its unit, then that it is the only one. A channel that names another quantity
        is taken only if both the channel and the quantity were stated.
        """
        if not self.channels:
            raise ValueError(f"the file holds no {self.noun}")
        sought = quantity or "output_torque"
        if wanted is None:
            free = [channel for channel in self.channels if channel not in others]
            usable = [channel for channel in free if channel.usable]
            named = [channel for channel in free if words.is_usual(channel.base, sought)]
            measured = [
                channel for channel in usable if channel.unit in words.UNITS_OF[sought]
                and words.named_quantity(channel.base) in (None, sought)
            ]  # fmt: skip
            if match := self.find_only("channel", named) or self.find_only("channel", measured):
                return match
            known = [channel for channel in usable if words.states_quantity(channel.base, channel.unit)]
            only = next((channels for channels in (usable, known) if len(channels) == 1), None)
            if only is None:
                name = in_words(quantity) if quantity else "torque"
                raise ValueError(
                    f"channel= must be given, to say which {self.noun} is the {name}: {self.list_names()}"
                )
            channel = only[0]
        else:
            channel = self.find_channel("channel", wanted)
            if quantity:
                return channel
        is_current = channel.unit in words.CURRENT_UNITS
        stated = words.named_quantity(channel.base) or ("motor_current" if is_current else sought)
        if stated == sought:
            return channel
        raise ValueError(
            f"{self.call(channel)} holds {in_words(stated)} by its name or unit, not {in_words(sought)}: "
            f"give quantity={stated!r}, or channel= and quantity={sought!r}{' and scale=' * is_current} if "
            "the name is wrong"
        )

    def unit_factor(self, channel: Channel, scale: float | None, quantity: str) -> tuple[float, str | None]:
        """Nm or A per unit of a channel, and which of them; None where Nm, or A of a current, is assumed.

        A share of the rated current stays as it is. A scale of a current in A or mA is its torque constant,
        after which the samples are in Nm.
        """
        unit, known = channel.unit, words.UNITS_OF[quantity]
        usual = next(iter(known))
        if quantity == "motor_current":
            known = known | words.RELATIVE_UNITS | words.TORQUE_UNITS
        if scale is not None:
            return float(scale), "Nm" if unit in words.CURRENT_UNITS else usual
        if channel.raw:
            raise ValueError(f"{self.call(channel)} holds {channel.raw}")
        if unit is None:
            return 1.0, None
        if unit not in known:
            is_current = unit in words.CURRENT_UNITS | words.RELATIVE_UNITS
            raise ValueError(
                f"{self.call(channel)} is in {unit!r}, known are {', '.join(known)}; "
                f"give scale= ({usual} per unit)" + ", or quantity='motor_current'" * is_current
            )
        if unit in words.RELATIVE_UNITS:
            return known[unit], unit.removeprefix("0.1")
        return known[unit], "Nm" if unit in words.TORQUE_UNITS else "A"

    def angle_factor(self, channel: Channel, angle_unit: str | None) -> tuple[float, bool]:
        """Radians per unit of the angle's channel, and whether that is assumed."""
        known, stated = words.ANGLE_UNITS, channel.unit
        if stated in known and angle_unit not in (None, stated):
            raise ValueError(f"angle_unit = {angle_unit!r} contradicts its unit, {stated}")
        unit = angle_unit or stated or self.angle_unit
        if unit not in known:
            raise ValueError(f"angle does not state its unit (rad, deg or rev); {ANGLE_REMEDY}")
        return known[unit], angle_unit is None and stated is None


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
def name_errors(name: str) -> Iterator[None]:
    """Begin the texts of errors with what they are of, a file or a channel."""
    try:
        yield
    except (TypeError, ValueError) as error:
        text = str(error)
        if re.match("(angle|signal) must", text):
            text += " (angle_channel=False leaves the angle out)"
        error.args = (text if text.startswith(name) else f"{name}: {text}",)
        raise


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


@contextmanager
def open_with(
    path: Path, kind: str, library: str, open_file: Callable[[Any], AbstractContextManager[Any]]
) -> Iterator[Any]:
    """Open a file with the module of a library, which may not be installed; explain damage meanwhile."""
    package = {"nptdms": "npTDMS"}.get(library, library.partition(".")[0])
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # of libraries that these import
            module = import_module(library)
    except ImportError:
        raise ImportError(f"reading {path.name} as {kind} needs {package}: pip install {package}") from None
    with explain_damage(path, kind), open_file(module) as file:
        yield file
