"""Angle of the input shaft from the current of a motor that controls its own speed."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence
from operator import attrgetter

import numpy as np
from scipy.signal import lfilter

from cyclofeat.signal.orders import resample_by_angle
from cyclofeat.signal.speed import (
    _COARSE,
    _LAST,
    _SAMPLES_PER_TURN,
    _STEADY,
    FollowedSpeed,
    _at_samples,
    _Attempt,
    _follow_until_fit,
    _Pass,
    _Record,
    _reduce_record,
    _speed_course,
    follow_speed,
)
from cyclofeat.signal.windows import Float

# Gains that are tried: changes of the speed, as shares of the mean one, that one standard deviation of the
# current answers. Integral times of the control in s. From the best of these pairs on, steps of gain and time
# are taken as long as they raise the evidence, then halved.
_GAINS, _TIMES = np.arange(1, 8) * 0.04, (0.006, 0.012, 0.024)
_HIGHEST_GAIN, _SHORTEST, _LONGEST = 0.4, 0.005, 0.05
# Share of the stated speed below which no shaft under control falls.
_SLOWEST = 0.1
_GAIN_STEP, _TIME_STEP, _HALVINGS = 0.02, 2**0.5, 2
# A line of the motor, such as order 30, may lie 2/15 of an order beside a lobe line, and would draw the speed
# to itself: such lobe lines are left out, and blocks are long enough to tell the others from it.
_SHARP = _Pass(turns=14, hop=3.5, tolerance=8e-3, step=2.5e-4, change=1e-3, apart=0.15)
_SHARPER = dataclasses.replace(_LAST, apart=0.15)
_ATTEMPTS = (
    _Attempt((_COARSE, _SHARP, _SHARPER)),
    _Attempt((_COARSE, _SHARP, _SHARPER), every_line=True),
    _Attempt((dataclasses.replace(_STEADY, apart=0.15), _SHARPER), every_line=True),
)
# Output turns, at most, in the middle of the record that are searched, and samples per input turn by which
# controls are compared.
_SEARCHED_TURNS, _COMPARED_PER_TURN = 2.0, 160
# Evidence per turn that a control must add before it is believed; multiple of the evidence that lines at
# another speed have.
_GAINED, _CLEARLY = 0.2, 1.2


def controlled_lag(current: Float, sampling_rate: float, integral_s: float) -> Float:
    """Return by how much a shaft lags behind its set speed, from the current of its motor.

    A proportional-integral controller sets the current i = P (e + a / T), with the speed's deviation e =
    da/dt, the lag a and the integral time T (``integral_s``). The lag is the current behind a low-pass of the
    first order: da/dt + a / T = i / P. ``current`` is without its mean, which the friction and the load need.
    The result is P a, in the unit of the current times s; 0 before the first sample.
    """
    kept = np.exp(-1 / (sampling_rate * integral_s))
    return np.asarray(lfilter([(1 - kept) * integral_s], [1, -kept], current))


def follow_motor(current: Float, sampling_rate: float, nominal_hz: float, n_lobes: int = 15) -> FollowedSpeed:
    """Follow the input shaft in the current of the motor that turns it.

    Worn lobes brake a motor by some per cent of its speed for a part of a turn, too briefly for
    :func:`~cyclofeat.signal.speed.follow_speed`, whose arguments and errors it has. The current tells these
    changes, because the control of the speed sets it in answer to them (:func:`controlled_lag`). Gain and
    integral time are those with which the lines have the most evidence; where none makes them clearly more
    evident, there is no control. What is slow is then followed as in a torque, in longer blocks.

    Where the lobe lines do not reach beyond those of a sound disc (``reaches``), multiples of the speed are
    followed as well, and the lines do not fit (``fits``) if they are more evident there: a motor's strongest
    line may pass for that of the mesh at another speed.
    """
    followed = _follow_current(current, sampling_rate, nominal_hz, n_lobes, _ATTEMPTS)
    if not followed.fits or followed.reaches:
        return followed
    shaft = (n_lobes + 1) / n_lobes
    speed_hz = followed.speed_hz
    own = _follow_current(current, sampling_rate, speed_hz, n_lobes, _ATTEMPTS[:1]).evidence
    for multiple in (1 / 4, 1 / 3, 1 / 2, shaft / 2, 2 / shaft, 2, 3):
        try:
            other = _follow_current(current, sampling_rate, multiple * speed_hz, n_lobes, _ATTEMPTS[:1])
        except ValueError:  # the record does not hold that speed
            continue
        if other.evidence > _CLEARLY * own:
            return dataclasses.replace(followed, margin=-followed.margin)
    return followed


def _follow_current(
    current: Float, sampling_rate: float, nominal_hz: float, n_lobes: int, attempts: Sequence[_Attempt]
) -> FollowedSpeed:
    """Follow the shaft under the most probable control, or, where none is probable, without any."""
    record = _reduce_record(current, sampling_rate, nominal_hz, n_lobes)
    thinned, rate = record.torque, record.rate
    length = min(thinned.size, round(_SEARCHED_TURNS * n_lobes / nominal_hz * rate))
    first = (thinned.size - length) // 2
    middle = thinned[first : first + length]
    # A current of a negative mean drives the shaft too: its sensor is the other way round.
    unit = float(np.copysign(middle.std(), current.mean()))
    if unit == 0:
        return follow_speed(current, sampling_rate, nominal_hz, n_lobes)
    control = _likeliest_control(dataclasses.replace(record, torque=middle), unit)
    steady: Float = nominal_hz / rate * np.arange(thinned.size, dtype=float)
    best, start = _followed_from(steady, record, attempts[:1]), steady
    turned = None
    if control is not None:
        turned = _controlled_turns((thinned - middle.mean()) / unit, rate, nominal_hz, *control)
    if turned is not None:
        controlled = _followed_from(turned, record, attempts[:1])
        if controlled.evidence > best.evidence + _GAINED:
            best, start = controlled, turned
    if attempts[1:] and not best.fits:
        again = _followed_from(start, record, attempts[1:])
        best = max(best, again, key=attrgetter("margin"))
    return _at_samples(best, rate, current.size, sampling_rate)


def _followed_from(turned: Float, record: _Record, attempts: Sequence[_Attempt]) -> FollowedSpeed:
    """Return what ``cyclofeat.signal.speed._follow_until_fit`` finds, beginning with turns that are known."""
    angle = 2 * np.pi * turned
    even, grid = resample_by_angle(record.torque, angle, _SAMPLES_PER_TURN, record.rate)
    followed = _follow_until_fit(record.over_turns(even, _SAMPLES_PER_TURN), attempts)
    slow = followed.angle
    # Beyond the grid it goes on at its mean rate.
    slope = (slow[-1] - slow[0]) / (grid[-1] - grid[0])
    before, behind = min(angle[0], grid[0]), max(angle[-1], grid[-1])
    ends = [slow[0] - slope * (grid[0] - before)], [slow[-1] + slope * (behind - grid[-1])]
    at, values = np.r_[before, grid, behind], np.concatenate([ends[0], slow, ends[1]])
    return dataclasses.replace(followed, angle=np.asarray(np.interp(angle, at, values)))


def _controlled_turns(
    driving: Float, sampling_rate: float, nominal_hz: float, gain: float, integral_s: float
) -> Float | None:
    """Return turns under a control by a current in its deviations; None where the shaft all but stops."""
    lag = controlled_lag(driving, sampling_rate, integral_s)
    turned = nominal_hz * (np.arange(driving.size) / sampling_rate - gain * lag)
    return turned if np.diff(turned).min() > _SLOWEST * nominal_hz / sampling_rate else None


def _likeliest_control(record: _Record, unit: float) -> tuple[float, float] | None:
    """Return gain and integral time of the control that the lines make most probable, None for no control."""
    driving = (record.torque - record.torque.mean()) / unit

    @functools.cache
    def evidence(gain: float, integral_s: float) -> float:
        if not (0 <= gain <= _HIGHEST_GAIN and _SHORTEST <= integral_s <= _LONGEST):
            return -np.inf
        turned = _controlled_turns(driving, record.rate, record.speed, gain, integral_s)
        if turned is None:
            return -np.inf
        # Straight lines suffice to compare controls.
        grid = np.arange(turned[0], turned[-1], 1 / _COMPARED_PER_TURN)
        even = np.interp(grid, turned, record.torque)
        return _speed_course(record.over_turns(even, _COMPARED_PER_TURN), _COARSE)[1]

    pairs = [(float(gain), integral_s) for gain in _GAINS for integral_s in _TIMES]
    gain, integral_s = max(pairs, key=lambda pair: evidence(*pair))
    # Climb to the maximum beside it.
    step, ratio = _GAIN_STEP, _TIME_STEP
    for _ in range(_HALVINGS):
        while True:
            # The last two keep the answer to slow changes, gain times time.
            beside = [
                (gain + step, integral_s), (gain - step, integral_s), (gain, integral_s * ratio),
                (gain, integral_s / ratio), (gain * ratio, integral_s / ratio),
                (gain / ratio, integral_s * ratio),
            ]  # fmt: skip
            highest = max(beside, key=lambda place: evidence(*place))
            if evidence(*highest) <= evidence(gain, integral_s):
                break
            gain, integral_s = highest
        step, ratio = step / 2, ratio**0.5
    likely = evidence(gain, integral_s) > evidence(0.0, _TIMES[0]) + _GAINED
    return (gain, integral_s) if likely else None
