"""Recordings, and samples that arrive in pieces, cut into windows."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import KW_ONLY, dataclass, field
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from scipy.signal import resample_poly

from cyclofeat._base.checks import not_negative, number, positive, truth_value, whole
from cyclofeat._base.quantities import number_of
from cyclofeat.recordings.recording import Recording, common_n_lobes, common_quantity, list_recordings
from cyclofeat.signal.lobes import anti_alias
from cyclofeat.signal.orders import resample_by_angle, samples_at
from cyclofeat.signal.windows import Bool, Float, Int

# Windows of a recording, their starts in s and in rad.
Cut = tuple[Float, Float, Float]

#: Samples per input turn that hold all 44 lobe lines of a count.
SAMPLES_PER_TURN = 128
#: Output turns of a lobe counter's window: a recording of whole turns at the nominal speed holds as many
#: windows although its true speed is a per cent lower.
WINDOW_TURNS = 0.98

# Output turns of the shortest window in which lobes can be told from run-out, roughly.
_LEAST_TURNS = 0.5
# Assemblies of one nominal speed differ by a per cent or two (motor slip); 400 and 500 RPM by a fifth.
_SPEED_TOLERANCE = 0.05
# Two statements of one rate or speed, as they come back from text files.
_SAME = 1e-6
# Rounding must not cost the grid point, in rad, at which a record begins or ends.
ROUNDING = 1e-9
# Samples per turn that are left to the interpolation, in multiples of the grid's.
_DENSE = 2.5
# Grid points by which a record is continued at either end, where the filters settle.
_MARGIN = 44.8
# Grid points beside a window of a stream that decide about it: more than the filters reach.
_BESIDE = 64
_RELATIVE = "give up absolute lobe positions with angle_is_absolute=False"


@dataclass(frozen=True, eq=False)
class WindowSet:
    """Windows of one or more recordings, with their labels.

    Attributes
    ----------
    X : ndarray of shape (n_windows, n_samples)
        Torque in Nm.
    y : ndarray of shape (n_windows,) or None
        Number of worn lobes (int64); None where a recording does not state it.
    groups : ndarray of shape (n_windows,) or None
        Assembly, as int64 or str; None where a recording does not state it.
    sampling_rate : float
        Samples per second (Hz), or per input turn where the windows are resampled by angle.
    recording : ndarray of shape (n_windows,)
        Index of the recording, from 0.
    start_s : ndarray of shape (n_windows,)
        Start of the window within its recording, in s.
    start_angle : ndarray of shape (n_windows,)
        Angle of the input shaft at the start, in rad; NaN where the recording has no angle.
    absolute : ndarray of shape (n_windows,)
        Whether that angle is absolute (bool).
    worn_lobes : tuple of length n_windows
        Worn lobes of each window, counted from 0; None where not known.
    """

    X: Float = field(repr=False)
    y: Int | None = field(repr=False)
    groups: NDArray[Any] | None = field(repr=False)
    sampling_rate: float
    recording: Int = field(repr=False)
    start_s: Float = field(repr=False)
    start_angle: Float = field(repr=False)
    absolute: Bool = field(repr=False)
    worn_lobes: tuple[tuple[int, ...] | None, ...] = field(repr=False)

    def __len__(self) -> int:
        """Number of windows."""
        return int(self.X.shape[0])

    def part(self, rows: Int) -> WindowSet:
        """Return the windows with these numbers, which count from 0.

        Parameters
        ----------
        rows : ndarray of int, shape (n_rows,)

        Returns
        -------
        WindowSet
        """
        columns: dict[str, Any] = {
            name: x[rows] for name, x in vars(self).items() if isinstance(x, np.ndarray)
        }
        worn_lobes = tuple(self.worn_lobes[row] for row in rows.tolist())
        return dataclasses.replace(self, worn_lobes=worn_lobes, **columns)

    def worn_table(self, n_lobes: int) -> Bool | None:
        """Return which lobes are worn in each window.

        Parameters
        ----------
        n_lobes : int

        Returns
        -------
        ndarray of bool, shape (n_windows, n_lobes), or None
            None where a window does not state its worn lobes or has no absolute angle.
        """
        if not self.absolute.all() or None in self.worn_lobes:
            return None
        table = np.zeros((len(self), n_lobes), dtype=bool)
        for row, lobes in zip(table, self.worn_lobes, strict=True):
            row[list(lobes or ())] = True
        return table


@dataclass(frozen=True)
class Windower:
    """Cut recordings into windows of whole output turns.

    Run-out (once per input turn) and a worn lobe (16/15 times) can be told apart over one whole output turn
    only: 15 input turns, 1.8 s at 500 RPM.

    Parameters
    ----------
    output_turns : float, default 1
        Length of a window in output turns, at least 0.5.
    duration : float, optional
        Length of a window in s instead, e.g. the papers' 0.6 s.
    input_speed_hz : float, optional
        Nominal input speed in turns per second, from which the length of windows of native samples follows.
        Default: the ``speed_rpm`` that the recordings share.
    reduction : int, optional
        Input turns per output turn: the number of lobes. Default: the ``n_lobes`` that the recordings share.
    skip_s : float, default 0.0
        Time to leave out at the beginning of each recording (ramp and settling), in s.
    overlap : float, default 0.0
        Share of a window that the next one repeats, from 0 up to, but not including, 1.
    samples_per_turn : int, optional
        Samples per input turn, on equal steps of the shaft's angle; a recording must hold as many, and more
        are low-pass filtered first. Default: native samples, which are equal steps of the angle of a shaft
        that turns steadily at the stated speed.
    remove_mean : bool, default False
        Whether to subtract the mean torque of each recording, and to change the sign of the rest where it is
        negative: conventions differ between rigs.

    Notes
    -----
    With ``samples_per_turn`` a window holds exactly ``reduction * output_turns`` input turns, whatever the
    speed does, and recordings of several speeds and rates can be mixed. Where a recording's angle is absolute
    and ``output_turns`` a whole number, every window starts at a whole multiple of ``reduction`` input turns
    of that angle: all windows then start at the same lobe, and lobe positions in them are absolute. This
    costs up to one output turn at the beginning of the record, and needs hops of whole output turns
    (``overlap``). Other windows start right after ``skip_s``. The filters take a record to go on beyond its
    ends as its point reflection, which the first and last 45 samples of its windows may show: give a
    ``skip_s`` where that matters.

    Examples
    --------
    >>> import numpy as np
    >>> torque = 22 + np.random.default_rng(0).normal(size=102_400)
    >>> recording = Recording(torque, 25_600, assembly="A1", defect_count=3, speed_rpm=500)
    >>> X, y, groups = Windower(skip_s=0.3).transform([recording])
    >>> X.shape, y.tolist(), groups.tolist()
    ((2, 46080), [3, 3], ['A1', 'A1'])
    """

    output_turns: float = 1
    _: KW_ONLY
    duration: float | None = None
    input_speed_hz: float | None = None
    reduction: int | None = None
    skip_s: float = 0.0
    overlap: float = 0.0
    samples_per_turn: int | None = None
    remove_mean: bool = False

    def __post_init__(self) -> None:
        if positive("output_turns", self.output_turns) < _LEAST_TURNS:
            raise ValueError(
                f"output_turns must be at least {_LEAST_TURNS}, as shorter windows cannot tell lobes from "
                f"run-out, got {self.output_turns!r}: give the papers' shorter windows as duration=..."
            )
        for name in ("reduction", "samples_per_turn"):
            if getattr(self, name) is not None:
                whole(name, getattr(self, name), 2)
        for name in ("duration", "input_speed_hz"):
            if getattr(self, name) is not None:
                positive(name, getattr(self, name))
        not_negative("skip_s", self.skip_s)
        if not 0 <= number("overlap", self.overlap) < 1:
            raise ValueError(f"overlap must lie in [0, 1), got {self.overlap!r}")
        truth_value("remove_mean", self.remove_mean)
        if self.duration is not None and (self.output_turns != 1 or self.samples_per_turn is not None):
            raise ValueError(
                f"duration and output_turns or samples_per_turn exclude each other, got {self.duration} s, "
                f"{self.output_turns} output turns and samples_per_turn = {self.samples_per_turn}"
            )

    def get_params(self, deep: bool = True) -> dict[str, Any]:
        """Return the parameters by name, as scikit-learn's estimators do.

        Parameters
        ----------
        deep : bool, default=True
            Without effect.

        Returns
        -------
        dict
        """
        return {parameter.name: getattr(self, parameter.name) for parameter in dataclasses.fields(self)}

    def set_params(self, **params: Any) -> Self:
        """Set parameters, as scikit-learn's searches do; they are checked as those of a new windower.

        Parameters
        ----------
        **params

        Returns
        -------
        self
        """
        for name, value in vars(dataclasses.replace(self, **params)).items():
            object.__setattr__(self, name, value)
        return self

    def transform(self, recordings: Recording | Iterable[Recording]) -> tuple[Float, Int, NDArray[Any]]:
        """Windows with the labels that training and evaluation need.

        Parameters
        ----------
        recordings : Recording or iterable of Recording
            Each with ``assembly`` and ``defect_count``.

        Returns
        -------
        X : ndarray of shape (n_windows, n_samples)
            Torque in Nm.
        y : ndarray of shape (n_windows,)
            Number of worn lobes.
        groups : ndarray of shape (n_windows,)
            Assembly that each window came from.
        """
        records = list_recordings(recordings)
        remedies = {
            "assembly": "windows of one assembly resemble each other, so folds that part them score a "
            "counter on machines that it has learned. Give assembly=..., the same for all recordings of one "
            "assembly (or use .windows(recordings), where nothing is to be evaluated)",
            "defect_count": "give defect_count=... or worn_lobes=... (or use .windows(recordings).X, which "
            "needs no labels)",
        }
        for index, recording in enumerate(records):
            for name, remedy in remedies.items():
                if getattr(recording, name) is None:
                    raise ValueError(f"{recording_label(index, recording)} has no {name}: {remedy}")
        windows = self.windows(records)
        assert windows.y is not None
        assert windows.groups is not None
        return windows.X, windows.y, windows.groups

    def windows(
        self, recordings: Recording | Iterable[Recording], angles: Iterable[Float | None] | None = None
    ) -> WindowSet:
        """Cut recordings into windows, with all that is known about each; recordings need no labels.

        Windows that touch a bad span of their recording are left out.

        Parameters
        ----------
        recordings : Recording or iterable of Recording
        angles : iterable of ndarray, optional
            Increasing angle of the input shaft in rad at the samples of each recording. Default: the angle
            of the recording.

        Returns
        -------
        WindowSet
        """
        records = [recording.for_counting() for recording in list_recordings(recordings)]
        common_quantity(records)
        if self.reduction is None:
            return dataclasses.replace(self, reduction=common_n_lobes(records)).windows(records, angles)
        _assemblies(records)  # a mixture is an error before any work
        if angles is None:
            angles = [recording.input_angle(self.reduction) for recording in records]
        if self.samples_per_turn is None:
            rate, length = self._rate_and_length(records)
        else:
            rate, length = float(self.samples_per_turn), self._angle_length()
        cut_record = self._cut_samples if self.samples_per_turn is None else self._cut_angle
        cuts = []
        for index, (recording, angle) in enumerate(zip(records, angles, strict=True)):
            try:
                cut = cut_record(recording, angle, length)
                if recording.bad_spans:
                    cut = self._leave_out_bad_spans(recording, angle, cut)
                reject_constant_windows(recording, cut)
            except ValueError as error:
                if len(records) == 1:
                    raise
                raise ValueError(f"{recording_label(index, recording)}: {error}") from error
            cuts.append(cut)
        return window_set(records, cuts, rate)

    def _leave_out_bad_spans(self, recording: Recording, angle: Float | None, cut: Cut) -> Cut:
        """Return the windows of a recording that touch none of its bad spans."""
        windows, start_s, start_angle = cut
        stop_s = start_s + windows.shape[1] / recording.sampling_rate
        if self.samples_per_turn is not None and angle is not None:
            length = windows.shape[1], self.samples_per_turn
            stop_s = ends_by_angle(start_angle, *length, angle, recording.sampling_rate)
        good, rounding = np.ones(len(windows), dtype=bool), 1e-6 / recording.sampling_rate
        for start, stop in recording.bad_spans:
            good &= (start_s + rounding >= stop) | (stop_s - rounding <= start)
        if not good.any():
            raise ValueError(f"the recording has no window outside its bad spans: {self._length_text()}")
        return windows[good], start_s[good], start_angle[good]

    def _rate_and_length(self, records: Sequence[Recording]) -> tuple[float, int]:
        """Return the sampling rate that the records share, and the samples of a window of native samples."""
        rate = records[0].sampling_rate
        for index, recording in enumerate(records):
            if not math.isclose(recording.sampling_rate, rate, rel_tol=_SAME):
                first, other = recording_label(0, records[0]), recording_label(index, recording)
                raise ValueError(
                    f"recordings must share one sampling_rate, got {rate:g} Hz in {first} and "
                    f"{recording.sampling_rate:g} Hz in {other}: resample them, or give samples_per_turn=..."
                )
        speed = self._nominal_speed(records)
        if self.duration is None:
            assert speed is not None
            return rate, max(1, round(self.output_turns * self._input_turns / speed * rate))
        if speed is not None:
            # A lobe passes the load once in z_s / (z_s + 1) input turns: less shows no lobe at all.
            lobe = self._input_turns / (self._input_turns + 1) / speed
            if self.duration < lobe:
                raise ValueError(
                    f"duration = {self.duration:g} s is shorter than one lobe period, {lobe:.4g} s at "
                    f"{speed:.4g} Hz input speed: one output turn is {self._input_turns / speed:.4g} s"
                )
        length = round(self.duration * rate)
        if length < 2:
            raise ValueError(f"duration = {self.duration:g} s holds {length} samples at {rate:g} Hz, not 2")
        return rate, length

    def _nominal_speed(self, records: Sequence[Recording]) -> float | None:
        """Nominal input speed in turns per second: the argument, else what the recordings share."""
        nominal = self.input_speed_hz
        tolerance = _SAME if nominal is None else _SPEED_TOLERANCE
        for index, recording in enumerate(records):
            speed = recording.input_speed_hz
            if speed is None and self.input_speed_hz is None and self.duration is None:
                raise ValueError(
                    f"{recording_label(index, recording)} has no nominal speed, from which the length of an "
                    "output turn follows: give Windower(input_speed_hz=...) or Recording(speed_rpm=...)"
                )
            nominal = speed if nominal is None else nominal
            if speed is not None and nominal is not None and abs(speed / nominal - 1) > tolerance:
                raise ValueError(
                    f"{recording_label(index, recording)} runs at speed_rpm = {speed * 60:g}, windows are "
                    f"meant for {nominal * 60:g} RPM: give the nominal Windower(input_speed_hz=...) where "
                    "speeds differ little (up to 5 %), else samples_per_turn=..."
                )
        return nominal

    def _first_sample(self, recording: Recording) -> int:
        # The tolerance keeps a skip of whole samples whole: 0.3 * 25600 = 7680.000000000001.
        return math.ceil(self.skip_s * recording.sampling_rate - 1e-6)

    def _cut_samples(self, recording: Recording, angle: Float | None, length: int) -> Cut:
        """Cut windows of so many native samples."""
        first, rate = self._first_sample(recording), recording.sampling_rate
        available = recording.n_samples - first
        if available < length:
            raise ValueError(
                f"the recording is too short: it lasts {recording.duration:.4g} s ({recording.n_samples} "
                f"samples), {self._length_text()} needs {(first + length) / rate:.4g} s ({first + length} "
                "samples)"
            )
        starts = first + self._window_starts(available, length, grid=1)
        windows = np.lib.stride_tricks.sliding_window_view(recording.torque, length)[starts]
        return windows, starts / rate, np.full(starts.size, np.nan) if angle is None else angle[starts]

    def _cut_angle(self, recording: Recording, angle: Float | None, length: int) -> Cut:
        """Cut windows of so many points on equal steps of the angle."""
        if angle is None:
            raise ValueError(
                "the recording has no angle, which samples_per_turn needs: give Recording(angle=...) from a "
                "tachometer, or leave samples_per_turn out"
            )
        skipped, rate = self._first_sample(recording), recording.sampling_rate
        if skipped >= recording.n_samples - 1:
            raise ValueError(
                f"the recording is too short: it lasts {recording.duration:.4g} s, of which "
                f"skip_s = {self.skip_s:g} s leaves nothing"
            )
        # One turn more than asked for, so that the filters settle in what is skipped anyway.
        begin = int(np.searchsorted(angle, angle[skipped] - 2 * math.pi))
        grid = self._grid_of(recording.torque[skipped:], angle[skipped:], rate)
        torque, points = grid.resample(recording.torque[begin:], angle[begin:], rate)
        # Count in steps of the grid, so that no rounding shifts a window.
        per_turn, origin = grid.samples_per_turn, round(points[0] / grid.step)
        aligned = recording.angle_is_absolute and float(self.output_turns).is_integer()
        period = self._input_turns * per_turn if aligned else 1
        first = math.ceil(max(origin, grid.first_point(angle[skipped])) / period) * period
        available = origin + torque.size - first
        if available < length:
            turns = f"{max(available, 0) / per_turn / self._input_turns:.4g} output turns"
            if aligned:
                turns += f" from the first whole one of its absolute angle (record one more, or {_RELATIVE})"
            raise ValueError(
                f"the recording is too short: it lasts {recording.duration:.4g} s and holds {turns}, too few "
                f"for {self._length_text()}"
            )
        starts = first - origin + self._window_starts(available, length, grid=period)
        windows = np.lib.stride_tricks.sliding_window_view(torque, length)[starts]
        return windows, samples_at(points[starts], angle) / rate, points[starts]

    def at_lowest_rate(self, recording: Recording) -> Recording:
        """Return a recording with a tachometer at the lowest sampling rate that its windows need.

        Many recordings then fit into memory. Their windows are those of the whole ones, up to rounding. The
        windower needs ``samples_per_turn``.

        Parameters
        ----------
        recording : Recording
            With an angle.

        Returns
        -------
        Recording
        """
        angle = recording.input_angle(self.reduction)
        if angle is None or recording.angle is None:
            raise ValueError("recording must have an angle")
        grid = AngleGrid.for_angle(angle, self._samples_per_turn)
        if grid.decimation < 2:
            return recording
        return recording.replace(
            torque=grid.decimate(recording.torque, angle),
            angle=recording.angle[:: grid.decimation],
            sampling_rate=recording.sampling_rate / grid.decimation,
        )

    def _grid_of(self, torque: Float, angle: Float, sampling_rate: float) -> AngleGrid:
        """Return the grid of windows over the angle, with the filters that a record needs."""
        per_turn, density = self._samples_per_turn, mean_density(angle)
        if density < per_turn:
            raise ValueError(
                f"sampling_rate must be at least {per_turn * sampling_rate / density:.5g} Hz at "
                f"{60 * sampling_rate / density:.5g} RPM ({per_turn} samples per input turn), got "
                f"{sampling_rate:g} Hz: take fewer samples_per_turn, or train a model at this rate "
                f"(cyclofeat train --sampling-rate {sampling_rate:g})"
            )
        grid = AngleGrid.for_angle(angle, per_turn)
        if not self.remove_mean:
            return grid
        level = float(torque.mean())
        return dataclasses.replace(grid, level=level, sign=-1.0 if level < 0 else 1.0)

    def _window_starts(self, available: int, length: int, *, grid: int) -> Int:
        """Return the first samples of the windows, all on multiples of ``grid``."""
        hop = max(1, round(length * (1 - self.overlap)))
        if hop % grid:
            raise ValueError(
                f"overlap = {self.overlap:g} of {self.output_turns:g} output turns starts windows between "
                "whole output turns, but the recording's angle is absolute: choose an overlap of whole "
                f"output turns, or {_RELATIVE}"
            )
        return np.arange(0, available - length + 1, hop, dtype=np.int64)

    @property
    def _input_turns(self) -> int:
        """Input turns per output turn, which :meth:`windows` has settled."""
        assert self.reduction is not None
        return self.reduction

    @property
    def _samples_per_turn(self) -> int:
        assert self.samples_per_turn is not None
        return self.samples_per_turn

    def _angle_length(self) -> int:
        """Return the number of samples of a window over the angle."""
        return round(self.output_turns * self._input_turns * self._samples_per_turn)

    def _length_text(self) -> str:
        length = number_of(self.output_turns, "output turn")
        if self.duration is not None:
            length = f"{self.duration:g} s"
        return f"a window of {length}" + (f" after skip_s = {self.skip_s:g} s" if self.skip_s else "")


def lobe_windower(n_lobes: int | None = None, samples_per_turn: int = SAMPLES_PER_TURN) -> Windower:
    """Return the windower of lobe counters: windows over the angle of :data:`WINDOW_TURNS` output turns."""
    return Windower(WINDOW_TURNS, reduction=n_lobes, samples_per_turn=samples_per_turn, remove_mean=True)


def window_set(records: Sequence[Recording], parts: Sequence[Cut], sampling_rate: float) -> WindowSet:
    """Return the windows of several recordings, each cut already, with all that is known about them."""
    origin = np.repeat(np.arange(len(records), dtype=np.int64), [part[0].shape[0] for part in parts])
    counts = [recording.defect_count for recording in records]
    groups = _assemblies(records)
    X, start_s, start_angle = map(np.concatenate, zip(*parts, strict=True))
    return WindowSet(
        X=X,
        y=None if None in counts else np.asarray(counts, dtype=np.int64)[origin],
        groups=None if groups is None else groups[origin],
        sampling_rate=sampling_rate,
        recording=origin,
        start_s=start_s,
        start_angle=start_angle,
        absolute=np.array([recording.angle_is_absolute for recording in records])[origin],
        worn_lobes=tuple(records[i].worn_lobes for i in origin.tolist()),
    )


def ends_by_angle(
    start_angle: Float, n_samples: int, samples_per_turn: float, angle: Float, sampling_rate: float
) -> Float:
    """Return the times in s at which windows over an angle end; the angle is in rad, at a sampling rate."""
    turned = 2 * math.pi * n_samples / samples_per_turn
    return samples_at(start_angle + turned, angle) / sampling_rate


def recording_label(index: int, recording: Recording) -> str:
    """Return how messages name one of several recordings."""
    meta = recording.meta or {}
    known = {"file": meta.get("file"), "run": recording.run, "assembly": recording.assembly}
    stated = ", ".join(f"{key} {value!r}" for key, value in known.items() if value is not None)
    return f"recording {index}" + (f" ({stated})" if stated else "")


def _assemblies(records: Sequence[Recording]) -> NDArray[Any] | None:
    """Assembly of each recording."""
    assemblies = [recording.assembly for recording in records]
    if None in assemblies:
        return None
    if len({type(assembly) for assembly in assemblies}) > 1:
        raise TypeError(
            "assemblies must be all text or all whole numbers, got both: 1 and '1' may be the same"
        )
    return np.asarray(assemblies)


def reject_constant_windows(recording: Recording, cut: Cut, begin_s: float = 0.0) -> None:
    """Raise ``ValueError`` if a window of a recording, which begins at ``begin_s``, is constant."""
    windows, start_s, _ = cut
    constant = np.flatnonzero(np.ptp(windows, axis=1) == 0)
    if constant.size:
        start = float(start_s[constant[0]])
        value = recording.torque[math.ceil(start * recording.sampling_rate - 1e-6)]
        raise ValueError(
            f"the recording is constant ({value:g} {recording.unit}) over a whole window, from "
            f"{begin_s + start:.4g} s on: nothing can be diagnosed from it (sensor dead, not connected, or "
            "at the end of its range?)"
        )


@dataclass(frozen=True)
class AngleGrid:
    """Filters that bring torque to equal steps of an angle."""

    samples_per_turn: int  # one of them at angle zero
    decimation: int  # of the sampling rate, before the torque is interpolated
    level: float = 0.0  # subtracted from the torque
    sign: float = 1.0  # by which the rest is multiplied

    @classmethod
    def for_angle(cls, angle: Float, samples_per_turn: int) -> AngleGrid:
        """Return the grid for a record of this angle in rad, shape (n,)."""
        return cls(samples_per_turn, max(1, int(mean_density(angle) / (samples_per_turn * _DENSE))))

    @property
    def step(self) -> float:
        """Distance of two grid points in rad."""
        return 2 * math.pi / self.samples_per_turn

    def first_point(self, angle: float) -> int:
        """Return the number of the first grid point from an angle in rad on."""
        return math.ceil((angle - ROUNDING) / self.step)

    def resample(self, torque: Float, angle: Float, sampling_rate: float) -> tuple[Float, Float]:
        """Return torque at the grid points within the angle, and these angles in rad, each of shape (m,)."""
        margin = self._n_reflected(angle)
        # One long array after the other: a record may fill a good part of the memory.
        longer = torque - self.level
        longer *= self.sign
        longer = self._low_pass(_reflect_ends(longer, margin))
        turning = _reflect_ends(angle, margin)[:: self.decimation].copy()
        even, grid = resample_by_angle(
            longer, turning, self.samples_per_turn, sampling_rate / self.decimation
        )
        inside = (grid >= angle[0] - ROUNDING) & (grid <= angle[-1] + ROUNDING)
        return even[inside], grid[inside]

    def decimate(self, torque: Float, angle: Float) -> Float:
        """Return torque at every ``decimation``-th sample, low-passed."""
        margin = self._n_reflected(angle)
        level = float(torque.mean())
        longer = self._low_pass(_reflect_ends(torque - level, margin))
        return longer[margin // self.decimation :][: angle[:: self.decimation].size] + level

    def _n_reflected(self, angle: Float) -> int:
        """Return the samples by which a record is continued, a multiple of the decimation."""
        longest = (angle.size - 1) // self.decimation
        wanted = math.ceil(_MARGIN / self.samples_per_turn * mean_density(angle) / self.decimation)
        return min(wanted, longest) * self.decimation

    def _low_pass(self, values: Float) -> Float:
        if self.decimation == 1:
            return values
        return np.asarray(resample_poly(values, 1, self.decimation, window=anti_alias(self.decimation)))


def mean_density(angle: Float) -> float:
    """Return the mean number of samples per turn of a record of this angle in rad."""
    return angle.size / (float(np.ptp(angle)) / (2 * np.pi))


def _reflect_ends(values: Float, margin: int) -> Float:
    """Continue a curve by its point reflection at either end: neither value nor slope has a step there."""
    before = 2 * values[0] - values[margin:0:-1]
    return np.concatenate([before, values, 2 * values[-1] - values[-2 : -margin - 2 : -1]])


class WindowStream:
    """Cut samples that arrive in pieces into the windows of a :class:`~cyclofeat.Windower`.

    A window is cut when 64 samples of the grid behind it have arrived. With it come a recording of its
    samples and those beside it, at whose first sample ``start_s`` is 0, and the number of samples before it.
    Its samples do not depend on the sizes of the pieces. They are those of :meth:`Windower.windows` up to
    rounding while the speed is steady; where the speed varies, that method may choose another rate of its
    filters by the whole record (errors of 0.1 %). Samples of at most one window, those beside it and the last
    piece are kept.

    The windower needs ``samples_per_turn`` and ``reduction``; windows follow one another from the first
    sample on. ``labels`` are other parameters of the :class:`~cyclofeat.Recording` of each window.
    """

    def __init__(self, windower: Windower, sampling_rate: float, **labels: Any) -> None:
        if windower.skip_s or windower.overlap:
            raise ValueError(f"windower must have no skip_s or overlap for a stream, got {windower}")
        self._windower = windower
        self._rate = sampling_rate
        self._labels = labels
        self._per_turn = windower._samples_per_turn
        self._length = windower._angle_length()
        self._grid = AngleGrid(self._per_turn, 0)  # filters follow from the first window
        self._pieces: list[tuple[Float, Float]] = []
        self._first_sample = 0  # of those kept
        self._first_point: int | None = None  # of the next window

    def push(self, torque: Float, angle: Float) -> Iterator[tuple[WindowSet, Recording, int]]:
        """Take the next samples and input angles (rad), and yield the windows that they complete.

        A window that is constant, or of too few samples, raises ``ValueError`` and is left out.
        """
        if angle.size:
            if self._first_point is None:
                self._first_point = self._grid.first_point(angle[0])
            self._pieces.append((torque, angle))
        beside = _BESIDE * self._grid.step
        while self._pieces and self._last_angle() >= (last := self._end_of_window() + beside):
            angles = self._join_pieces()[1]
            yield self._next_window(int(np.searchsorted(angles, last)) + 1)

    def finish(self) -> Iterator[tuple[WindowSet, Recording, int]]:
        """Yield the windows that are whole without what may have come behind them."""
        while self._pieces and self._last_angle() + ROUNDING >= self._end_of_window():
            yield self._next_window(self._join_pieces()[1].size)

    def _last_angle(self) -> float:
        return float(self._pieces[-1][1][-1])

    def _end_of_window(self) -> float:
        assert self._first_point is not None
        return (self._first_point + self._length - 1) * self._grid.step

    def _join_pieces(self) -> tuple[Float, Float]:
        if len(self._pieces) > 1:
            torque, angle = (np.concatenate(parts) for parts in zip(*self._pieces, strict=True))
            self._pieces = [(torque, angle)]
        return self._pieces[0]

    def _next_window(self, stop: int) -> tuple[WindowSet, Recording, int]:
        """Cut the next window from the samples before ``stop``."""
        torque, angle = (values[:stop].copy() for values in self._join_pieces())
        if not self._grid.decimation:
            self._grid = self._windower._grid_of(torque, angle, self._rate)
        first, first_sample = self._first_point, self._first_sample
        assert first is not None
        self._first_point = first + self._length
        # Forget what no later window needs; the filter takes every so many samples from the first on.
        kept_torque, kept_angle = self._join_pieces()
        needed = (self._first_point - _BESIDE) * self._grid.step
        before = max(0, int(np.searchsorted(kept_angle, needed)) - 1)
        before -= (first_sample + before) % self._grid.decimation
        if before > 0:
            self._pieces = [(kept_torque[before:].copy(), kept_angle[before:].copy())]
            self._first_sample += before
        recording = Recording(torque, self._rate, angle=angle, **self._labels)
        values, grid = self._grid.resample(torque, angle, self._rate)
        begin = first - round(grid[0] / self._grid.step)
        start = grid[begin : begin + 1]
        cut = values[np.newaxis, begin : begin + self._length], samples_at(start, angle) / self._rate, start
        reject_constant_windows(recording, cut, first_sample / self._rate)
        return window_set([recording], [cut], float(self._per_turn)), recording, first_sample
