"""One torque record with its labels, and its cutting into windows."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from cyclofeat.orders import input_angle_from_disc, resample_by_angle

Float = NDArray[np.float64]
Int = NDArray[np.int64]
Label = str | int

# Assemblies of one nominal speed differ by a per cent or two (motor slip); 400 and 500 RPM by a fifth.
_SPEED_TOLERANCE = 0.05
# Two statements of one rate or speed, as they come back from text files.
_SAME = 1e-6


@dataclass(frozen=True, eq=False)
class Recording:
    """One record of output torque, with what is known about it.

    Parameters
    ----------
    torque : array_like of shape (n,)
        Output torque in Nm; real, finite, at least two samples. Copied, then read-only.
    sampling_rate : float
        Samples per second, in Hz.
    angle : array_like of shape (n,), optional
        Shaft angle in rad at the same moments, strictly increasing (unwrapped). A disc's angle may also fall;
        see Notes.
    angle_of : {"input", "disc"}, default "input"
        Shaft that the tachometer was on.
    angle_is_absolute : bool, default False
        Whether the angle's zero is known: for the input, cam 0 at pin 0 with the discs in their rest position
        (theta_1 = -pi/15); for the disc, the tip of lobe 0 of wheel 0 at pin 0 (theta_1 = 0). Where it is
        not, positions of lobes are relative.
    assembly : str or int, optional
        The gearbox as assembled: all recordings of one assembly belong together in cross-validation.
    run : str or int, optional
        Name of this recording.
    defect_count : int, optional
        Number of distinct worn lobes. Follows from ``worn_lobes`` where it is not given.
    worn_lobes : sequence of int, optional
        Worn lobes, counted from 0.
    n_lobes : int, default 15
        Lobes of a disc: ``worn_lobes`` lie below it, and ``defect_count`` is at most as large.
    speed_rpm : float, optional
        Nominal speed of the input shaft in turns per minute.
    load_nm : float, optional
        Nominal load torque in Nm.
    source : str, optional
        Where the record comes from, e.g. "measured", "simulated", "surrogate".
    meta : mapping of str, optional
        Anything else that is known. Copied; {} where it is not given.

    Raises
    ------
    TypeError
        If a parameter is of the wrong type.
    ValueError
        If a parameter lies outside its range or contradicts another. The message names it.

    Notes
    -----
    While the input turns counter-clockwise (phi rises), the disc turns clockwise, 15 times slower:
    theta_1 = -(phi + pi)/15. A disc angle that falls is taken for theta_1 itself, one that rises for
    -theta_1, the count of a tachometer in the disc's own running direction. :meth:`input_angle` converts
    both.

    Examples
    --------
    >>> import numpy as np
    >>> torque = 22 + 0.1 * np.sin(np.arange(51_200))
    >>> recording = Recording(torque, 25_600, assembly="A1", worn_lobes=(0, 4), speed_rpm=500)
    >>> recording.duration, recording.n_samples, recording.defect_count
    (2.0, 51200, 2)
    """

    torque: Float = field(repr=False)
    sampling_rate: float
    _: KW_ONLY
    angle: Float | None = field(default=None, repr=False)
    angle_of: Literal["input", "disc"] = "input"
    angle_is_absolute: bool = False
    assembly: Label | None = None
    run: Label | None = None
    defect_count: int | None = None
    worn_lobes: tuple[int, ...] | None = None
    n_lobes: int = 15
    speed_rpm: float | None = None
    load_nm: float | None = None
    source: str | None = None
    meta: Mapping[str, Any] | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        checked: dict[str, Any] = {
            "torque": _samples("torque", self.torque),
            "sampling_rate": _positive("sampling_rate", self.sampling_rate, "Hz"),
            "angle_is_absolute": _flag("angle_is_absolute", self.angle_is_absolute),
            "assembly": _label("assembly", self.assembly),
            "run": _label("run", self.run),
            "n_lobes": _whole("n_lobes", self.n_lobes, 2),
            "source": None if self.source is None else _text("source", self.source),
            "meta": _meta(self.meta),
        }
        if self.angle_of not in ("input", "disc"):
            raise ValueError(f"angle_of must be 'input' or 'disc', got {self.angle_of!r}")
        if self.speed_rpm is not None:
            checked["speed_rpm"] = _positive("speed_rpm", self.speed_rpm, "turns per minute of the input")
        if self.load_nm is not None:
            checked["load_nm"] = _number("load_nm", self.load_nm, "Nm")
        checked["worn_lobes"], checked["defect_count"] = _defects(
            self.worn_lobes, self.defect_count, checked["n_lobes"]
        )
        for name, value in checked.items():
            object.__setattr__(self, name, value)
        if self.angle is not None:
            object.__setattr__(self, "angle", self._checked_angle())
        elif self.angle_is_absolute:
            raise ValueError("angle_is_absolute must be False where there is no angle, got True")

    def _checked_angle(self) -> Float:
        angle = _samples("angle", self.angle)
        if angle.size != self.torque.size:
            raise ValueError(
                f"angle must have torque's length, got {angle.size} for {self.torque.size} samples"
            )
        steps = np.diff(angle)
        if self.angle_of == "disc" and angle[-1] < angle[0]:
            steps, direction = -steps, "fall"
        else:
            direction = "rise"
        if not np.all(steps > 0):
            where = int(np.argmax(steps <= 0))
            raise ValueError(
                f"angle must {direction} strictly, in rad; got {angle[where]:.6g} at sample {where} and "
                f"{angle[where + 1]:.6g} at sample {where + 1} (an angle that starts again at each turn: "
                "numpy.unwrap)"
            )
        if self.input_speed_hz is not None:
            # Too slow may be a start from rest; too fast is a wrong unit, or the wrong shaft (no disc turns
            # at a fifth of the input's speed).
            limit = self.input_speed_hz * (2 if self.angle_of == "input" else 0.2)
            speed = float(np.median(steps)) * self.sampling_rate / (2 * math.pi)
            if speed > limit:
                raise ValueError(
                    f"angle must agree with speed_rpm: it turns {speed:.4g} times per second (median), the "
                    f"input at {self.speed_rpm:g} RPM {self.input_speed_hz:.4g} times; is it in rad, and is "
                    f"angle_of = {self.angle_of!r} right?"
                )
        return angle

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Recording):
            return NotImplemented
        return all(_alike(getattr(self, f.name), getattr(other, f.name)) for f in dataclasses.fields(self))

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        for name in ("torque", "angle"):
            if state[name] is not None:
                # Pickles forget it.
                state[name].flags.writeable = False

    @classmethod
    def from_run(cls, run: Any, /, *, with_angle: bool = True, **labels: Any) -> Recording:
        """Recording of a simulated run.

        Parameters
        ----------
        run : object
            Result of a simulation with the attributes ``torque_out`` (Nm) and ``input_angle`` (rad) of shape
            (n,), ``sampling_rate`` (Hz), ``defects`` (``defect_count``, ``worn_lobes``) and ``gearbox``
            (``input_speed`` in rad/s, ``load_torque`` in Nm).
        with_angle : bool, default True
            Whether to keep the input angle, which is absolute. False: a recording without a tachometer.
        **labels
            Any other parameter of :class:`Recording`; those given here replace the run's own.

        Returns
        -------
        Recording
            With ``source="simulated"`` where no other is given. Where lobes are removed, ``defect_count``
            counts them too; ``worn_lobes`` is then None, since removed lobes are not worn ones, and ``meta``
            holds both as ``"worn_lobes"`` and ``"removed_lobes"``.

        Examples
        --------
        >>> from types import SimpleNamespace
        >>> run = SimpleNamespace(
        ...     torque_out=[21.9, 22.1, 22.0], sampling_rate=25_600, input_angle=[0.0, 0.002, 0.004],
        ...     defects=SimpleNamespace(defect_count=1, worn_lobes=(3,)),
        ...     gearbox=SimpleNamespace(input_speed=52.36, load_torque=22.0),
        ... )
        >>> recording = Recording.from_run(run, assembly="A1")
        >>> recording.worn_lobes, recording.source, recording.angle_is_absolute
        ((3,), 'simulated', True)
        """
        found: dict[str, Any] = {
            "defect_count": run.defects.defect_count,
            # rad/s and back leaves a residue in the last digits
            "speed_rpm": round(run.gearbox.input_speed * 60 / (2 * math.pi), 6),
            "load_nm": run.gearbox.load_torque,
            "n_lobes": getattr(run.gearbox, "n_lobes", 15),
            "source": "simulated",
        }
        removed = tuple(getattr(run.defects, "removed_lobes", ()))
        if not removed:
            found["worn_lobes"] = run.defects.worn_lobes
        elif not {"defect_count", "worn_lobes"} & labels.keys():
            positions = {"worn_lobes": list(run.defects.worn_lobes), "removed_lobes": list(removed)}
            labels["meta"] = positions | dict(labels.get("meta") or {})
        if with_angle:
            found |= {"angle": run.input_angle, "angle_of": "input", "angle_is_absolute": True}
        if "worn_lobes" in labels:
            del found["defect_count"]  # follows from the lobes, unless it is given too
        elif "defect_count" in labels:
            found.pop("worn_lobes", None)
        return cls(run.torque_out, run.sampling_rate, **(found | labels))

    @property
    def n_samples(self) -> int:
        """Number of samples."""
        return int(self.torque.size)

    @property
    def duration(self) -> float:
        """Number of samples over the sampling rate, in s."""
        return self.n_samples / self.sampling_rate

    @property
    def input_speed_hz(self) -> float | None:
        """Nominal input speed in turns per second; None where ``speed_rpm`` is not known."""
        return None if self.speed_rpm is None else self.speed_rpm / 60

    def input_angle(self, reduction: int | None = None) -> Float | None:
        """Angle phi of the input shaft, increasing.

        Parameters
        ----------
        reduction : int, optional
            Input turns per turn of the disc; used where ``angle_of`` is "disc". Default: ``n_lobes``.

        Returns
        -------
        ndarray of shape (n,) or None
            Angle in rad; None for a recording without an angle.
        """
        if self.angle is None or self.angle_of == "input":
            return self.angle
        falls = self.angle[-1] < self.angle[0]
        turns = self.n_lobes if reduction is None else reduction
        return input_angle_from_disc(self.angle if falls else -self.angle, turns)

    def replace(self, **changes: Any) -> Recording:
        """A copy with other values for the named parameters, checked anew."""
        return dataclasses.replace(self, **changes)


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
    absolute: NDArray[np.bool_] = field(repr=False)
    worn_lobes: tuple[tuple[int, ...] | None, ...] = field(repr=False)

    def __len__(self) -> int:
        """Number of windows."""
        return int(self.X.shape[0])


@dataclass(frozen=True)
class Windower:
    """Cut recordings into windows of whole output turns.

    Run-out (once per input turn) and a worn lobe (16/15 times) can be told apart over one whole output turn
    only: 15 input turns, 1.8 s at 500 RPM.

    Parameters
    ----------
    output_turns : int, default 1
        Length of a window in output turns.
    duration_s : float, optional
        Length of a window in s instead, e.g. the papers' 0.6 s.
    input_speed_hz : float, optional
        Nominal input speed in turns per second, from which the window's length follows. Default: the
        ``speed_rpm`` that the recordings share.
    reduction : int, optional
        Input turns per output turn: the number of lobes. Default: the ``n_lobes`` that the recordings share.
    skip_s : float, default 0.0
        Time to leave out at the beginning of each recording (ramp and settling), in s.
    overlap : float, default 0.0
        Share of a window that the next one repeats, from 0 up to, but not including, 1.
    remainder : {"drop", "error", "shift"}, default "drop"
        What becomes of samples at the end that do not fill a window: dropped; an error; or the last window is
        moved back so that it ends with the record (and overlaps the one before).
    angle_resample : bool, default False
        Whether to resample the torque by the recordings' angle, to equal samples per input turn; see Notes.
    samples_per_turn : int, optional
        Samples per input turn with ``angle_resample``. Default: those of the recordings at nominal speed,
        rounded down. Fewer than a recording holds are low-pass filtered first.

    Raises
    ------
    TypeError, ValueError
        If a parameter is outside its range, or two exclude each other.

    Notes
    -----
    With ``angle_resample`` a window holds exactly ``reduction * output_turns`` input turns, whatever the
    speed does, and recordings of several speeds and rates can be mixed. Where a recording's angle is
    absolute, every window starts at a whole multiple of ``reduction`` input turns of that angle: all windows
    then start at the same lobe, and lobe positions found in them are absolute. This costs up to one output
    turn at the beginning of the record, asks for hops of whole output turns (``overlap``), and
    ``remainder="shift"`` moves the last window back to the last such start, not to the record's end. A record
    without room for such a window is an error, never a window with another start. Windows of a relative angle
    start right after ``skip_s``, and so do windows cut by time, whatever the angle.

    A constant window (a sensor that is dead or not connected) is an error.

    Examples
    --------
    >>> import numpy as np
    >>> torque = 22 + np.random.default_rng(0).normal(size=102_400)
    >>> recording = Recording(torque, 25_600, assembly="A1", defect_count=3, speed_rpm=500)
    >>> X, y, groups = Windower(skip_s=0.3).transform([recording])
    >>> X.shape, y.tolist(), groups.tolist()
    ((2, 46080), [3, 3], ['A1', 'A1'])
    """

    output_turns: int = 1
    _: KW_ONLY
    duration_s: float | None = None
    input_speed_hz: float | None = None
    reduction: int | None = None
    skip_s: float = 0.0
    overlap: float = 0.0
    remainder: Literal["drop", "error", "shift"] = "drop"
    angle_resample: bool = False
    samples_per_turn: int | None = None

    def __post_init__(self) -> None:
        _whole("output_turns", self.output_turns, 1)
        if self.reduction is not None:
            _whole("reduction", self.reduction, 2)
        for name in ("duration_s", "input_speed_hz"):
            if getattr(self, name) is not None:
                _positive(name, getattr(self, name), "s" if name == "duration_s" else "Hz")
        if _number("skip_s", self.skip_s, "s") < 0:
            raise ValueError(f"skip_s must not be negative (s), got {self.skip_s!r}")
        if not 0 <= _number("overlap", self.overlap, "share of a window") < 1:
            raise ValueError(f"overlap must lie in [0, 1), got {self.overlap!r}")
        if self.remainder not in ("drop", "error", "shift"):
            raise ValueError(f"remainder must be 'drop', 'error' or 'shift', got {self.remainder!r}")
        _flag("angle_resample", self.angle_resample)
        if self.duration_s is not None and self.output_turns != 1:
            raise ValueError(
                "output_turns and duration_s exclude each other, "
                f"got {self.output_turns} output turns and {self.duration_s} s"
            )
        if self.duration_s is not None and self.angle_resample:
            raise ValueError(
                "duration_s and angle_resample exclude each other: windows resampled by angle hold whole "
                f"output turns (output_turns), got duration_s = {self.duration_s}"
            )
        if self.samples_per_turn is not None:
            _whole("samples_per_turn", self.samples_per_turn, 2)
            if not self.angle_resample:
                raise ValueError(
                    "samples_per_turn needs angle_resample=True, "
                    f"got samples_per_turn = {self.samples_per_turn} without it"
                )

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

        Raises
        ------
        TypeError, ValueError
            As for :meth:`windows`, and where a recording has no assembly or no defect count.
        """
        records = _as_list(recordings)
        for index, recording in enumerate(records):
            if recording.assembly is None:
                raise ValueError(
                    f"{_name(index, recording)} has no assembly: windows of one assembly resemble each "
                    "other, so folds that part them score a counter on machines that it has learned. Give "
                    "assembly=..., the same for all recordings of one assembly (or use .windows(recordings), "
                    "where nothing is to be evaluated)"
                )
            if recording.defect_count is None:
                raise ValueError(
                    f"{_name(index, recording)} has no defect_count: give defect_count=... or worn_lobes=... "
                    "(or use .windows(recordings).X, which needs no labels)"
                )
        found = self.windows(records)
        assert found.y is not None
        assert found.groups is not None
        return found.X, found.y, found.groups

    def windows(self, recordings: Recording | Iterable[Recording]) -> WindowSet:
        """Windows with all that is known about each; recordings need no labels.

        Parameters
        ----------
        recordings : Recording or iterable of Recording

        Returns
        -------
        WindowSet

        Raises
        ------
        TypeError
            If something else than recordings is given, or assemblies are partly text, partly numbers.
        ValueError
            If there is no recording; one is shorter than a window, constant over a window, or lacks the angle
            or nominal speed that is needed; discs have different numbers of lobes; or rates or speeds are
            mixed and the windows are cut by time.
        """
        records = _as_list(recordings)
        if self.reduction is None:
            return dataclasses.replace(self, reduction=common_n_lobes(records)).windows(records)
        groups = _groups(records)
        if self.angle_resample:
            per_turn = self._common_samples_per_turn(records)
            rate = float(per_turn)
            parts = [self._cut_by_angle(_name(i, r), r, per_turn) for i, r in enumerate(records)]
        else:
            rate = _common_rate(records, "angle_resample=True with samples_per_turn=...")
            length = self._window_length(records, rate)
            parts = [self._cut_by_time(_name(i, r), r, length) for i, r in enumerate(records)]
        origin = np.repeat(np.arange(len(records), dtype=np.int64), [part[0].shape[0] for part in parts])
        counts = [recording.defect_count for recording in records]
        return WindowSet(
            X=np.concatenate([part[0] for part in parts]),
            y=None if None in counts else np.asarray(counts, dtype=np.int64)[origin],
            groups=None if groups is None else groups[origin],
            sampling_rate=rate,
            recording=origin,
            start_s=np.concatenate([part[1] for part in parts]),
            start_angle=np.concatenate([part[2] for part in parts]),
            absolute=np.array([recording.angle_is_absolute for recording in records])[origin],
            worn_lobes=tuple(records[i].worn_lobes for i in origin),
        )

    # -- by time

    def _window_length(self, records: Sequence[Recording], rate: float) -> int:
        """Samples per window."""
        if self.duration_s is None:
            speed = self._nominal_speed(records, required=True)
            assert speed is not None
            return max(1, round(self.output_turns * self._turns / speed * rate))
        speed = self._nominal_speed(records, required=False)
        if speed is not None:
            # A lobe passes the load once in z_s / (z_s + 1) input turns: less shows no lobe at all.
            lobe = self._turns / (self._turns + 1) / speed
            if self.duration_s < lobe:
                raise ValueError(
                    f"duration_s = {self.duration_s:g} s is shorter than one lobe period, {lobe:.4g} s at "
                    f"{speed:.4g} Hz input speed: one output turn is {self._turns / speed:.4g} s"
                )
        length = round(self.duration_s * rate)
        if length < 2:
            raise ValueError(
                f"duration_s = {self.duration_s:g} s holds {length} samples at {rate:g} Hz, not 2"
            )
        return length

    def _nominal_speed(self, records: Sequence[Recording], *, required: bool) -> float | None:
        """Nominal input speed in turns per second: the argument, else what the recordings share."""
        shared, first = None, ""
        for index, recording in enumerate(records):
            name, speed = _name(index, recording), recording.input_speed_hz
            if shared is None:
                shared, first = speed, name
            if self.input_speed_hz is not None:
                if speed is not None and abs(speed / self.input_speed_hz - 1) > _SPEED_TOLERANCE:
                    raise ValueError(
                        f"{name} runs at speed_rpm = {speed * 60:g}, the windows are meant for "
                        f"input_speed_hz = {self.input_speed_hz:.4g} ({self.input_speed_hz * 60:g} RPM): use "
                        "another Windower for it, or angle_resample=True"
                    )
            elif speed is None:
                if required:
                    raise ValueError(
                        f"{name} has no nominal speed, from which the length of an output turn follows: give "
                        "Windower(input_speed_hz=...) or Recording(speed_rpm=...)"
                    )
            elif shared is not None and not math.isclose(speed, shared, rel_tol=_SAME):
                raise ValueError(
                    f"{name} runs at speed_rpm = {speed * 60:g}, {first} at {shared * 60:g}: give the "
                    "nominal Windower(input_speed_hz=...) where they differ little (up to 5 %), else use "
                    "angle_resample=True with samples_per_turn=..."
                )
        return shared if self.input_speed_hz is None else self.input_speed_hz

    def _cut_by_time(self, name: str, recording: Recording, length: int) -> tuple[Float, Float, Float]:
        """Windows, their starts in s and in rad."""
        # The tolerance keeps a skip of whole samples whole: 0.3 * 25600 = 7680.000000000001.
        first = math.ceil(self.skip_s * recording.sampling_rate - 1e-6)
        available = recording.n_samples - first
        if available < length:
            raise ValueError(
                f"{name} is too short: it lasts {recording.duration:.4g} s ({recording.n_samples} samples), "
                f"{self._described()} needs {(first + length) / recording.sampling_rate:.4g} s "
                f"({first + length} samples)"
            )
        starts = first + self._starts(name, available, length, grid=1)
        for start in starts:
            _reject_constant(name, recording, start, start + length)
        angle = recording.input_angle(self._turns)
        at = np.full(starts.size, np.nan) if angle is None else angle[starts]
        windows = np.lib.stride_tricks.sliding_window_view(recording.torque, length)[starts]
        return windows, starts / recording.sampling_rate, at

    # -- by angle

    def _common_samples_per_turn(self, records: Sequence[Recording]) -> int:
        if self.samples_per_turn is not None:
            return self.samples_per_turn
        remedy = "samples_per_turn=..."
        rate = _common_rate(records, remedy)
        speed = self.input_speed_hz
        if speed is None:
            try:
                speed = self._nominal_speed(records, required=True)
            except ValueError as error:
                raise ValueError(f"{error}; or give {remedy}") from None
        assert speed is not None
        return max(2, math.floor(rate / speed * (1 + _SAME)))

    def _cut_by_angle(self, name: str, recording: Recording, per_turn: int) -> tuple[Float, Float, Float]:
        """Windows, their starts in s and in rad."""
        angle = recording.input_angle(self._turns)
        if angle is None:
            raise ValueError(
                f"{name} has no angle, which angle_resample=True needs: give Recording(angle=...) from a "
                "tachometer, or cut by time with angle_resample=False"
            )
        skipped = math.ceil(self.skip_s * recording.sampling_rate - 1e-6)
        if skipped >= recording.n_samples - 1:
            raise ValueError(
                f"{name} is too short: it lasts {recording.duration:.4g} s, of which "
                f"skip_s = {self.skip_s:g} s leaves nothing"
            )
        # One turn more than asked for, so that the anti-alias filter settles in what is skipped anyway.
        begin = int(np.searchsorted(angle, angle[skipped] - 2 * math.pi))
        try:
            torque, grid = resample_by_angle(
                recording.torque[begin:], angle[begin:], per_turn, recording.sampling_rate
            )
        except ValueError as error:
            raise ValueError(f"{name}: {error}") from None
        # The grid holds whole multiples of the step: count in steps, so that no rounding shifts a window.
        step = 2 * math.pi / per_turn
        origin = round(grid[0] / step)
        first = max(origin, math.ceil(angle[skipped] / step - 1e-6))
        length = self.output_turns * self._turns * per_turn
        period = self._turns * per_turn if recording.angle_is_absolute else 1
        start = math.ceil(first / period) * period
        available = origin + torque.size - start
        if available < length:
            start_rule, remedy = "", ""
            if recording.angle_is_absolute:
                start_rule = f" from the first multiple of {self._turns} turns of its absolute angle on"
                remedy = (
                    "; record one output turn more, or give up absolute lobe positions with "
                    "angle_is_absolute=False"
                )
            raise ValueError(
                f"{name} is too short: it lasts {recording.duration:.4g} s and holds "
                f"{max(available, 0) / per_turn:.4g} input turns{start_rule}, {self._described()} needs "
                f"{self.output_turns * self._turns}{remedy}"
            )
        starts = start - origin + self._starts(name, available, length, grid=period)
        windows = np.lib.stride_tricks.sliding_window_view(torque, length)[starts]
        bounds = np.interp(grid[np.stack([starts, starts + length - 1])], angle, np.arange(angle.size))
        for low, high in bounds.T:
            _reject_constant(name, recording, math.ceil(low), math.floor(high) + 1)
        return windows, bounds[0] / recording.sampling_rate, grid[starts]

    # -- both

    def _starts(self, name: str, available: int, length: int, *, grid: int) -> Int:
        """First samples of the windows, all on multiples of ``grid``."""
        hop = max(1, round(length * (1 - self.overlap)))
        if hop % grid:
            raise ValueError(
                f"overlap = {self.overlap:g} of {self.output_turns} output turns starts windows between "
                f"whole output turns, but the angle of {name} is absolute: choose an overlap of whole output "
                "turns, or give up absolute lobe positions with angle_is_absolute=False"
            )
        starts = np.arange(0, available - length + 1, hop, dtype=np.int64)
        left = available - length - int(starts[-1])
        if left and self.remainder == "error":
            raise ValueError(
                f"{name} leaves {left} samples at its end that fill no window ({self._described()}): choose "
                "remainder='drop' or 'shift'"
            )
        if left >= grid and self.remainder == "shift":
            starts = np.append(starts, (available - length) // grid * grid)
        return starts

    @property
    def _turns(self) -> int:
        """Input turns per output turn, which :meth:`windows` has settled."""
        assert self.reduction is not None
        return self.reduction

    def _described(self) -> str:
        if self.duration_s is not None:
            length = f"{self.duration_s:g} s"
        else:
            length = "1 output turn" if self.output_turns == 1 else f"{self.output_turns} output turns"
            length += f" ({self.output_turns * self._turns} input turns)"
        return f"a window of {length}" + (f" after skip_s = {self.skip_s:g} s" if self.skip_s else "")


def _as_list(recordings: Recording | Iterable[Recording]) -> list[Recording]:
    given: Any = recordings
    try:
        records = [given] if isinstance(given, Recording) else list(given)
    except TypeError:
        raise TypeError(f"recordings must be Recording objects, got {type(given).__name__}") from None
    if not records:
        raise ValueError("recordings must hold at least one Recording, got none")
    for index, recording in enumerate(records):
        if not isinstance(recording, Recording):
            raise TypeError(
                f"recordings must be Recording objects, got {type(recording).__name__} at {index}"
            )
    return records


def _name(index: int, recording: Recording) -> str:
    """How messages call a recording."""
    meta = recording.meta or {}
    known = {"file": meta.get("file"), "run": recording.run, "assembly": recording.assembly}
    stated = ", ".join(f"{key} {value!r}" for key, value in known.items() if value is not None)
    return f"recording {index}" + (f" ({stated})" if stated else "")


def _common_rate(records: Sequence[Recording], remedy: str) -> float:
    rate = records[0].sampling_rate
    for index, recording in enumerate(records):
        if not math.isclose(recording.sampling_rate, rate, rel_tol=_SAME):
            raise ValueError(
                f"recordings must share one sampling_rate, got {rate:g} Hz in {_name(0, records[0])} and "
                f"{recording.sampling_rate:g} Hz in {_name(index, recording)}: resample them, or use {remedy}"
            )
    return rate


def _groups(records: Sequence[Recording]) -> NDArray[Any] | None:
    """Assembly of each recording."""
    assemblies = [recording.assembly for recording in records]
    if None in assemblies:
        return None
    if len({type(assembly) for assembly in assemblies}) > 1:
        raise TypeError(
            "assemblies must be all text or all whole numbers, got both: 1 and '1' may be the same"
        )
    return np.asarray(assemblies)


def _reject_constant(name: str, recording: Recording, start: int, stop: int) -> None:
    torque = recording.torque[start:stop]
    if torque.size and torque.min() == torque.max():
        raise ValueError(
            f"{name} is constant ({torque[0]:g} Nm) over the window that starts at "
            f"{start / recording.sampling_rate:.4g} s: nothing can be diagnosed from it (sensor dead or not "
            "connected?)"
        )


def _alike(mine: Any, theirs: Any) -> bool:
    """Whether two values of a field are the same, whatever the user's own ones may be."""
    if isinstance(mine, Mapping) and isinstance(theirs, Mapping):
        return mine.keys() == theirs.keys() and all(_alike(mine[key], theirs[key]) for key in mine)
    if isinstance(mine, np.ndarray) or isinstance(theirs, np.ndarray):
        return type(theirs) is type(mine) and np.array_equal(mine, theirs)
    return type(theirs) is type(mine) and bool(mine == theirs)


# Checks of single values. Arguments are typed loosely: these are the ones that hold users to the types.


def _samples(name: str, values: Any) -> Float:
    array = np.asarray(values)
    if array.dtype.kind not in "iuf":
        raise TypeError(f"{name} must be an array of real numbers, got dtype {array.dtype}")
    if array.ndim != 1:
        raise ValueError(f"{name} must be 1-D, got shape {array.shape}")
    if array.size < 2:
        raise ValueError(f"{name} must hold at least 2 samples, got {array.size}")
    array = array.astype(np.float64)  # a copy: what was checked must not change afterwards
    if not np.all(np.isfinite(array)):
        where = int(np.argmax(~np.isfinite(array)))
        raise ValueError(f"{name} must be finite, got {array[where]} at sample {where}")
    array.flags.writeable = False
    return array


def _number(name: str, value: Any, unit: str) -> float:
    if isinstance(value, (bool, np.bool_)) or not isinstance(value, (int, float, np.integer, np.floating)):
        raise TypeError(f"{name} must be a number ({unit}), got {value!r}")
    if not math.isfinite(value):
        raise ValueError(f"{name} must be finite ({unit}), got {value!r}")
    return float(value)


def _positive(name: str, value: Any, unit: str) -> float:
    number = _number(name, value, unit)
    if number <= 0:
        raise ValueError(f"{name} must be positive ({unit}), got {value!r}")
    return number


def _whole(name: str, value: Any, least: int) -> int:
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)):
        raise TypeError(f"{name} must be a whole number, got {value!r}")
    if value < least:
        raise ValueError(f"{name} must be at least {least}, got {value!r}")
    return int(value)


