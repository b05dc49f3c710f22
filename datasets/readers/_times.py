"""Sampling rate of a column of times, whose jitter and gaps are checked."""

from __future__ import annotations

from typing import Any

import numpy as np

from cyclofeat._base.quantities import number_of
from cyclofeat.datasets.readers._columns import TIME_UNITS, Float, Source, check_same_rate

# Rounded times lie within a fraction of a sample of even spacing; one missing sample moves them by at least
# half a sample somewhere.
_MOST_JITTER, _REPORTED_JITTER = 0.25, 0.05
# Times since 1970 in ms, us and ns, as data loggers write them.
_SINCE_1970 = ((1e11, 1e14, "ms"), (1e14, 1e17, "us"), (1e17, 1e20, "ns"))


def rate_of(
    source: Source, time: int | None, torque: int, given: float | None, *, asked: bool
) -> tuple[float, dict[str, Any]]:
    """Sampling rate in Hz, and its origin for ``meta``.

    ``given`` is the rate that the caller states; ``asked`` is True if the caller named the time channel.
    """
    stated = source.stated_rate(torque)
    if stated is not None:
        check_same_rate(source.file, given, stated[0], f"its {stated[1]}", tolerance=1e-6)
        if not asked:
            return stated[0], {"rate_from": stated[1]}
    if time is None:
        if given is None:
            raise ValueError(
                f"{source.file}: no sampling rate: give sampling_rate= (Hz), or time_channel= for "
                f"{source.a_noun} of times; {source.plural} are {source.channel_names()}"
            )
        return float(given), {"rate_from": "argument"}
    name = f"time {source.noun} {source.names[time]!r}"
    try:
        values = source.time_values(time)
    except ValueError:
        if given is None or asked:
            raise
        return float(given), {"rate_from": "argument"}  # a clock in text: not needed where the rate is given
    note = ""
    if values.dtype.kind in "mM":
        if values.size < 2 or np.any(np.isnat(values)):
            raise ValueError(f"{source.file}: {name} has times missing")
        seconds = (values - values[0]) / np.timedelta64(1, "s")
    else:
        unit = source.units[time] or "s"
        if source.units[time] is None:
            for low, high, guess in _SINCE_1970:
                if low <= abs(values[0]) < high:
                    unit, note = guess, f" ({guess} since 1970)"
        if unit not in TIME_UNITS:
            raise ValueError(f"{source.file}: {name} must be in {', '.join(TIME_UNITS)}, got {unit!r}")
        seconds = values - values[0]  # dates in ns would lose the digits that matter
        seconds *= TIME_UNITS[unit]
    del values  # each is as long as the record
    if given is not None:
        span = float(seconds[-1] - seconds[0])
        by_time = (seconds.size - 1) / span if span > 0 else 0.0
        check_same_rate(source.file, given, by_time, f"its {name}", tolerance=0.01)
        return float(given), {"rate_from": "argument"}
    rate, jitter = even_rate(f"{source.file}: {name}", seconds, source)
    meta: dict[str, Any] = {"rate_from": name + note}
    if jitter > _REPORTED_JITTER:
        meta["time_jitter"] = round(jitter, 3)
    return rate, meta


def even_rate(called: str, seconds: Float, source: Source) -> tuple[float, float]:
    """Rate of an evenly spaced column of times from 0 in Hz, and its largest jitter in samples."""
    count = seconds.size - 1
    if not seconds[-1] > seconds[0]:
        raise ValueError(
            f"{called} must rise, from its first to its last sample it goes by {seconds[-1] - seconds[0]:g} s"
        )
    if np.any(falls := seconds[1:] < seconds[:-1]):
        where = int(np.argmax(falls)) + 1
        raise ValueError(
            f"{called} must rise, it falls by {seconds[where - 1] - seconds[where]:.3g} s at "
            f"{source.sample_place(where)}"
        )
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
            longest = int(gaps[np.argmax(steps[gaps])])
            missing = number_of(max(1, round(steps[longest] / usual) - 1), "sample")
            problem = (
                f"{number_of(gaps.size, 'gap')} at a usual {1 / usual:.6g} Hz, the longest of {missing} "
                f"before {source.sample_place(longest + 1)}"
            )
        else:
            problem = (
                f"at {source.sample_place(worst)} it is {off[worst]:.2g} samples away from {rate:.6g} Hz "
                "(samples missing, a clock that jitters, or times rounded too coarsely)"
            )
        raise ValueError(
            f"{called} is not evenly spaced: {problem}; if the samples are even, give sampling_rate="
        )
    # Rounded times give 25600.0003 Hz: a whole number of Hz within the column's scatter is taken.
    slack = rate * (2 * float(off[worst]) / count + 1e-9)
    if abs(rate - round(rate)) <= slack and round(rate) > 0:
        rate = float(round(rate))
    return rate, float(off[worst])
