"""Angle of the input shaft from the torque, or the current of its motor, alone: around a speed or any."""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from operator import attrgetter
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import PchipInterpolator
from scipy.signal import lfilter, periodogram

from cyclofeat.signal import lobes
from cyclofeat.signal.lobes import comb_prominence, highest_frequency, lobe_frequency, reduce_rate
from cyclofeat.signal.orders import at_every_sample, mean_speed, resample_by_angle
from cyclofeat.signal.windows import Float

#: Largest relative deviation from the stated speed that is followed. At 1/16 below it, the lines of the input
#: shaft would be taken for those of the lobes.
FOLLOWED_TOLERANCE = 0.055
#: Lowest and highest speed, in turns per second, that is searched where none is stated.
SEARCHED_HZ = (100 / 60, 1500 / 60)

# Lobe lines that are followed: below them the load drifts, and a low rate holds fewer, but at least those of
# the mesh. Lines of the shaft of a sound disc are even, as its wheels are half a turn apart.
_FIRST_LOBE_LINE, _LAST_LOBE_LINE, _FIRST_SHAFT_LINE, _LAST_SHAFT_LINE = 3, 36, 4, 30
# Highest lobe line that is used where these do not suffice, and to tell at which speed the lines fit: at low
# speeds the disturbance of a worn lobe is short, and the lower lines are lost in the drift of the load.
_HIGHEST_LOBE_LINE = 88
_MESH_LINE, _SHAFT_LINE = (0.2, 0.3, 0.5), (0.45, 0.35, 0.2)  # shares as those of LOBE_LINE
# Over the angle, with room for the highest line; in time, six times that line.
_SAMPLES_PER_TURN, _DENSE = 256, 560
_SAMPLES_AT_ONCE = 2**17  # of blocks, whose spectra are taken
# Speeds, as multiples of the one found, at which the disc may really turn. What follows are differences of
# log probabilities for one output turn. A disc fits if it is more probable than discs at these multiples, a
# worn one by _WORN and a sound one by _SOUND, and than noise, by _THAN_NONE. A worn one must also be more
# probable than the sound disc whose even shaft lines lie at its lobe lines, by _THAN_ALIKE, and a sound one
# by its mesh lines alone than noise, by _MESH. The even lines of a sound disc are also lobe lines of a worn
# one at another speed: as that has more, it may be more probable by _RICHER. A sound disc also has the lobe
# lines of the output's pins. Of a second speed that an attempt tries, the margin must be more than _SECOND.
_MULTIPLES, _BESIDE = (1 / 4, 1 / 3, 1 / 2, *range(2, 13)), (3 / 4, 4 / 5, 5 / 4, 4 / 3)
_WORN, _SOUND, _THAN_ALIKE, _THAN_NONE, _MESH, _RICHER, _SECOND = 6.0, 1.0, 3.0, 8.0, 3.0, 18.0, 3.0
# dB by which the first mesh line of a sound disc stands out, at a stated speed and in a search; a lobe line
# rarely does. In a current it may be lost, but there its even lines are below this share of the mean; a worn
# disc at more speeds, those _BESIDE, may be more probable by _WORN, and at 15/16 by _RICHER.
_MESH_DB, _SEARCHED_MESH_DB, SMALL = 3.0, 8.0, 0.04
# Of a search: output turns, at most, in the middle of the record; share of the tolerance that reaches the
# next start; relative difference of speeds that are the same; evidence below which none is taken; share of
# the most evidence from which another is possible too, and multiple of it that lines of no disc have at most.
_SEARCHED_TURNS, _OVERLAPPING, _SAME, _LEAST, _POSSIBLE, _MORE = 2.0, 0.8, 0.01, 0.15, 0.5, 1.5


@dataclass(frozen=True)
class _Pass:
    """One pass of the search: turns of its blocks, their hop, and the factors of the speed that are tried.

    A change of the speed from block to block costs its square, in units of ``change``. Lobe lines within
    ``apart`` orders of one of the shaft are not used, unless they are those of the mesh.
    """

    turns: float
    hop: float
    tolerance: float
    step: float
    change: float
    apart: float = 0.0


# Passes of the search, and whether they are by all lobe lines up to the highest instead of by the lower ones.
_Attempt: TypeAlias = tuple[tuple[_Pass, ...], bool]

