"""Recordings of one rig: checked, sorted by condition, and in the shape that each stage of the gap takes."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray
from scipy.signal import resample_poly

from cyclofeat._base.checks import check_type, positive
from cyclofeat._base.quantities import TORQUES, factor_to_output, number_of
from cyclofeat.gap.comparison import Comparison, Condition, GapSettings, measured_turns
from cyclofeat.gap.simulations import Bank
from cyclofeat.gap.summaries.summarise import Kinematics
from cyclofeat.gap.summaries.turns import MeasuredTurns
from cyclofeat.gap.world.cells import recording_cells, turn_samples
from cyclofeat.gap.world.world import AROUND, NOISE_AND_DRIFT, Session, World
from cyclofeat.recordings import Recording, Windower
from cyclofeat.recordings.recording import common_n_lobes, common_quantity
from cyclofeat.recordings.windower import recording_label
from cyclofeat.signal.faults import find_runs
from cyclofeat.signal.orders import mean_speed
from cyclofeat.simulators import Rig

Float = NDArray[np.float64]

# Set-points that differ by less are one condition: shares of the speed and of the load.
SAME_SPEED, SAME_LOAD = 0.005, 0.02
_SAME_RATE = 1e-6  # two statements of one rate, as they come back from text files
_FEW_RECORDINGS = 4
_CLIPPED = 1e-3  # share of samples at one extreme value from which a recording counts as clipped
_FLAT = 5  # samples on end
_LARGEST_RATIO = 50_000  # of rates: a clock's error by rounding it is at most 0.002 %


@dataclass(frozen=True, eq=False)
class MeasuredRig:
    """Recordings of one rig, at one condition or at several, made by :meth:`of`.

    They are at one sampling rate, with the torque referred to the output; ``recording_conditions`` has the
    condition of each. Counts of worn lobes (``has_counts``) and the angle of a shaft (``has_tachometer``) are
    used if all recordings state them. ``warnings`` name what was not stated or had to be changed.
    """

    recordings: tuple[Recording, ...] = field(repr=False)
    sampling_rate: float
    quantity: str
    n_lobes: int
    recording_conditions: tuple[Condition, ...] = field(repr=False)
    has_counts: bool
    has_tachometer: bool
    warnings: tuple[str, ...] = ()
    sensor_ends: frozenset[float] = frozenset()  # of its range, as far as recordings reach them

    @classmethod
    def of(
        cls,
        recordings: Iterable[Recording],
        rig: Rig,
        sampling_rate: float | None = None,
        *,
        quantity: str | None = None,
        beside: MeasuredRig | None = None,
    ) -> MeasuredRig:
        """Check recordings and sort them by condition.

        Speeds within 0.5 % of each other, and loads within 2 %, are one set-point: their median, or that of
        recordings of the rig ``beside`` these as near. A recording whose mean torque is negative ran in
        reverse. One that stays at the end of the sensor's range, which others reach, is left out.

        The recordings state ``speed_rpm``, have discs with as many lobes as ``rig``, the model, whose load is
        that of recordings without ``load_nm``, and are of ``quantity``, if it is given. Those with a higher
        rate than ``sampling_rate`` in Hz (default: the lowest of them) are resampled.
        """
        given = tuple(recordings)
        if not given:
            raise ValueError("recordings must hold at least one recording, got none")
        for recording in given:
            check_type("recordings", recording, Recording)
        measured = common_quantity(given)
        if measured not in TORQUES:
            wanted = " or ".join(map(repr, TORQUES))
            raise ValueError(f"quantity of the recordings must be {wanted}, got {measured!r}")
        if quantity not in (None, measured):
            raise ValueError(
                f"quantity of the recordings must be {quantity!r}, from which the posterior was learned, got "
                f"{measured!r}: prepare a posterior for {measured!r}"
            )
        n_lobes = common_n_lobes(given)
        if n_lobes != rig.gearbox.n_lobes:
            raise ValueError(
                f"the model's discs have {rig.gearbox.n_lobes} lobes, those of the recordings {n_lobes}: "
                "take the model of their gearbox, or give n_lobes="
            )
        factor, warnings = factor_to_output(measured, n_lobes), []
        if factor != 1:
            given = tuple(recording.replace(torque=factor * recording.torque) for recording in given)
            warnings.append(
                f"input torque is multiplied by {factor}, the reduction: all torques are referred to the "
                "output"
            )
        at_one_rate = _bring_to_one_rate(given, sampling_rate, warnings)
        recording_conditions = _sort_by_condition(
            at_one_rate, float(rig.gearbox.load_torque), beside.conditions if beside else (), warnings
        )
        assemblies = {recording.assembly for recording in given}
        if None not in assemblies and 1 < len(assemblies) < len(given):
            warnings.append(
                f"{len(given)} recordings are of {len(assemblies)} assemblies, and each counts as one of its "
                "own: differences may look surer than they are"
            )
        return cls(
            recordings=at_one_rate,
            sampling_rate=at_one_rate[0].sampling_rate,
            quantity=measured,
            n_lobes=n_lobes,
            recording_conditions=recording_conditions,
            has_counts=all(recording.defect_count is not None for recording in given),
            has_tachometer=all(recording.angle is not None for recording in given),
            warnings=tuple(warnings),
        )._without_saturated(beside.sensor_ends if beside else frozenset())

    @property
    def conditions(self) -> tuple[Condition, ...]:
        """Distinct conditions: forward before reverse, then by speed and load."""
        return tuple(
            sorted(set(self.recording_conditions), key=lambda at: (-at.direction, at.speed_rpm, at.load_nm))
        )

    @property
    def doubts(self) -> list[str]:
        """A sentence on each property of the recordings that limits the conclusions."""
        torques = [recording.torque for recording in self.recordings]
        n = len(torques)
        doubts = []
        if n < _FEW_RECORDINGS:
            doubts.append(
                f"{number_of(n, 'recording')}: how much they vary from one to the next is hardly known, "
                "and only large differences are found"
            )
        if not self.has_counts:
            doubts.append(
                "the counts of worn lobes are not known: differences between classes hide smaller ones"
            )
        if not self.has_tachometer:
            doubts.append(
                "no tachometer: an error of the speed and one of the converter's clock cannot be told apart"
            )
        for extreme, word in ((np.max, "largest"), (np.min, "smallest")):
            at_end = [torque == extreme(torque) for torque in torques]
            clipped = sum(
                np.mean(flags) > _CLIPPED and find_runs(flags)[1].max() >= _FLAT for flags in at_end
            )
            if clipped:
                doubts.append(
                    f"{clipped} of {n} recordings seem clipped: they stay at their {word} value for samples "
                    "on end"
                )
        return doubts

    def at(self, condition: Condition) -> tuple[Recording, ...]:
        """Return the recordings of a condition."""
        return tuple(
            recording
            for recording, at in zip(self.recordings, self.recording_conditions, strict=True)
            if at == condition
        )

    def of_one_assembly(self, condition: Condition) -> bool:
        """Return True if all of several recordings of a condition state the same assembly."""
        recordings = self.at(condition)
        assemblies = {recording.assembly for recording in recordings}
        return len(recordings) > 1 and len(assemblies) == 1 and None not in assemblies

    def part(self, numbers: Sequence[int]) -> MeasuredRig:
        """Return some of the recordings, by their numbers from 0, with the same conditions."""
        return dataclasses.replace(
            self,
            recordings=tuple(self.recordings[i] for i in numbers),
            recording_conditions=tuple(self.recording_conditions[i] for i in numbers),
        )

    def _without_saturated(self, ends: frozenset[float]) -> MeasuredRig:
        """Leave out recordings that stay for an output turn at one of ``ends``, or of those others reach."""
        turns = [self.n_lobes * 60 / at.speed_rpm * self.sampling_rate for at in self.recording_conditions]
        longest = [_longest_at_end(recording.torque) for recording in self.recordings]
        ends |= {value for (value, n), turn in zip(longest, turns, strict=True) if _FLAT <= n < turn}
        kept = [
            i for i, ((value, n), turn) in enumerate(zip(longest, turns, strict=True))
            if n < turn or value not in ends
        ]  # fmt: skip
        if len(kept) in (0, len(longest)):  # with none left, each is refused by name
            return dataclasses.replace(self, sensor_ends=ends)
        values = {longest[i][0] for i in range(len(longest)) if i not in kept}
        at = " and ".join(f"{value:.5g} Nm" for value in sorted(values))
        left_out = (
            f"{len(longest) - len(kept)} of {number_of(len(longest), 'recording')} stay at {at} for an output"
            " turn or more, the end of the sensor's range, which others reach too: they are left out"
        )
        return dataclasses.replace(self.part(kept), warnings=(*self.warnings, left_out), sensor_ends=ends)

    def known_as(self, other: MeasuredRig) -> MeasuredRig:
        """Return a copy that uses counts and tachometer only where other recordings state them too."""
        return dataclasses.replace(
            self,
            has_counts=self.has_counts and other.has_counts,
            has_tachometer=self.has_tachometer and other.has_tachometer,
        )

    def turns(self, comparison: Comparison) -> MeasuredTurns:
        """Return the recordings at a condition, cut to output turns, positive for a load that brakes."""
        condition = comparison.condition
        recordings = self.at(condition)
        cut = Windower(input_speed_hz=condition.speed_rpm / 60, reduction=self.n_lobes).windows(recordings)
        angle = None
        if self.has_tachometer:
            starts = np.round(cut.start_s * cut.sampling_rate).astype(int)
            of_input = self._input_angles(recordings)
            n = cut.X.shape[1]
            angle = np.array([of_input[i][k : k + n] for i, k in zip(cut.recording, starts, strict=True)])
        y = cut.y if self.has_counts else None
        return measured_turns(comparison, cut.X * condition.direction, y, cut.recording, angle)

    def world(self, world: World) -> World:
        """Return ``world``, at its rate at most, widened to 10 % beyond the recordings' speeds and loads."""
        speeds, loads = (
            np.array([getattr(at, name) for at in self.conditions]) for name in ("speed_rpm", "load_nm")
        )
        counts = [*world.defect_counts, *(recording.defect_count or 0 for recording in self.recordings)]
        return dataclasses.replace(
            world,
            quantity=self.quantity,
            sampling_rate=min(self.sampling_rate, world.sampling_rate),
            speeds_rpm=((1 - AROUND) * speeds.min(), (1 + AROUND) * speeds.max()),
            loads_nm=((1 - AROUND) * loads.min(), (1 + AROUND) * loads.max()),
            defect_counts=sorted(set(counts)),
        )

    def comparison(self, condition: Condition, world: World, settings: GapSettings) -> Comparison:
        """Return the comparison with the world's model at a condition; noise and drift may differ anyway."""
        speed_hz = condition.speed_rpm / 60
        return Comparison(
            sampling_rate=self.sampling_rate, rig=world.rig.at(condition.speed_rpm, condition.load_nm),
            duration=self.n_lobes / speed_hz, input_speed_hz=speed_hz, direction=condition.direction,
            quantity=self.quantity, may_differ=(*world.may_differ, *NOISE_AND_DRIFT),
            defect_counts=world.defect_counts, wheels=world.wheels, tachometer=self.has_tachometer,
            one_assembly=settings.one_assembly or self.of_one_assembly(condition), n_bank=settings.n_bank,
            random_state=settings.seed, n_jobs=settings.n_jobs, cache=settings.cache,
        )  # fmt: skip

    def bank(self, comparison: Comparison) -> Bank:
        """Return the first output turn of each recording at a comparison's condition, as if simulated."""
        condition, turns = comparison.condition, self.turns(comparison)
        first = np.unique(turns.of_window, return_index=True)[1]
        nominal = np.full(len(first), condition.speed_rpm / 60)
        return Bank(
            X=turns.windows[first],
            counts=turns.counts_or_zeros,
            speeds=nominal if turns.speeds is None else turns.speeds[first],
            assemblies=_assembly_numbers(self.at(condition)),
        )

    def session(self, *, one_assembly: bool = False) -> Session:
        """Return the summaries of the first output turn of each recording, for a posterior.

        With ``one_assembly`` all are of one. Default: as they state; an assembly each where one states none.
        """
        rows, speeds = [], []
        for i, (recording, at) in enumerate(zip(self.recordings, self.recording_conditions, strict=True)):
            turn = Kinematics(self.sampling_rate, at.speed_rpm / 60, self.n_lobes)
            n = turn_samples(turn)
            if recording.n_samples < n:
                raise ValueError(
                    f"{recording_label(i, recording)} is too short: an output turn and 3 % "
                    f"more, {n / self.sampling_rate:.4g} s at {at.speed_rpm:.4g} RPM, is needed, "
                    f"got {recording.duration:.4g} s"
                )
            torque = recording.torque[:n].astype(np.float32) * np.float32(at.direction)
            rows.append(recording_cells(torque[None], turn)[0][0])
            for angle in self._input_angles([recording]) if self.has_tachometer else ():
                speeds.append(60 * mean_speed(angle[:n], self.sampling_rate))
        counts = np.array([recording.defect_count or 0 for recording in self.recordings])
        return Session(
            np.array(rows),
            np.array([dataclasses.astuple(at) for at in self.recording_conditions], dtype=float),
            counts if self.has_counts else None,
            np.array(speeds) if self.has_tachometer else None,
            np.zeros_like(counts) if one_assembly else _assembly_numbers(self.recordings),
        )

    def _input_angles(self, recordings: Iterable[Recording]) -> list[Float]:
        """Angles of the input shaft; the tachometer may have been on a disc."""
        angles = (recording.input_angle(self.n_lobes) for recording in recordings)
        return [angle for angle in angles if angle is not None]


