"""Surrogate recordings: simulated torque of many assemblies on an assumed test rig."""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from importlib import resources
from typing import Any

import numpy as np

from cyclofeat._base import checks
from cyclofeat._base.quantities import QUANTITIES, from_1
from cyclofeat.datasets.readers._columns import name_errors
from cyclofeat.recordings import Recording
from cyclofeat.simulators import LobeDefects, Rig, Solver, motor_effects
from cyclofeat.simulators.effects.library import child_seed
from cyclofeat.simulators.sampling import (
    Sample,
    SampledRun,
    Wear,
    draw_conditions,
    recording_seed,
    sample_each,
    vary_errors,
)

_PRESETS = ("R0", "R1", "R2", "published")
# Machines that are drawn for one recording while none of them can run.
_MOST_DRAWS = 4
# Child of a recording's seed for what varies; those of its rig and conditions are below.
_VARIATION = 20
# Recordings that are simulated at once where not all of them are kept whole.
_AT_ONCE = 400


def make_rig_recordings(
    n_assemblies: int,
    defect_counts: Iterable[int] = range(8),
    *,
    rig: str | Rig = "R1",
    lobes: str = "consecutive",
    wheels: str | Sequence[int] = "random",
    wear_um: float | tuple[float, float] | None = None,
    radial_share: float = 1.0,
    speed_rpm: float | tuple[float, float] | None = None,
    load_nm: float | tuple[float, float] | None = None,
    duration: float | None = None,
    output_turns: float | None = None,
    sampling_rate: float = 25_600.0,
    random_state: int | None = None,
    n_jobs: int = 1,
    with_angle: bool = False,
    progress: Callable[[int, int], object] | None = None,
    kernel: str = "exact",
    solver: Solver | None = None,
    quantity: str = "output_torque",
    varied_errors: bool = False,
    first_assembly: int = 0,
    keep: Callable[[Recording], Recording] | None = None,
) -> list[Recording]:
    """Make surrogate recordings: simulated assemblies on an assumed rig, with drift and noise.

    Each recording is of another assembly, with its own pins, contacts, speed, load and brake, a random first
    worn lobe and a random start angle.

    Parameters
    ----------
    n_assemblies : int
        Assemblies, hence recordings, per defect count.
    defect_counts : iterable of int, default 0 to 7
        Numbers of worn lobes.
    rig : {"R0", "R1", "R2", "published"} or Rig, default "R1"
        Gearbox and effects. All presets are assumptions (:func:`rig_preset`).
    lobes : {"consecutive", "random", "mixed"}
        Worn lobes: neighbours from a random first one; any; or one or the other with equal chances.
    wheels : "random" or sequence of int
        Wheels that carry the wear: wheel 0 alone or both, with equal chances; or ``(0,)``, ``(0, 1)``.
    wear_um : float or (low, high), optional
        Radial wear of the worn lobes in um, 0 to 200, or a range from which each assembly draws its own
        (:class:`cyclofeat.simulators.LobeDefects`), log-uniform unless the range begins at 0. Default: the
        papers' chord.
    radial_share : float, default 1
        With ``wear_um``: the probability that an assembly has radial wear; the others have the papers' chord.
    speed_rpm, load_nm : float or (low, high), optional
        Nominal input speed in RPM and load torque in Nm: one for all, or a range from which each assembly
        draws its own (log-uniform). Default: those of the rig's gearbox. Below the gearbox's load, the load
        drift (:class:`cyclofeat.simulators.Drift`) shrinks in proportion to it.
    duration : float, optional
        Length of each recording in s, default 1.8. It begins when the assembly has settled.
    output_turns : float, optional
        Length in turns of the output at the nominal speed, instead of ``duration``.
    sampling_rate : float, default 25600
        In Hz.
    random_state : int, optional
        Seed. The same arguments give the same recordings, to the last bit, for every ``n_jobs``.
    n_jobs : int, default 1
        Number of threads; -1 for all processors. ``joblib.parallel_config`` chooses other workers.
    with_angle : bool, default False
        If True, recordings hold the absolute angle of the input shaft: a rig with a tachometer.
    progress : callable, optional
        Called after each recording with the number done and the total.
    kernel : {"exact", "batch", "auto"}, default "exact"
        See :func:`cyclofeat.simulators.simulate_many`. Batches are several times as fast, in single
        precision.
    solver : Solver, optional
        Time step and integrator.
    quantity : {"output_torque", "input_torque", "motor_current"}, default "output_torque"
        Quantity to record (:meth:`cyclofeat.simulators.Rig.simulate`). For a motor current, a rig without a
        motor is given that of :func:`cyclofeat.simulators.motor_effects`, of the size that the gearbox needs.
    varied_errors : bool, default False
        If True, each assembly has errors, drift and noise from none to 1.5 times what the rig states, and
        some have hum, offsets and the like that spoil no count: machines of any quality, to train on
        (:func:`cyclofeat.simulators.sampling.vary_errors`).
    first_assembly : int, default 0
        Assemblies per defect count to leave out before the first: a set may be made in parts.
    keep : callable, optional
        Called with each recording; what it returns is kept in its place. Some hundred whole recordings are in
        memory at once.

    Returns
    -------
    list of Recording
        ``n_assemblies * len(defect_counts)`` recordings of ``duration * sampling_rate`` samples (rounded);
        the defect count runs fastest, so a larger ``n_assemblies`` appends recordings.

        Each has ``source="surrogate"``, the assembly ``"<rig>-<random_state>-<index>"``, its worn lobes
        (counted from 0) and their number; ``speed_rpm`` and ``load_nm`` are nominal. ``meta`` holds the true
        values of the assembly, ``wheels_from_1``, ``start_angle_rad`` (of the input at the first sample,
        within one turn of the output), ``settling_s`` (time before it), ``rig``, and ``effects`` as in the
        rig's file, with the values drawn; ``wear_um`` with radial wear, and ``drawn_anew`` with the reason
        where another machine was drawn (see Warns).

    Raises
    ------
    ValueError, SimulationFailed
        If the rig needs more than a minute to settle; if the motors of four machines drawn for one recording
        do not hold their speed, or their simulations diverge or lock.

    Warns
    -----
    RuntimeWarning
        If the machine drawn for a recording cannot run. Another is drawn in its place, for the same worn
        lobes and at the same nominal speed and load; all other recordings stay as they are.

    Examples
    --------
    >>> recordings = make_rig_recordings(1, [0, 2], rig="R0", duration=0.1, random_state=0)
    >>> [(r.assembly, r.defect_count, r.source, r.n_samples) for r in recordings]
    [('R0-0-0000', 0, 'surrogate', 2560), ('R0-0-0001', 2, 'surrogate', 2560)]
    """
    settings = _RecordingSettings(
        _rig_of(rig), duration, output_turns, sampling_rate,
        checks.seed_number(random_state), with_angle, solver, _positive_range("speed_rpm", speed_rpm, "RPM"),
        _positive_range("load_nm", load_nm, "Nm"), quantity, varied_errors,
    )  # fmt: skip
    counts = checks.defect_counts(defect_counts, settings.rig.gearbox.n_lobes)
    checks.n_jobs(n_jobs)
    wear = Wear(
        lobes=lobes, wheels=checks.wheel_numbers(wheels), radial_share=radial_share,
        wear_um=None if wear_um is None else checks.range_ends("wear_um", wear_um, "a number of um"),
    )  # fmt: skip
    checks.one_of("kernel", kernel, ("exact", "batch", "auto"))
    total = checks.whole("n_assemblies", n_assemblies, 1) * len(counts)
    first = checks.whole("first_assembly", first_assembly, 0) * len(counts)
    defects = [
        wear.draw(counts[index % len(counts)], settings.rig.gearbox.n_lobes, settings.seed_of(index))
        for index in range(first, first + total)
    ]
    recordings: dict[int, Recording] = {}
    at_once = total if keep is None else _AT_ONCE
    for start in range(0, total, at_once):
        part = defects[start : start + at_once]
        for place, recording in _simulate_recordings(settings, part, kernel, n_jobs, first + start):
            recordings[start + place] = recording if keep is None else keep(recording)
            if progress is not None:
                progress(len(recordings), total)
    return [recordings[place] for place in range(total)]