def _flag(name: str, value: Any) -> bool:
    if not isinstance(value, (bool, np.bool_)):
        raise TypeError(f"{name} must be True or False, got {value!r}")
    return bool(value)


def _text(name: str, value: Any) -> str:
    if not isinstance(value, str):
        raise TypeError(f"{name} must be text, got {value!r}")
    # Line ends would break files and tables, and NumPy drops trailing NULs, so that two names became one.
    if not value or not value.isprintable():
        raise ValueError(f"{name} must be a line of printable text, got {value!r}")
    return str(value)


def _label(name: str, value: Any) -> Label | None:
    if value is None or isinstance(value, str):
        return None if value is None else _text(name, value)
    if isinstance(value, (bool, np.bool_)) or not isinstance(value, (int, np.integer)):
        raise TypeError(f"{name} must be text or a whole number, got {value!r}")
    if not -(2**63) <= value < 2**63:
        raise ValueError(f"{name} must fit into 64 bits, got {value!r}")
    return int(value)


def _meta(value: Any) -> dict[str, Any]:
    if value is None:
        return {}
    if not isinstance(value, Mapping):
        raise TypeError(f"meta must be a mapping from text to values, got {value!r}")
    for key in value:
        if not isinstance(key, str):
            raise TypeError(f"meta must have text as keys, got {key!r}")
    return dict(value)