_COARSE = _Pass(turns=6, hop=2, tolerance=FOLLOWED_TOLERANCE, step=1e-3, change=4e-3)
_STEADY = _Pass(turns=14, hop=3.5, tolerance=FOLLOWED_TOLERANCE, step=2.5e-4, change=1e-3)
_FINE = _Pass(turns=9, hop=3, tolerance=8e-3, step=2.5e-4, change=1e-3)
_LAST = _Pass(turns=14, hop=3.5, tolerance=2e-3, step=1e-4, change=2e-4)
_ATTEMPTS = (((_COARSE, _FINE, _LAST), False), ((_COARSE, _FINE, _LAST), True), ((_STEADY, _LAST), True))

# Gains that are tried: changes of the speed, as shares of the mean one, that one standard deviation of the
# current answers. Integral times of the control in s. From the best of these pairs on, steps of gain and time
# are taken as long as less power lies between the lines, then halved.
_GAINS, _TIMES = (0.0, 0.02, 0.04, 0.08, 0.12, 0.16, 0.2, 0.28), (0.006, 0.012, 0.024)
_HIGHEST_GAIN, _SHORTEST, _LONGEST = 0.4, 0.004, 0.06
# Share of the stated speed below which no shaft under control falls.
_SLOWEST = 0.1
_GAIN_STEP, _TIME_STEP, _HALVINGS = 0.02, 2**0.5, 3
# A line of the motor, such as order 30, may lie 2/15 of an order beside a lobe line, and would draw the speed
# to itself: such lobe lines are left out, and blocks are long enough to tell the others from it.
_SHARP = _Pass(turns=14, hop=3.5, tolerance=8e-3, step=2.5e-4, change=1e-3, apart=0.15)
_SHARPER = replace(_LAST, apart=0.15)
_MOTOR_ATTEMPTS = (
    ((_COARSE, _SHARP, _SHARPER), False),
    ((_COARSE, _SHARP, _SHARPER), True),
    ((replace(_STEADY, apart=0.15), _SHARPER), True),
)
# Samples per input turn by which controls are compared, first order that is, and half the width of a line in
# bins; by how much the logarithm of the power between the lines must fall.
_COMPARED_PER_TURN, _FIRST_COMPARED, _LINE_WIDTH, _GAINED = 160, 1.5, 1.7, 0.03


@dataclass(frozen=True)
class _Record:
    """Torque at a rate, around a speed in turns per unit of time, and the last lines that are followed.

    ``highest_lobe`` is the highest lobe line held. A sound disc's mesh line stands out by ``mesh_db``, and it
    has lines of ``pins``; or, in a current, its even lines are ``small``. Others turn at ``multiples``.
    """

    torque: Float
    rate: float
    speed: float
    n_lobes: int
    last_lobe: int
    last_shaft: int
    highest_lobe: int
    mesh_db: float = _MESH_DB
    small: float | None = None
    pins: Sequence[int] = lobes.OUTPUT_PINS
    multiples: Sequence[float] = _MULTIPLES

    @property
    def turns(self) -> float:
        return self.torque.size / self.rate * self.speed

    def over_turns(self, torque: Float, per_turn: int) -> _Record:
        """Return the record on equal steps of the shaft's angle."""
        return replace(self, torque=torque, rate=per_turn, speed=1.0)


@dataclass(frozen=True)
class FollowedSpeed:
    """Angle of the input shaft as the lines of the torque have it, in rad at the samples, from 0 on.

    ``evidence`` is the logarithm of how much more probable the lines are at this speed than noise, per input
    turn; it compares speeds followed by the same lobe lines. ``margin`` is the difference of log
    probabilities, for one output turn, between a disc at this speed and the most probable one at another (a
    quarter, a third, a half, 2 to 12 times it, and where the lines look alike), less the least difference
    that counts. It is also negative where the lines are the shaft's alone; minus infinity where the torque
    holds no lines, or the speed lies at the end of the range. ``reaches`` is true for the lines of a worn
    disc: they reach beyond what the shaft of a sound disc has at (n_lobes + 1) / (2 n_lobes) of the speed,
    where its even lines are in the places of the lobe lines.
    """

    angle: Float
    speed_hz: float
    evidence: float
    margin: float
    reaches: bool

    @property
    def fits(self) -> bool:
        """Whether the lines are those of a disc at this speed, and not at another."""
        return self.margin > 0


