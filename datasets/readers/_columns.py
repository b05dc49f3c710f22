"""Channels of files, which of them holds the torque, and how their values are read."""

from __future__ import annotations

import math
import reprlib
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field
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
_CHOICES: dict[str, Collection[str]] = {
    "quantity": QUANTITIES, "time_unit": words.TIME_UNITS, "angle_unit": words.ANGLE_UNITS,
    "decimal": (",", "."), "delimiter": (",", ";", "\t", " "), "gaps": ("refuse", "cut"),
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
            words.check_rate(self.sampling_rate)
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
    """Channels of a file, and its labels: in ``labels`` if :func:`write_recording` wrote it."""

    file: str
    channels: list[Channel]
    noun: str = "channel"
    by_index: bool = True  # channels have an order that people can count
    named: bool = True
    labels: dict[str, Any] | None = None
    other_labels: dict[str, Any] = field(default_factory=dict)
    angle_unit: str | None = None  # of an angle that states none

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
        raise ValueError(f"{self.file}: {argument} = {wanted!r} {problem}")

    def find_only(self, argument: str, matches: Sequence[Channel]) -> Channel | None:
        """Return the only match, or None without one; raise ``ValueError`` for several."""
        if len(matches) > 1:
            raise ValueError(
                f"{self.file}: {argument}= must be given, since several {self.noun}s fit: "
                f"{self.list_names(matches)}"
            )
        return matches[0] if matches else None

    def find_torque(
        self, wanted: str | int | None, others: Collection[Channel | None], quantity: str | None
    ) -> Channel:
        """Return the channel that holds the quantity, by default the output torque.

        Its name decides, then its unit, then that it is the only one. A channel that names another quantity
        is taken only if both the channel and the quantity were stated.
        """
        if not self.channels:
            raise ValueError(f"{self.file} holds no {self.noun}")
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
                raise ValueError(
                    f"{self.file}: channel= must be given, to say which {self.noun} is the "
                    f"{in_words(quantity) if quantity else 'torque'}: {self.list_names()}"
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
            raise ValueError(
                f"{self.file}: angle_unit = {angle_unit!r} contradicts the {self.noun} {channel.name!r}, "
                f"which is in {stated}"
            )
        unit = angle_unit or stated or self.angle_unit
        if unit not in known:
            raise ValueError(
                f"{self.call(channel)} does not state its unit (rad, deg or rev); {ANGLE_REMEDY}"
            )
        return known[unit], angle_unit is None and stated is None