def _longest_at_end(torque: Float) -> tuple[float, int]:
    """Return the largest or smallest value of a torque at which it stays longer, and for how many samples."""
    at_ends = ((float(end), int(find_runs(torque == end)[1].max())) for end in (torque.max(), torque.min()))
    return max(at_ends, key=lambda one: one[1])


def _bring_to_one_rate(
    recordings: tuple[Recording, ...], sampling_rate: float | None, warnings: list[str]
) -> tuple[Recording, ...]:
    """Return recordings at one rate, and add a warning if some had to be resampled."""
    rates = sorted({recording.sampling_rate for recording in recordings})
    rate = rates[0] if sampling_rate is None else positive("sampling_rate", sampling_rate, "a number of Hz")
    if rates[0] < rate * (1 - _SAME_RATE):
        raise ValueError(
            f"recordings must have {rate:g} Hz or more, the rate of the posterior's world, got "
            f"{rates[0]:g} Hz: prepare a posterior for that rate"
        )
    faster = [other for other in rates if other > rate * (1 + _SAME_RATE)]
    if not faster:
        return recordings
    n = sum(recording.sampling_rate in faster for recording in recordings)
    higher = ", ".join(f"{other:g}" for other in faster)
    warnings.append(
        f"{n} of {len(recordings)} recordings were resampled from {higher} "
        f"to {rate:g} Hz: what lies above {rate / 2:g} Hz and the steps of their converter are not compared"
    )
    at_one_rate = []
    for recording in recordings:
        if recording.sampling_rate in faster:
            ratio = (Fraction(rate) / Fraction(recording.sampling_rate)).limit_denominator(_LARGEST_RATIO)
            n = int((recording.n_samples - 1) * ratio) + 1
            # Without the mean: its gain differs by 0.07 % between the filter's phases, and falls at the ends.
            mean = recording.torque.mean()
            torque = mean + resample_poly(recording.torque - mean, ratio.numerator, ratio.denominator)[:n]
            angle = recording.angle
            if angle is not None:
                angle = np.interp(np.arange(n) / float(ratio), np.arange(angle.size), angle)
            recording = recording.replace(torque=torque, angle=angle, sampling_rate=rate)
        at_one_rate.append(recording)
    return tuple(at_one_rate)