def follow_speed(
    torque: Float, sampling_rate: float, nominal_hz: float, n_lobes: int = 15, *, searched: bool = False
) -> FollowedSpeed:
    """Follow the speed of the input shaft by the lobe, mesh and shaft lines of the torque.

    Blocks of the record vote for the factor by which the speed differs from the nominal one; the course of
    the speed is the most probable path through the votes if it changes slowly. Two further passes repeat this
    on the torque over the angle found so far, with longer blocks and finer steps. If the lines found are not
    those of a disc (``fits``), the search is repeated with lobe lines up to the 88th, in blocks of six turns,
    then of 14. The first attempt that fits is returned, or else the one with the largest margin, or the last
    where none has any lines. Each attempt also tries whether its lines are the even shaft lines of a sound
    disc that turns faster (16/15 of the speed for 15 lobes).

    ``nominal_hz`` is the stated speed in turns per second; the true one may lie up to 5.5 % beside it, and
    wander. If it is one of many that are ``searched``, only the first attempt is made, and a sound disc needs
    a clearer mesh line. ``ValueError`` if the record is shorter than six turns of the input, or the sampling
    rate in Hz does not hold the first line of the mesh.
    """
    record = _reduce_record(torque, sampling_rate, nominal_hz, n_lobes)
    attempts: Sequence[_Attempt] = _ATTEMPTS
    if searched:
        record, attempts = replace(record, mesh_db=_SEARCHED_MESH_DB, pins=()), _ATTEMPTS[:1]
    return _at_samples(_follow_until_fit(record, attempts), record.rate, torque.size, sampling_rate)


def _reduce_record(torque: Float, sampling_rate: float, nominal_hz: float, n_lobes: int) -> _Record:
    """Return the record at the rate in Hz that the lines need which it holds; or raise."""
    turns = torque.size / sampling_rate * nominal_hz
    if turns < _COARSE.turns:
        raise ValueError(
            f"torque is too short to follow the speed: it holds {turns:.3g} turns of the input at the stated "
            f"speed, {_COARSE.turns:g} are needed"
        )
    highest = highest_frequency(nominal_hz, n_lobes, min(n_lobes, _LAST_LOBE_LINE), _COARSE.tolerance)
    if highest > sampling_rate / 2:
        raise ValueError(
            f"sampling_rate must be at least {2 * highest:.4g} Hz to follow {60 * nominal_hz:.4g} RPM by the "
            f"torque alone, got {sampling_rate:g} Hz"
        )
    orders = min(sampling_rate / 2 / (nominal_hz * (1 + FOLLOWED_TOLERANCE)), _SAMPLES_PER_TURN / 2)
    held = min(_HIGHEST_LOBE_LINE, int(orders / lobe_frequency(1.0, n_lobes)))
    (thinned,), rate = reduce_rate(torque[np.newaxis], sampling_rate, _DENSE * nominal_hz)
    last = min(_LAST_LOBE_LINE, held), min(_LAST_SHAFT_LINE, int(orders))
    return _Record(thinned, rate, nominal_hz, n_lobes, *last, held)


def _at_samples(followed: FollowedSpeed, rate: float, n_samples: int, sampling_rate: float) -> FollowedSpeed:
    """Return what was found with the angle at all samples, from that at those that were kept."""
    step, kept = sampling_rate / rate, followed.angle - followed.angle[0]
    # To the last samples, behind the last of those that were kept, the shaft turns on.
    marks = np.append(kept, 2 * kept[-1] - kept[-2])
    angle = at_every_sample(n_samples, step * np.arange(marks.size), marks)
    return replace(followed, angle=angle, speed_hz=float(mean_speed(angle, sampling_rate)))