def make_rig_recording(
    rig: str | Rig = "R1",
    defects: LobeDefects | None = None,
    *,
    duration: float = 1.8,
    sampling_rate: float = 25_600.0,
    random_state: int | None = None,
    with_angle: bool = False,
    quantity: str = "output_torque",
) -> Recording:
    """Make one surrogate recording of an assembly with given defects.

    Parameters
    ----------
    rig, duration, sampling_rate, random_state, with_angle, quantity
        See :func:`make_rig_recordings`.
    defects : LobeDefects, default healthy
        Worn or removed lobes.

    Returns
    -------
    Recording
        As :func:`make_rig_recordings` returns. With removed lobes ``worn_lobes`` is None, ``defect_count``
        counts both, and ``meta`` holds ``worn_lobes_from_1`` and ``removed_lobes_from_1``. Assembly and
        drift are those of the first recording that :func:`make_rig_recordings` makes with this seed.

    Examples
    --------
    >>> from cyclofeat.simulators import LobeDefects
    >>> recording = make_rig_recording("R0", LobeDefects.worn((0, 4)), duration=0.1, random_state=0)
    >>> recording.worn_lobes, recording.source, recording.assembly
    ((0, 4), 'surrogate', 'R0-0-0000')
    """
    defects = LobeDefects.healthy() if defects is None else defects
    checks.check_type("defects", defects, LobeDefects)
    settings = _RecordingSettings(
        _rig_of(rig), duration, None, sampling_rate, checks.seed_number(random_state), with_angle,
        quantity=quantity,
    )  # fmt: skip
    ((_, recording),) = _simulate_recordings(settings, [defects], "exact", 1)
    return recording


