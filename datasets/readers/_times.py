"""Time base of a channel: all statements of a file about its sampling rate, compared."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from cyclofeat._base.quantities import number_of
from cyclofeat.datasets.readers._columns import (
    RATE_UNITS,
    TIME_UNITS,
    Float,
    ReadingOptions,
    Source,
    is_time_name,
    name_and_unit,
    whole_rate,
    with_spaces,
)

# Rounded times lie within a fraction of a sample of even spacing; one missing sample moves them by at least
# half a sample somewhere.
_MOST_JITTER, _REPORTED_JITTER = 0.25, 0.05
# Relative difference up to which two statements of a rate agree: a computer's clock is off by less.
_SAME = 1e-3
# Numbers without a unit: times since 1970 in ms, us and ns as data loggers write them, or days since 1900.
_EPOCHS = (
    (2e4, 8e4, "d", "days since 1900"), (1e11, 1e14, "ms", "ms since 1970"),
    (1e14, 1e17, "us", "us since 1970"), (1e17, 1e20, "ns", "ns since 1970"),
)  # fmt: skip
# Rates in Hz of recordings that can be counted; a time without unit that gives another one is not in s.
_SENSIBLE = (200.0, 1e7)
_MOST_GAPS = 100  # that a recording lists
_EVEN = "if the samples are even, give sampling_rate="
_RATE = r"fs|f s|f sample|(sampl(e|ing)|scan) ?(rate|freq|frequency)|(abtast|mess)(rate|frequenz)"
_STEP = (
    r"dt|ts|delta ?[xt]|time ?(step|interval)|sampl(e|ing) ?(time|period|interval)|(x ?)?incr(ement)?|xinc|"
    r"abtast(zeit|intervall|periode)|horizontal interval|zeitschritt"
)


class Statement(NamedTuple):
    """A sampling rate in Hz, where the file states it, and the option that chooses it."""

    rate: float
    source: str
    choice: str = ""

    def agrees(self, rate: float) -> bool:
        return math.isclose(self.rate, rate, rel_tol=_SAME)


class TimeError(ValueError):
    """Error of a time channel whose times are not evenly spaced; the rate and the gaps are known."""

    def __init__(self, message: str, usual: float = 0.0, gaps: Sequence[list[int]] = ()) -> None:
        super().__init__(message)
        self.usual, self.gaps = usual, list(gaps)


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


def time_channels(source: Source) -> list[int]:
    """Return the channels that hold times by their names."""
    return [index for index, base in enumerate(source.bases) if is_time_name(base)]


def time_base(source: Source, torque: int, reading: ReadingOptions) -> tuple[float, dict[str, Any]]:
    """Return the sampling rate of a channel in Hz, and for ``meta`` what it follows from.

    All statements of the file about the channel must agree, unless ``reading`` chooses one.
    """
    given, asked = reading.sampling_rate, reading.time_channel
    stated = [Statement(rate, where) for rate, where in source.stated_rates(torque)]
    if source.labels is not None:
        stated = [Statement(source.labels["sampling_rate"], "header")]
    times: list[Statement] = []
    meta: dict[str, Any] = {}
    notes: list[str] = []
    foreign = ""
    for index in _candidates(source, torque, reading):
        name = f"time {source.noun} {source.names[index]!r}"
        if source.length(index) != source.length(torque):
            foreign = (
                f"{name} has {source.length(index)} times, {source.noun} {source.names[torque]!r} "
                f"{source.length(torque)} samples: it belongs to another one"
            )
            if asked is not None and given is None:
                raise ValueError(f"{source.file}: {foreign}")
            continue
        try:
            times.append(_times_statement(source, index, reading, stated, meta, notes))
        except TimeError as error:
            if given is None and (error.gaps or not stated):
                raise
            meta |= {"gaps": error.gaps} if error.gaps else {}
            notes.append(str(error).partition("; ")[0].removeprefix(f"{source.file}: "))
            if error.usual:
                times.append(Statement(error.usual, name))
        except ValueError as error:
            if given is None and (asked is not None or not stated):
                raise
            notes.append(str(error).partition("; ")[0].removeprefix(f"{source.file}: "))
    statements = times if asked is not None and times else [*stated, *times]
    if given is not None:
        rate, taken, chosen = float(given), [Statement(float(given), "argument")], "sampling rate given"
    elif not statements:
        raise ValueError(
            f"{source.file}: no sampling rate{': ' * bool(foreign)}{foreign}; give sampling_rate= (Hz), or "
            f"time_channel= for {source.a_noun} of times; {source.plural} are {source.channel_names()}"
        )
    else:
        rate, chosen = statements[0].rate, "time channel chosen"
        taken = [statement for statement in statements if statement.agrees(rate)]
        if len(taken) < len(statements):
            listed = ", ".join(f"{one.source} says {one.rate:.6g} Hz" for one in statements)
            choices = [f"sampling_rate = {one.rate:.10g}" for one in statements]
            choices += [one.choice for one in statements if one.choice]
            raise ValueError(
                f"{source.file}: the sampling rate is contradicted: {listed}; give "
                f"{' or '.join(dict.fromkeys(choices))}"
            )
    for other in (*stated, *times):
        if not other.agrees(rate):
            notes.append(
                f"the {chosen}, {rate:.6g} Hz, overrides {other.source}, which says {other.rate:.6g} Hz"
            )
    meta["rate_from"] = " and ".join(one.source for one in taken)
    return rate, meta | ({"time_notes": notes} if notes else {})


def _candidates(source: Source, torque: int, reading: ReadingOptions) -> Sequence[int]:
    """Return the channels whose times may be those of the torque, of its own group if that has any."""
    if reading.without_times or source.labels is not None:
        return []
    if reading.time_channel is not None:
        index = source.find_channel("time_channel", reading.time_channel, set())
        assert index is not None
        return [index]
    channels = [index for index in time_channels(source) if index != torque]
    near = [index for index in channels if source.group_of(index) == source.group_of(torque)]
    fitting = [index for index in near or channels if source.length(index) == source.length(torque)]
    return fitting or channels[:1]


def _times_statement(
    source: Source,
    index: int,
    reading: ReadingOptions,
    stated: list[Statement],
    meta: dict[str, Any],
    notes: list[str],
) -> Statement:
    """Return the rate that a channel of times states; ``meta`` and ``notes`` get what is known of them."""
    name = f"time {source.noun} {source.names[index]!r}"
    values = source.time_values(index)
    stated_unit, origin = reading.time_unit or source.units[index], ""
    if values.dtype.kind in "mM":
        if values.size < 2 or np.any(np.isnat(values)):
            raise ValueError(f"{source.file}: {name} has times missing")
        seconds = (values - values[0]) / np.timedelta64(1, "s")
    else:
        unit = stated_unit or "s"
        if stated_unit is None:
            for low, high, guess, words in _EPOCHS:
                days = guess == "d" and not 0 < abs(values[-1] - values[0]) / values.size < 1e-6
                if low <= abs(values[0]) < high and not days:
                    unit, origin = guess, f" ({words})"
        if unit not in TIME_UNITS:
            raise ValueError(
                f"{source.file}: {name} must be in {', '.join(TIME_UNITS)}, got {unit!r}; give time_unit="
            )
        seconds = values - values[0]  # dates in ns would lose the digits that matter
        seconds *= TIME_UNITS[unit]
    assumed = values.dtype.kind not in "mM" and stated_unit is None and not origin
    del values  # each is as long as the record
    rate, jitter = _even_rate(f"{source.file}: {name}", seconds, source)
    if assumed and not _SENSIBLE[0] <= rate < _SENSIBLE[1]:
        by_unit = {unit: rate / factor for unit, factor in TIME_UNITS.items()}
        same = [unit for unit in by_unit for one in stated if one.agrees(by_unit[unit])]
        if not same:
            sensible = [unit for unit in by_unit if _SENSIBLE[0] <= by_unit[unit] < _SENSIBLE[1]]
            units = [f"time_unit={unit!r} ({by_unit[unit]:.6g} Hz)" for unit in sensible]
            units.append("time_channel='none' with sampling_rate= if it counts samples")
            raise ValueError(
                f"{source.file}: {name} states no unit, and in s the sampling rate would be {rate:.6g} Hz; "
                f"give {', '.join(units)}, or time_unit='s'"
            )
        rate, assumed, origin = by_unit[same[0]], False, f" (in {same[0]})"
    if assumed:
        notes.append(f"the file states no unit of {name}: s assumed")
    if jitter > _REPORTED_JITTER:
        meta["time_jitter"] = round(jitter, 3)
    return Statement(rate, name + origin, f"time_channel={source.names[index]!r}")


def _even_rate(called: str, seconds: Float, source: Source) -> tuple[float, float]:
    """Rate of an evenly spaced column of times from 0 in Hz, and its largest jitter in samples."""
    count = seconds.size - 1
    if not seconds[-1] > seconds[0]:
        by = f"{seconds[-1] - seconds[0]:g} s"
        raise TimeError(f"{called} must rise, from its first to its last sample it goes by {by}; {_EVEN}")
    if np.any(falls := seconds[1:] < seconds[:-1]):
        where = int(np.argmax(falls)) + 1
        by = f"{seconds[where - 1] - seconds[where]:.3g} s at {source.sample_place(where)}"
        raise TimeError(f"{called} must rise, it falls by {by}; {_EVEN}")
    rate = count / float(seconds[-1] - seconds[0])
    off = np.arange(seconds.size, dtype=np.float64)  # in place: each array is as long as the record
    off /= -rate
    off += seconds
    off *= rate
    np.abs(off, out=off)
    worst = int(np.argmax(off))
    if off[worst] > _MOST_JITTER:
        steps = np.diff(seconds)
        usual = float(np.median(steps))
        gaps = np.flatnonzero(steps > 1.5 * usual) if usual > 0 else np.empty(0, np.int64)
        if 0 < gaps.size <= max(1, steps.size // 100):
            missing = [[int(gap) + 1, max(1, round(steps[gap] / usual) - 1)] for gap in gaps]
            place, longest = max(missing, key=lambda gap: gap[1])
            raise TimeError(
                f"{called} is not evenly spaced: {number_of(gaps.size, 'gap')} at a usual {1 / usual:.6g} "
                f"Hz, the longest of {number_of(longest, 'sample')} before {source.sample_place(place)}; to "
                f"read the samples as if none were missing, give sampling_rate = {1 / usual:.6g}",
                1 / usual,
                missing[:_MOST_GAPS],
            )
        raise TimeError(
            f"{called} is not evenly spaced: at {source.sample_place(worst)} it is {off[worst]:.2g} samples "
            f"away from {rate:.6g} Hz (samples missing, a clock that jitters, or times rounded too "
            f"coarsely); {_EVEN}",
            rate,
        )
    # Rounded times give 25600.0003 Hz: a whole number of Hz within the column's scatter is taken.
    return whole_rate(rate, 2 * float(off[worst]) / count + 1e-9), float(off[worst])