def search_speed(torque: Float, sampling_rate: float, n_lobes: int = 15) -> list[FollowedSpeed]:
    """Follow the input shaft at the speeds from 100 to 1,500 RPM that the torque allows, the likeliest first.

    :func:`follow_speed` starts at speeds whose tolerances overlap, in the middle of the record. Of those
    where the lines are those of a disc (``fits``), the one with the most evidence is meant, if it also fits
    the whole record. Others with at least half as much are possible too: those that fit, and some that look
    alike. For 15 lobes these are 15/8 of the speed, where a worn disc's lobe lines would be taken for the
    even lines of a sound one's shaft; 8/15, the other way round, unless the lobe lines reach further
    (``reaches``); and 16/15, where all lines of a motor's shaft would be taken for lobe lines. None fits
    where the record does not hold an output turn or the sampling rate not the first line of the mesh.
    """
    duration, tolerance = torque.size / sampling_rate, FOLLOWED_TOLERANCE
    mesh = highest_frequency(1.0, n_lobes, min(n_lobes, _LAST_LOBE_LINE), tolerance)
    # What is found may lie by the tolerance below the lowest start and above the highest.
    fewest_turns = max(n_lobes, _COARSE.turns / (1 - tolerance))
    lowest = max(SEARCHED_HZ[0], fewest_turns / duration)
    highest = min(SEARCHED_HZ[1], sampling_rate / 2 / mesh / (1 + tolerance))
    if lowest > highest:
        return []
    near = _OVERLAPPING * tolerance
    n_steps = math.ceil(math.log(highest / lowest) / math.log((1 + near) / (1 - near)))
    followed = []
    for nominal in np.geomspace(lowest, highest, n_steps + 1).tolist():
        middle = _cut_middle(torque, _SEARCHED_TURNS * n_lobes / nominal * sampling_rate)
        followed.append(follow_speed(middle, sampling_rate, nominal, n_lobes, searched=True))
    clear = sorted((one for one in followed if one.evidence >= _LEAST), key=lambda one: -one.evidence)
    shaft = (n_lobes + 1) / n_lobes  # the speed whose shaft has its lines at this one's lobe lines
    # Lobe lines that reach further leave out the sound disc whose shaft has its lines at the lowest of them.
    beyond = [one.speed_hz * shaft / 2 for one in clear if one.fits and one.reaches]
    clear = [one for one in clear if not _is_one_of(one.speed_hz, beyond)]
    best = next((one for one in clear if one.fits), None)
    if best is None or clear[0].evidence > _MORE * best.evidence:
        return []
    alike = [best.speed_hz * factor for factor in (shaft, 2 / shaft, shaft / 2)]
    possible = [best]
    for one in clear:
        new = not _is_one_of(one.speed_hz, [other.speed_hz for other in possible])
        likely = one.evidence >= _POSSIBLE * best.evidence
        if new and likely and (one.fits or _is_one_of(one.speed_hz, alike)):
            possible.append(one)
    whole = [follow_speed(torque, sampling_rate, one.speed_hz, n_lobes) for one in possible]
    return whole if whole[0].fits else []


def _cut_middle(torque: Float, length: float) -> Float:
    """Return so many samples in the middle of a record, or all if it holds fewer."""
    n_samples = min(torque.size, round(length))
    first = (torque.size - n_samples) // 2
    return torque[first : first + n_samples]


def _is_one_of(speed: float, others: Sequence[float]) -> bool:
    return any(abs(speed / other - 1) <= _SAME for other in others)


def _follow_until_fit(record: _Record, attempts: Sequence[_Attempt]) -> FollowedSpeed:
    """Follow the speed in a record with no more samples than needed: by the first attempt that fits."""
    long_enough = [one for one in attempts if record.turns >= one[0][0].turns] or attempts[:1]
    tried: list[FollowedSpeed] = []
    last = {True: record.highest_lobe, False: record.last_lobe}
    for passes, last_lobe in dict.fromkeys((passes, last[every_line]) for passes, every_line in long_enough):
        tried.append(_follow_passes(replace(record, last_lobe=last_lobe), passes))
        if tried[-1].fits:
            break
    # Where no lines stand out, the last attempt, by the longest blocks, errs least.
    return max(reversed(tried), key=attrgetter("margin"))


def _follow_passes(record: _Record, passes: Sequence[_Pass]) -> FollowedSpeed:
    """Follow the speed by one attempt's passes, as far as the record is long enough for their blocks.

    A speed at the end of the range does not fit. If the one found does not, the speed is tried at which its
    lobe lines would be lines of the shaft.
    """
    finer = [one for one in passes[1:] if one.turns <= record.turns]
    course, evidence = _speed_course(record, passes[0])
    at = np.interp(np.arange(record.torque.size) / record.rate, *course) * record.speed
    angle = 2 * np.pi * cumulative_trapezoid(at, dx=1 / record.rate, initial=0)
    for one in finer:
        angle, evidence = _refine_angle(record, angle, one)
    followed = _followed_speed(record, angle, evidence)
    beside = passes[0].tolerance - passes[0].step
    if abs(followed.speed_hz / record.speed - 1) > beside:
        followed = replace(followed, margin=-math.inf)  # the lines may be those of a speed beyond
    # A sound disc's shaft lines may be followed as lobe lines, at 15/16 of the speed for 15 lobes.
    shaft = (record.n_lobes + 1) / record.n_lobes
    if followed.fits or not finer or shaft * followed.speed_hz > (1 + beside) * record.speed:
        return followed
    other = _followed_speed(record, *_refine_angle(record, shaft * angle, finer[-1]))
    return other if other.margin > _SECOND else followed


