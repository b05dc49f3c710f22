"""Time base of a channel: all statements of a file about its sampling rate, compared."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from cyclofeat._base.quantities import number_of
from cyclofeat.datasets.readers._columns import Channel, Float, ReadingOptions, Source
from cyclofeat.datasets.readers._words import TIME_UNITS, is_time_name, whole_rate

# Rounded times lie within a fraction of a sample of even spacing; one missing sample moves them by at least
# half a sample somewhere.
_MOST_JITTER, _REPORTED_JITTER = 0.25, 0.05
# Relative difference up to which two statements of a rate agree: a computer's clock is off by less.
_SAME = 1e-3
# Numbers without a unit: times as data loggers, spreadsheets and Windows write them, and their unit in s.
_EPOCHS = (
    (2e4, 8e4, 86_400.0, "days since 1900"), (1e11, 1e14, 1e-3, "ms since 1970"),
    (1e14, 5e16, 1e-6, "us since 1970"), (5e16, 3e17, 1e-7, "100 ns since 1601"),
    (3e17, 1e20, 1e-9, "ns since 1970"),
)  # fmt: skip
# Rates in Hz of recordings that can be counted; a time without unit that gives another one is not in s.
_SENSIBLE = (200.0, 1e7)
_MOST_GAPS = 100  # that a recording lists
_PART = 2**15  # times that are compared with even ones at once
_EVEN = "if the samples are even, give sampling_rate="


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


def time_channels(source: Source) -> list[Channel]:
    """Return the channels that hold times by their names."""
    return [channel for channel in source.channels if is_time_name(channel.base)]


def time_base(
    source: Source, torque: Channel, reading: ReadingOptions
) -> tuple[list[tuple[int, float]], dict[str, Any]]:
    """Return the first sample and the rate in Hz of each stretch of a channel, and ``meta`` of the rate.

    All statements of the file about the channel must agree, unless ``reading`` chooses one. There is one
    stretch, unless ``reading`` cuts the record at gaps and at segments of another rate.
    """
    given, asked, cut = reading.sampling_rate, reading.time_channel, reading.gaps == "cut"
    starts = torque.segments() if cut and torque.segments else [(0, 0.0)]
    if len(starts) > 1 and given is None:
        return starts, {"rate_from": "the segments"}
    stated, times = [Statement(rate, where) for rate, where in torque.rates], list[Statement]()
    meta, notes, foreign = dict[str, Any](), list[str](), ""
    for channel in _candidates(source, torque, reading):
        name = f"time {source.noun} {channel.name!r}"
        if channel.length != torque.length:
            foreign = (
                f"{name} has {channel.length} times, {source.noun} {torque.name!r} {torque.length} samples: "
                "it belongs to another one"
            )
            if asked is not None and given is None:
                raise ValueError(foreign)
            continue
        try:
            statement, found, jitter = _times_statement(source, channel, reading, stated)
            times.append(statement)
            notes += found
            meta |= {"time_jitter": round(jitter, 3)} if jitter > _REPORTED_JITTER else {}
        except ValueError as error:
            gaps, usual = (error.gaps, error.usual) if isinstance(error, TimeError) else ([], 0.0)
            if given is None and (gaps or asked is not None or not stated) and not (gaps and cut):
                raise
            if gaps:
                meta["gaps"] = gaps[:_MOST_GAPS]
                starts = [(0, 0.0), *((place, 0.0) for place, _ in gaps)] if cut else starts
            notes.append(str(error).partition("; ")[0])
            times += [Statement(usual, name)] if usual else []
    statements = times if asked is not None and times else [*stated, *times]
    if given is not None:
        taken, chosen = [Statement(float(given), "argument")], "sampling rate given"
    elif not statements:
        raise ValueError(
            f"no sampling rate{': ' * bool(foreign)}{foreign}; give sampling_rate= (Hz), or "
            f"time_channel= for a {source.noun} of times; {source.noun}s are {source.list_names()}"
        )
    else:
        chosen = "time channel chosen"
        taken = [statement for statement in statements if statement.agrees(statements[0].rate)]
        if len(taken) < len(statements):
            raise ValueError(_contradiction(statements, torque.segments is not None))
    rate = taken[0].rate
    notes += [
        f"the {chosen}, {rate:.6g} Hz, overrides {other.source}, which says {other.rate:.6g} Hz"
        for other in (*stated, *times)
        if not other.agrees(rate)
    ]
    meta["rate_from"] = " and ".join(statement.source for statement in taken)
    meta |= {"time_notes": [*dict.fromkeys(notes)]} if notes else {}
    return [(start, rate) for start, _ in starts], meta


def _contradiction(statements: Sequence[Statement], cut: bool) -> str:
    """Return the message of statements that disagree, with the options that choose one."""
    listed = ", ".join(f"{source} says {rate:.6g} Hz" for rate, source, _ in statements)
    choices = [f"sampling_rate = {rate:.10g}" for rate, _, _ in statements]
    choices += [choice for _, _, choice in statements if choice]
    choices += ["gaps='cut' (for each segment by itself)"] if cut else []
    return f"the sampling rate is contradicted: {listed}; give {' or '.join(dict.fromkeys(choices))}"


def _candidates(source: Source, torque: Channel, reading: ReadingOptions) -> Sequence[Channel]:
    """Return the channels whose times may be those of the torque, of its own group if that has any."""
    if reading.without_times:
        return []
    if reading.time_channel is not None:
        return [source.find_channel("time_channel", reading.time_channel)]
    channels = [channel for channel in time_channels(source) if channel is not torque]
    near = [channel for channel in channels if channel.group == torque.group]
    fitting = [channel for channel in near or channels if channel.length == torque.length]
    return fitting or channels[:1]


def _times_statement(
    source: Source, channel: Channel, reading: ReadingOptions, stated: list[Statement]
) -> tuple[Statement, list[str], float]:
    """Return the rate that a channel of times states, notes on it, and the jitter of the times in samples."""
    name = f"time {source.noun} {channel.name!r}"
    values = channel.read()
    stated_unit, origin, assumed = reading.time_unit or channel.unit, "", False
    if values.dtype.kind in "mM":
        if values.size < 2 or np.any(np.isnat(values)):
            raise ValueError(f"{name} has times missing")
        seconds = (values - values[0]) / np.timedelta64(1, "s")
    else:
        values, factor = source.column_values(channel, values), TIME_UNITS.get(stated_unit or "s", 0.0)
        if not factor:
            raise ValueError(
                f"{name} must be in {', '.join(TIME_UNITS)}, got {stated_unit!r}; give time_unit="
            )
        if stated_unit is None:
            for low, high, unit, words in _EPOCHS:
                fits = unit < 1 or 0 < abs(values[-1] - values[0]) / values.size < 1e-6
                if low <= abs(values[0]) < high and fits:
                    factor, origin = unit, f" ({words})"
            assumed = not origin
        seconds = values - values[0]  # dates in ns would lose the digits that matter
        seconds *= factor
    del values  # each is as long as the record
    rate, jitter = _even_rate(name, seconds, channel)
    if assumed and not _is_sensible(rate):
        by_unit = {unit: rate / factor for unit, factor in TIME_UNITS.items()}
        same = [unit for unit in by_unit for statement in stated if statement.agrees(by_unit[unit])]
        if not same:
            sensible = [item for item in by_unit.items() if _is_sensible(item[1])]
            units = [f"time_unit={unit!r} ({hertz:.6g} Hz)" for unit, hertz in sensible]
            units.append("time_channel='none' with sampling_rate= if it counts samples")
            raise ValueError(
                f"{name} states no unit, and in s the sampling rate would be {rate:.6g} Hz; "
                f"give {', '.join(units)}, or time_unit='s'"
            )
        rate, assumed, origin = by_unit[same[0]], False, f" (in {same[0]})"
    notes = [f"the file states no unit of {name}: s assumed"] if assumed else []
    return Statement(rate, name + origin, f"time_channel={channel.name!r}"), notes, jitter


def _is_sensible(rate: float) -> bool:
    return _SENSIBLE[0] <= rate < _SENSIBLE[1]


def _even_rate(called: str, seconds: Float, channel: Channel) -> tuple[float, float]:
    """Rate of an evenly spaced column of times from 0 in Hz, and its largest jitter in samples."""
    rises = seconds[-1] > seconds[0]
    rate, jitter, worst = _fit_rate(seconds) if rises else (0.0, math.inf, 0)
    falls = not rises or bool((seconds[1:] < seconds[:-1]).any())
    if not falls and jitter <= _MOST_JITTER:
        return rate, jitter
    steps = np.diff(seconds)
    usual = float(np.median(steps))
    breaks = np.flatnonzero((steps > 1.5 * usual) | (steps < 0)) + 1
    if usual > 0 and 0 < len(breaks) <= max(1, steps.size // 100):
        edges = [0, *breaks, seconds.size]
        first, end = max(pairwise(edges), key=lambda ends: ends[1] - ends[0])
        usual = _fit_rate(seconds[first:end])[0] if end - first > 1 else 1 / usual
        if all(_fit_rate(seconds[a:b], usual)[1] <= _MOST_JITTER for a, b in pairwise(edges)):
            gaps = [[int(k), max(0, round(steps[k - 1] * usual) - 1)] for k in breaks]
            place, longest = max(gaps, key=lambda gap: gap[1])
            words = f"the longest of {number_of(longest, 'sample')}" if longest else "times restart"
            raise TimeError(
                f"{called} is not evenly spaced: {number_of(len(gaps), 'gap')} at a usual {usual:.6g} Hz, "
                f"{words} before {channel.place(place)}; to read the samples as if none were missing, "
                f"give sampling_rate = {usual:.6g}, or gaps='cut' to read what lies between the gaps",
                usual,
                gaps,
            )
    if falls:
        where = int(np.argmin(steps)) + 1
        by = f"{abs(steps[where - 1]):.3g} s at {channel.place(where)}"
        raise TimeError(f"{called} must rise, it falls by {by}; {_EVEN}")
    raise TimeError(
        f"{called} is not evenly spaced: at {channel.place(worst)} it is {jitter:.2g} samples away from "
        f"{rate:.6g} Hz (samples missing, a clock that jitters, or times rounded too coarsely); {_EVEN}",
        rate,
    )


def _fit_rate(seconds: Float, rate: float | None = None) -> tuple[float, float, int]:
    """Return the rate of times in Hz, their largest jitter in samples, and the sample that has it."""
    count = seconds.size - 1
    if rate is None:
        rate = count / float(seconds[-1] - seconds[0])
    jitter, worst = 0.0, 0
    for start in range(0, seconds.size, _PART):
        part = seconds[start : start + _PART]
        off = np.abs((np.arange(start, start + part.size) / -rate + part - seconds[0]) * rate)
        if off.max() > jitter:
            jitter, worst = float(off.max()), start + int(np.argmax(off))
    # Rounded times give 25600.0003 Hz: a whole number of Hz within the column's scatter is taken.
    return whole_rate(rate, 2 * jitter / max(count, 1) + 1e-9), jitter, worst