def common_n_lobes(recordings: Sequence[Recording]) -> int:
    """Lobes of a disc, the same for all recordings.

    Raises
    ------
    ValueError
        If recordings differ in it.
    """
    found = sorted({recording.n_lobes for recording in recordings})
    if len(found) > 1:
        raise ValueError(
            f"n_lobes must be the same for all recordings, got {', '.join(map(str, found))}: take those of "
            "one kind of disc at a time"
        )
    return found[0] if found else 15


def _defects(worn_lobes: Any, defect_count: Any, n_lobes: int) -> tuple[tuple[int, ...] | None, int | None]:
    count = None if defect_count is None else _whole("defect_count", defect_count, 0)
    if count is not None and count > n_lobes:
        raise ValueError(f"defect_count must be at most n_lobes = {n_lobes}, got {count}")
    if worn_lobes is None:
        return () if count == 0 else None, count
    if isinstance(worn_lobes, str) or not isinstance(worn_lobes, Iterable):
        raise TypeError(f"worn_lobes must be a sequence of lobe indices from 0, got {worn_lobes!r}")
    lobes = tuple(sorted(_whole("worn_lobes", lobe, 0) for lobe in worn_lobes))
    if len(set(lobes)) != len(lobes):
        raise ValueError(f"worn_lobes must be distinct, got {lobes}")
    if lobes and lobes[-1] >= n_lobes:
        raise ValueError(
            f"worn_lobes must lie between 0 and {n_lobes - 1} (n_lobes = {n_lobes}, counted from 0), "
            f"got {lobes}"
        )
    if count is not None and count != len(lobes):
        raise ValueError(
            f"defect_count must be the number of worn_lobes, got {count} and {len(lobes)} lobes {lobes}"
        )
    return lobes, len(lobes)