@dataclass(frozen=True)
class _RecordingSettings:
    """Rig and conditions of all recordings of one call."""

    rig: Rig
    duration: float | None
    output_turns: float | None
    sampling_rate: float
    random_state: int
    with_angle: bool
    solver: Solver | None = None
    speed_rpm: tuple[float, float] | None = None
    load_nm: tuple[float, float] | None = None
    quantity: str = "output_torque"
    varied_errors: bool = False

    def __post_init__(self) -> None:
        checks.one_of("quantity", self.quantity, QUANTITIES)
        checks.positive("sampling_rate", self.sampling_rate, "a number of Hz")
        if self.duration is not None and self.output_turns is not None:
            raise ValueError(
                f"duration and output_turns exclude each other, got {self.duration!r} s and "
                f"{self.output_turns!r} turns"
            )
        for name, unit in (("output_turns", "turns of the output"), ("duration", "s")):
            if (length := getattr(self, name)) is not None:
                checks.positive(name, length, f"a number of {unit}")
        duration = self.duration_at(self.rig)
        if round(duration * self.sampling_rate) < 2:
            raise ValueError(
                f"duration must hold at least 2 samples at {self.sampling_rate:g} Hz, got {duration!r}"
            )

    def duration_at(self, rig: Rig) -> float:
        """Return the length in s at the rig's nominal speed."""
        if self.output_turns is not None:
            return self.output_turns * rig.gearbox.n_lobes / rig.gearbox.input_speed_hz
        return 1.8 if self.duration is None else self.duration  # one output turn at 500 RPM

    def seed_of(self, index: int) -> np.random.SeedSequence:
        return recording_seed(self.random_state, self.rig.name, index)

    def sample(self, index: int, defects: LobeDefects) -> Sample:
        """Return a recording to simulate: the rig at its speed and load, with a motor where one is needed."""
        name, rig, seed = f"{self.rig.name}-{self.random_state}-{index:04d}", self.rig, self.seed_of(index)
        with name_errors(f"assembly {name}"):
            if self.varied_errors:
                random = np.random.default_rng(child_seed(seed, _VARIATION))
                rig = vary_errors(rig, random, self.sampling_rate)
            rig = draw_conditions(rig, self.speed_rpm, self.load_nm, seed)
        if self.quantity == "motor_current" and rig.simulator is None and not rig.has_motor:
            rig = rig.with_added(*motor_effects(rig.gearbox))
        return Sample(
            rig=rig, defects=defects, duration=self.duration_at(rig), sampling_rate=self.sampling_rate,
            random_state=seed, quantity=self.quantity, solver=self.solver, name=name,
        )  # fmt: skip

    def recording(self, sample: Sample, drawn: SampledRun) -> Recording:
        """Return the recording of a machine's run, with why the machines drawn before it could not run."""
        plan, run, failures = drawn
        gearbox, defects = sample.rig.gearbox, sample.defects
        if isinstance(run, Exception):
            removed = f", removed {from_1(defects.removed_lobes)}" if defects.removed_lobes else ""
            values = ", ".join(f"{name} {value:.5g}" for name, value in plan.machine.true_values().items())
            run.args = (
                f"assembly {sample.name} (worn lobes {from_1(defects.worn_lobes)}{removed} on wheels "
                f"{from_1(defects.wheels)}, counted from 1; {values}), the last of {_MOST_DRAWS} that "
                f"were drawn: {run}",
            )
            raise run
        with name_errors(f"assembly {sample.name}"):
            record = run.record()
        output_turn = 2 * np.pi * gearbox.n_lobes  # as an angle of the input
        meta = {
            "rig": sample.rig.name,
            **plan.machine.true_values(),
            "wheels_from_1": from_1(defects.wheels) if defects.defect_count else [],
            "start_angle_rad": float(record.input_angle[0] % output_turn),
            "settling_s": plan.n_settling / self.sampling_rate,
            "effects": [effect.to_dict() for effect in plan.machine.effects],
        }
        if defects.wear_um is not None:
            meta["wear_um"] = np.asarray(defects.wear_um if defects.worn_lobes else 0.0).tolist()
        if failures:
            meta["drawn_anew"] = "; ".join(failures)
        return Recording.from_run(
            record, quantity=self.quantity, with_angle=self.with_angle, assembly=sample.name,
            speed_rpm=round(60 * gearbox.input_speed_hz, 6), load_nm=gearbox.load_torque, source="surrogate",
            meta=meta,
        )  # fmt: skip