def _refine_angle(record: _Record, angle: Float, refining: _Pass) -> tuple[Float, float]:
    """Return the angle by a pass on the torque over one that is nearly right, and the evidence per turn."""
    even, grid = resample_by_angle(record.torque, angle, _SAMPLES_PER_TURN, record.rate)
    (position, factor), evidence = _speed_course(record.over_turns(even, _SAMPLES_PER_TURN), refining)
    smooth = PchipInterpolator(position + grid[0] / (2 * np.pi), factor, extrapolate=False)
    low, high = smooth.x[0], smooth.x[-1]
    factors = smooth(np.clip(angle / (2 * np.pi), low, high))
    return cumulative_trapezoid(factors, angle, initial=0), evidence


def _followed_speed(record: _Record, angle: Float, evidence: float) -> FollowedSpeed:
    margin, reaches = _fit_discs(record, angle)
    return FollowedSpeed(angle, float(mean_speed(angle, record.rate)), evidence, margin, reaches)


def _fit_discs(record: _Record, angle: Float) -> tuple[float, bool]:
    """Return margin and reach of the lines over an angle, as of :class:`FollowedSpeed`.

    At a wrong speed, lines lie between those expected (a half, a third or a quarter is true), or only every
    second or further one is there (a multiple is true): discs at these speeds explain more or waste less.
    """
    turned, _ = resample_by_angle(record.torque, angle, _SAMPLES_PER_TURN, record.rate)
    n_lobes = record.n_lobes
    length = min(turned.size, n_lobes * _SAMPLES_PER_TURN)
    windows = turned[: turned.size // length * length].reshape(-1, length)
    at_lines = (n_lobes + 1) / (2 * n_lobes)
    # The mesh lines of a sound disc at 1 / n_lobes of the speed are the lobe lines themselves.
    multiples = (1.0, at_lines, 1 / at_lines, *(one for one in record.multiples if one * n_lobes != 1))
    # Lobe lines of a disc at each multiple, then even lines of its shaft, as numbers of lobe lines at 1.
    numbers: list[Float] = []
    for multiple in multiples:
        last = math.ceil(record.highest_lobe / multiple) + 1
        for part in (np.arange(1.0, last), _even_lines(2 * last, n_lobes)):
            held = multiple * part
            numbers.append(held[(held >= _FIRST_LOBE_LINE) & (held <= record.highest_lobe)])
    one, every = np.ones(1), np.concatenate(numbers)
    batches = _in_batches(windows, length)
    powers = [comb_prominence(batch, _SAMPLES_PER_TURN, 1.0, one, every, n_lobes)[:, 0] for batch in batches]
    ends = np.cumsum([part.size for part in numbers])[:-1]
    parts = np.split(np.concatenate(powers), ends, axis=1)
    discs: list[_Disc] = []
    for place, multiple in enumerate(multiples):
        lobe, even = parts[2 * place : 2 * place + 2]
        places, even_numbers = numbers[2 * place : 2 * place + 2]
        lines = np.round(places / multiple)
        is_mesh = lines % n_lobes == 0
        of_mesh = lobes.log_ratio(lobe, _MESH_LINE).mean(axis=0)
        of_lobes = np.where(is_mesh, of_mesh, lobes.log_ratio(lobe, lobes.LOBE_LINE).mean(axis=0))
        of_even = lobes.log_ratio(even, _SHAFT_LINE).mean(axis=0)
        n_usual = np.sum(even_numbers <= multiple * _LAST_SHAFT_LINE * n_lobes / (n_lobes + 1))
        shaft, every_even = (max(lobes.sum_to_last_line(part), 0.0) for part in (of_even[:n_usual], of_even))
        mesh = lobes.sum_to_last_line(of_mesh[is_mesh])
        of_pins = (of_lobes[(lines % n == 0) & ~is_mesh] for n in (() if discs else record.pins))
        rest = mesh + max(map(lobes.sum_to_last_line, of_pins), default=0.0)
        worn = lobes.sum_to_last_line(of_lobes) + shaft
        discs.append(_Disc(*map(float, (worn, rest + shaft, rest + max(shaft, every_even), mesh))))
    this, like_worn, like_sound, *others = discs
    worn, sound = this.worn, this.sound
    reaches = worn > max(sound, like_worn.sound + _THAN_ALIKE)
    if max(worn, sound) <= _THAN_NONE:
        return -math.inf, reaches
    if worn > this.quiet:  # at least as large as sound
        other = max(max(one.worn, one.sound) for one in others)
        # The shaft of a sound disc has lines at the lowest n_lobes places: a low rate may hold no others.
        like = like_worn.sound if record.highest_lobe > n_lobes else -math.inf
        return min(worn - other - _WORN, worn - like - _THAN_ALIKE), reaches
    # Lines of the shaft alone may be lobe lines of a worn disc at another speed. With little noise they reach
    # as far as those: the mesh line then tells which disc it is. In a current their size does.
    mesh_db, even_rms = shaft_lines(windows, _SAMPLES_PER_TURN, n_lobes)
    if record.small is not None:
        *elsewhere, slower = (one.worn for one in others)  # the last at 15/16 of the speed for 15 lobes
        likely = max(like_worn.worn + _SOUND, max(elsewhere) - _WORN, slower - _RICHER)
        margin = this.quiet - likely if even_rms < record.small else -math.inf
        return min(margin, this.mesh - _MESH), reaches
    others = [like_worn._replace(sound=-math.inf, quiet=-math.inf), *others]
    richer = like_sound.worn - _RICHER
    margin = sound - max(richer, _SOUND + max(max(one.worn, one.sound) for one in others))
    if sound >= richer or mesh_db > record.mesh_db:
        margin = max(margin, this.quiet - max(max(one.worn, one.quiet) for one in others) - _SOUND)
    return min(margin, this.mesh - _MESH), reaches


def shaft_lines(windows: Float, per_turn: float, n_lobes: int) -> tuple[float, float]:
    """Return by how many dB the first mesh line is above even ones beside it, and the rms of even ones.

    ``windows`` are over the angle, with so many samples ``per_turn`` of the input. Lines that these do not
    hold have no power.
    """
    mesh, turns = n_lobes + 1, windows.shape[1] / per_turn
    spectrum = periodogram(windows, per_turn, "hann")[1].mean(axis=0) / turns
    bins = np.round(np.arange(max(_LAST_SHAFT_LINE, mesh + 2) + 1) * turns).astype(int)
    spectrum = np.append(spectrum, np.zeros(bins[-1] + 2))
    power = spectrum[bins - 1] + spectrum[bins] + spectrum[bins + 1] + np.finfo(float).tiny
    level = 10 * np.log10(power)
    of_even = np.sqrt(power[_FIRST_SHAFT_LINE : _LAST_SHAFT_LINE + 1 : 2].sum())
    return float(level[mesh] - level[[mesh - 2, mesh + 2]].mean()), float(of_even)


def _even_lines(last: int, n_lobes: int) -> Float:
    """Return the even lines of the shaft but those of the mesh, as numbers of lobe lines."""
    even = np.arange(_FIRST_SHAFT_LINE, last + 1, 2)
    return np.asarray(even[even % (n_lobes + 1) != 0] * n_lobes / (n_lobes + 1))


class _Disc(NamedTuple):
    """Log probability ratios over noise, for one output turn, of the lines that a disc has at some speed."""

    worn: float  # lobe lines, and even lines of the shaft up to the last that noise usually leaves
    sound: float  # lines of the mesh and, at the speed itself, of the output's pins, and the same even lines
    quiet: float  # those but, if these are more probable, all even lines
    mesh: float


def _speed_course(record: _Record, search: _Pass) -> tuple[tuple[Float, Float], float]:
    """Return times and factors of the speed, and the evidence per turn."""
    torque, rate, speed = record.torque, record.rate, record.speed
    length = min(round(search.turns / speed * rate), torque.size)
    hop = search.hop / speed * rate
    n_blocks = max(1, math.floor((torque.size - length) / hop) + 1)
    starts = np.linspace(0, torque.size - length, n_blocks).round().astype(int)
    factors = np.arange(1 - search.tolerance, 1 + search.tolerance + search.step / 2, search.step)
    every = np.lib.stride_tricks.sliding_window_view(torque, length)
    votes = np.concatenate(
        [_speed_votes(record, every[batch], factors, search.apart) for batch in _in_batches(starts, length)]
    )
    # Overlapping blocks repeat the same evidence.
    votes *= min(1.0, search.hop / search.turns)
    # The most probable path through the votes (Viterbi), with changes in steps of the grid.
    steps = np.arange(factors.size)
    cost = 0.5 * ((steps[:, np.newaxis] - steps) / (search.change / search.step)) ** 2
    best, back = votes[0].copy(), np.zeros(votes.shape, dtype=int)
    for k in range(1, n_blocks):
        reached = best[np.newaxis, :] - cost
        back[k] = reached.argmax(axis=1)
        best = votes[k] + reached[steps, back[k]]
    path = np.full(n_blocks, best.argmax())
    for k in range(n_blocks - 1, 0, -1):
        path[k - 1] = back[k, path[k]]
    times = (starts + length / 2) / rate
    evidence = float(votes[np.arange(n_blocks), path].sum() / (torque.size / rate * speed))
    # Refine the path between the steps of the grid by a parabola through three votes.
    inner = np.clip(path, 1, factors.size - 2)
    rows = np.arange(len(votes))
    left, middle, right = votes[rows, inner - 1], votes[rows, inner], votes[rows, inner + 1]
    bend = left - 2 * middle + right
    offset = np.divide(left - right, 2 * bend, out=np.zeros_like(bend), where=bend < 0)
    offset = np.where(path == inner, np.clip(offset, -0.5, 0.5), path - inner)
    course = np.asarray(factors[inner] + offset * (factors[1] - factors[0]))
    if n_blocks == 1:
        return (np.array([0.0, torque.size / rate]), np.repeat(course, 2)), evidence
    return (times, course), evidence


def _in_batches(rows: NDArray[Any], length: int) -> Iterator[NDArray[Any]]:
    """Yield some rows at a time: spectra of all would take many times the memory of a long record."""
    size = max(1, _SAMPLES_AT_ONCE // length)
    return (rows[first : first + size] for first in range(0, len(rows), size))


def _speed_votes(record: _Record, blocks: Float, factors: Float, apart: float) -> Float:
    """Log-likelihood ratio of the lines over noise in blocks of a record, shape (n_blocks, n_factors)."""
    n_lobes = record.n_lobes
    lobe = np.arange(_FIRST_LOBE_LINE, record.last_lobe + 1)
    mesh = lobe % n_lobes == 0
    beside = np.abs((lobe + n_lobes // 2) % n_lobes - n_lobes // 2) / n_lobes
    lobe, mesh = lobe[mesh | (beside > apart)], mesh[mesh | (beside > apart)]
    numbers = np.concatenate([lobe, _even_lines(record.last_shaft, n_lobes)])
    power = comb_prominence(blocks, record.rate, record.speed, factors, numbers, n_lobes)
    n = lobe.size
    ratios = lobes.log_ratio(power[..., :n][..., ~mesh], lobes.LOBE_LINE).sum(axis=-1)
    ratios += lobes.log_ratio(power[..., :n][..., mesh], _MESH_LINE).sum(axis=-1)
    return np.asarray(ratios + lobes.log_ratio(power[..., n:], _SHAFT_LINE).sum(axis=-1))


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
    :func:`follow_speed`, whose arguments and errors it has. The current tells these changes, because the
    control of the speed sets it in answer to them (:func:`controlled_lag`). Gain and integral time are those
    that leave the least power between the lines. The rest is followed as in a torque, in longer blocks.
    """
    record = _reduce_record(current, sampling_rate, nominal_hz, n_lobes)
    multiples = (*_MULTIPLES, *_BESIDE, n_lobes / (n_lobes + 1))
    record = replace(record, small=SMALL * abs(float(current.mean())), multiples=multiples)
    thinned, rate = record.torque, record.rate
    followed = _followed_from(nominal_hz / rate * np.arange(thinned.size, dtype=float), record)
    # A current of a negative mean drives the shaft too: its sensor is the other way round.
    unit = float(np.copysign(thinned.std(), current.mean()))
    if unit == 0:
        return _at_samples(followed, rate, current.size, sampling_rate)
    driving, steady = (thinned - thinned.mean()) / unit, followed.angle / (2 * np.pi)
    length = _SEARCHED_TURNS * n_lobes / nominal_hz * rate
    control = _likeliest_control(record, *(_cut_middle(one, length) for one in (thinned, driving, steady)))
    turned = control and _controlled_turns(driving, steady, record, *control)
    if turned is not None:
        again = _followed_from(turned, record)
        followed = again if again.fits else max(followed, again, key=attrgetter("margin"))
    return _at_samples(followed, rate, current.size, sampling_rate)


def _followed_from(turned: Float, record: _Record) -> FollowedSpeed:
    """Return what :func:`_follow_until_fit` finds, beginning with turns that are known."""
    angle = 2 * np.pi * turned
    even, grid = resample_by_angle(record.torque, angle, _SAMPLES_PER_TURN, record.rate)
    followed = _follow_until_fit(record.over_turns(even, _SAMPLES_PER_TURN), _MOTOR_ATTEMPTS)
    slow = followed.angle
    # Beyond the grid it goes on at its mean rate.
    slope = (slow[-1] - slow[0]) / (grid[-1] - grid[0])
    before, behind = min(angle[0], grid[0]), max(angle[-1], grid[-1])
    values = np.r_[slow[0] - slope * (grid[0] - before), slow, slow[-1] + slope * (behind - grid[-1])]
    return replace(followed, angle=np.asarray(np.interp(angle, np.r_[before, grid, behind], values)))


def _controlled_turns(
    driving: Float, steady: Float, record: _Record, gain: float, integral_s: float
) -> Float | None:
    """Return turns under a control by a current in its deviations; None where the shaft all but stops.

    ``steady`` are the turns of a shaft that is followed without a control.
    """
    turned = steady - gain * record.speed * controlled_lag(driving, record.rate, integral_s)
    return turned if np.diff(turned).min() > _SLOWEST * record.speed / record.rate else None


def _likeliest_control(
    record: _Record, current: Float, driving: Float, steady: Float
) -> tuple[float, float] | None:
    """Return gain and integral time of the control with the clearest lines, None for no control."""

    @functools.cache
    def between(gain: float, integral_s: float) -> float:
        if not (0 <= gain <= _HIGHEST_GAIN and _SHORTEST <= integral_s <= _LONGEST):
            return np.inf
        turned = _controlled_turns(driving, steady, record, gain, integral_s)
        if turned is None:
            return np.inf
        # Straight lines suffice to compare controls.
        even = np.interp(np.arange(turned[0], turned[-1], 1 / _COMPARED_PER_TURN), turned, current)
        return _power_between_lines(record.over_turns(even, _COMPARED_PER_TURN))

    gain, integral_s = min(itertools.product(_GAINS, _TIMES), key=lambda pair: between(*pair))
    # Descend to the minimum beside it.
    step, ratio = _GAIN_STEP, _TIME_STEP
    for _ in range(_HALVINGS):
        while True:
            # The last two keep the answer to slow changes, gain times time.
            beside = [
                (gain + step, integral_s), (gain - step, integral_s), (gain, integral_s * ratio),
                (gain, integral_s / ratio), (gain * ratio, integral_s / ratio),
                (gain / ratio, integral_s * ratio),
            ]  # fmt: skip
            lowest = min(beside, key=lambda pair: between(*pair))
            if between(*lowest) >= between(gain, integral_s):
                break
            gain, integral_s = lowest
        step, ratio = step / 2, ratio**0.5
    return (gain, integral_s) if between(gain, integral_s) < between(0.0, _TIMES[0]) - _GAINED else None


def _power_between_lines(record: _Record) -> float:
    """Return the logarithm of the mean power between lines of lobes and shaft, over that with the lines."""
    orders, power = periodogram(record.torque, record.rate, "hann")
    lobe = lobe_frequency(1.0, record.n_lobes)
    apart = np.minimum(*(np.abs(orders - line * np.round(orders / line)) for line in (1.0, lobe)))
    held = (orders > _FIRST_COMPARED) & (orders < lobe * record.last_lobe)
    between = power[held & (apart > _LINE_WIDTH * orders[1])]
    # Lines of few turns leave nothing between them, and a dead sensor has no power.
    return float(np.log(between.mean() / power[held].mean())) if between.any() else 0.0