def _sort_by_condition(
    recordings: Sequence[Recording], load_nm: float, known: Sequence[Condition], warnings: list[str]
) -> tuple[Condition, ...]:
    """Return the condition of each recording, and add a warning if some state no load."""
    speeds = [recording.speed_rpm for recording in recordings if recording.speed_rpm is not None]
    if len(speeds) < len(recordings):
        missing = len(recordings) - len(speeds)
        raise ValueError(
            f"{missing} of {len(recordings)} recordings state no nominal speed: give speed_rpm= (RPM)"
        )
    loads = [load_nm if recording.load_nm is None else recording.load_nm for recording in recordings]
    unstated = sum(recording.load_nm is None for recording in recordings)
    if unstated:
        warnings.append(
            f"{unstated} of {len(recordings)} recordings state no load (load_nm): it is taken to be the "
            f"model's, {load_nm:g} Nm"
        )
    at = zip(set_points(speeds, SAME_SPEED), set_points(np.abs(loads), SAME_LOAD), recordings, strict=True)
    conditions = []
    for speed, load, recording in at:
        own = Condition(round(float(speed), 6), float(load), -1 if recording.torque.mean() < 0 else 1)
        near = (
            other
            for other in known
            if own.direction == other.direction
            and math.isclose(own.speed_rpm, other.speed_rpm, rel_tol=SAME_SPEED)
            and math.isclose(own.load_nm, other.load_nm, rel_tol=SAME_LOAD)
        )
        conditions.append(next(near, own))
    return tuple(conditions)


def set_points(values: Sequence[float] | Float, share: float) -> Float:
    """Return values with the median of those that lie within a share of the smallest of them."""
    given = np.asarray(values, dtype=float)
    snapped, left = np.empty_like(given), np.ones(given.size, dtype=bool)
    while left.any():
        same = left & (given <= given[left].min() * (1 + share))
        snapped[same] = np.median(given[same])
        left &= ~same
    return snapped


def _assembly_numbers(recordings: Sequence[Recording]) -> NDArray[np.int64]:
    """Return numbers of assemblies; a recording that states none has one of its own."""
    names = [
        f"\n{i}" if recording.assembly is None else str(recording.assembly)
        for i, recording in enumerate(recordings)
    ]
    return np.unique(names, return_inverse=True)[1].astype(np.int64)