def _simulate_recordings(
    settings: _RecordingSettings, defects: Sequence[LobeDefects], kernel: str, n_jobs: int, first: int = 0
) -> Iterator[tuple[int, Recording]]:
    """Yield places in ``defects`` and recordings; ``first`` is the number of the first recording."""
    with name_errors(f"rig {settings.rig.name}"):
        samples = [settings.sample(index, worn) for index, worn in enumerate(defects, first)]
        for place, recording in sample_each(
            samples, lambda place, drawn: settings.recording(samples[place], drawn),
            kernel=kernel, n_jobs=n_jobs, most_draws=_MOST_DRAWS,
        ):  # fmt: skip
            if recording.meta and (reason := recording.meta.get("drawn_anew")):
                text = f"assembly {recording.assembly}: another machine is drawn, since {reason}"
                warnings.warn(text, RuntimeWarning, stacklevel=3)
            yield place, recording


def _positive_range(name: str, given: Any, unit: str) -> tuple[float, float] | None:
    if given is None:
        return None
    low, high = checks.range_ends(name, given, f"a number of {unit}")
    checks.positive(name, low)
    if low > high:
        raise ValueError(f"{name} must be a range (low, high) with low <= high, got {given!r}")
    return low, high


def rig_preset(name: str) -> Rig:
    """Return a rig by its name.

    Parameters
    ----------
    name : {"R0", "R1", "R2", "published"}
        In capitals or not. ``"R0"`` to ``"R2"`` are those of :class:`cyclofeat.simulators.Rig`. The torque of
        ``"published"`` has the mean, deviation, range and asymmetry of paper A's table 4 within the scatter
        of its eight discs. ``benchmarks/published_rig.py`` searched for its numbers; ``published_rig.md``
        beside it says which statistics match. The papers' rig may have been another.

    Returns
    -------
    Rig

    Examples
    --------
    >>> [effect.effect_id for effect in rig_preset("published").effects[-3:]]
    ['proportional_drift', 'offset', 'noise']
    """
    if not isinstance(name, str) or name.lower() not in map(str.lower, _PRESETS):
        raise ValueError(f"name must be one of {_PRESETS}, got {name!r}")
    if name.lower() == "published":
        file = resources.files("cyclofeat.datasets") / "tables" / "published_rig.json"
        return Rig.from_dict(json.loads(file.read_text(encoding="utf-8")))
    return {"R0": Rig.r0, "R1": Rig.r1, "R2": Rig.r2}[name.upper()]()


def _rig_of(rig: Any) -> Rig:
    if isinstance(rig, Rig):
        return rig
    try:
        return rig_preset(rig)
    except ValueError:
        raise ValueError(f"rig must be one of {_PRESETS} or a Rig, got {rig!r}") from None
