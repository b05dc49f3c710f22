"""Surrogate recordings: simulated torque of many assemblies on an assumed test rig."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import joblib
import numpy as np

from cyclofeat.recording import Recording

if TYPE_CHECKING:  # the simulator loads numba: only those who simulate wait for it
    from cyclofeat.simulators import CycloidalGearbox, Effect, LobeDefects, Rig, SimulationFailed

_PRESETS = ("R0", "R1", "R2", "published")
_PATTERNS = ("consecutive", "random", "mixed")
_WHEELS = ((0,), (1,), (0, 1))


def make_rig_recordings(
    n_assemblies: int,
    defect_counts: Iterable[int] = range(8),
    *,
    rig: str | Rig = "R1",
    effects: Sequence[Effect] = (),
    lobes: str = "consecutive",
    wheels: str | Sequence[int] = "random",
    duration_s: float = 1.8,
    sampling_rate: float = 25_600.0,
    noise_nm: float | None = None,
    random_state: int = 0,
    n_jobs: int = 1,
    with_angle: bool = False,
    progress: Callable[[int, int], object] | None = None,
) -> list[Recording]:
    """Make surrogate rig recordings: simulated assemblies on an assumed rig, with drift and noise.

    Each recording comes from an assembly of its own, with its own pins, contacts, speed, load and brake, a
    random first worn lobe and a random angle at the start; the rig's effects and those given here
    (:mod:`cyclofeat.simulators.effects`) are applied to each, through
    :class:`cyclofeat.simulators.CompositeSimulator`. Nothing here was recorded on a machine.

    Parameters
    ----------
    n_assemblies : int
        Assemblies, hence recordings, per defect count.
    defect_counts : iterable of int, default 0 to 7
        Numbers of worn lobes.
    rig : {"R0", "R1", "R2", "published"} or Rig, default "R1"
        Gearbox and rig with their spread. All rigs are assumptions. ``"published"`` gives torque with the
        statistics of paper A's table 4 (:func:`rig_preset`).
    effects : sequence of Effect
        What this rig does besides, in addition to its own effects; a range is drawn anew for each assembly.
        An effect more leaves the assemblies and the other effects' random numbers as they are.
    lobes : {"consecutive", "random", "mixed"}
        Worn lobes: neighbours, from a random first one; any; or, with equal chances, the one or the other.
    wheels : "random" or sequence of int
        Wheels that carry the wear: wheel 0 alone or both, with equal chances; or ``(0,)``, ``(1,)``,
        ``(0, 1)``.
    duration_s : float, default 1.8
        Length of each recording in s. It begins when the assembly has settled
        (:func:`cyclofeat.simulators.settling_time`); ramp and settling are simulated, but not part of it.
    sampling_rate : float, default 25600
        In Hz.
    noise_nm : float, optional
        Standard deviation of the sensor's white noise in Nm. Default: the rig's.
    random_state : int, default 0
        Seed. The same arguments give the same recordings, to the last bit, for every ``n_jobs``.
    n_jobs : int, default 1
        Number of processes; -1 for all processors.
    with_angle : bool, default False
        Whether to keep the angle of the input shaft, which is absolute: a rig with a tachometer.
    progress : callable, optional
        Called after each recording with the number done and their total.

    Returns
    -------
    list of Recording
        ``n_assemblies * len(defect_counts)`` recordings of ``duration_s * sampling_rate`` samples (rounded),
        class after class in turn: more assemblies of the same seed are appended, the first stay what they
        are. Another noise changes nothing but the noise, another duration appends to it.

        Each has ``source="surrogate"``, the assembly ``"<rig>-<random_state>-<index>"``, its worn lobes
        (counted from 0) and their number; ``speed_rpm`` and ``load_nm`` are nominal, as on a real rig's label
        (the same for all). ``meta`` holds what is true of the assembly: ``true_speed_rpm``, ``true_load_nm``,
        ``wheels`` (list of worn wheels), ``brake_inertia_kg_m2``, ``meter_stiffness_nm_per_rad``,
        ``meter_damping_nms_per_rad``, ``stiffness_scale``, ``contact_damping``, ``clearance_m``,
        ``start_angle_rad`` (absolute angle of the input at the first sample, within one turn of the output),
        ``settling_s`` (time before it), ``drift_nm`` (rms), ``noise_nm``, ``rig``, and, if the rig has
        effects, ``effects``: a list of objects as in the rig's file, with the values drawn for the assembly.

    Raises
    ------
    TypeError, ValueError
        If an argument is of the wrong type or outside its range; the message names it. Also if the rig has
        too little damping to settle within a minute.
    SimulationFailed
        If a simulation diverges or the gearbox locks; the message names assembly, parameters, time and
        contact.

    Examples
    --------
    >>> recordings = make_rig_recordings(1, [0, 2], rig="R0", duration_s=0.1)
    >>> [(r.assembly, r.defect_count, r.source, r.n_samples) for r in recordings]
    [('R0-0-0000', 0, 'surrogate', 2560), ('R0-0-0001', 2, 'surrogate', 2560)]

    A converter of 12 bits behind a low-pass, and mains hum that differs from assembly to assembly:

    >>> from cyclofeat.simulators import Hum, Quantisation, TorqueMeterLowPass
    >>> effects = [Quantisation.from_bits(12, 102.4), TorqueMeterLowPass(300.0), Hum((0.05, 0.3))]
    >>> (one,) = make_rig_recordings(1, [2], rig="R0", effects=effects, duration_s=0.1)
    >>> [effect["effect"] for effect in one.meta["effects"]]
    ['torque_meter_low_pass', 'hum', 'quantisation']
    """
    from cyclofeat.simulators._parallel import stopped_quietly

    chosen = _with_effects(_rig(rig), effects)
    n_lobes = chosen.gearbox.n_lobes
    counts = _counts(defect_counts, n_lobes)
    n_assemblies = _whole("n_assemblies", n_assemblies, least=1)
    if isinstance(n_jobs, bool) or not isinstance(n_jobs, (int, np.integer)) or n_jobs == 0:
        raise ValueError(f"n_jobs must be a whole number of processes, or -1 for all, got {n_jobs!r}")
    if not isinstance(lobes, str) or lobes not in _PATTERNS:
        raise ValueError(f"lobes must be one of {_PATTERNS}, got {lobes!r}")
    chosen, n_samples, sampling_rate = _checked(chosen, duration_s, sampling_rate, noise_nm)
    random_state = _whole("random_state", random_state, least=0)
    worn_wheels = None if isinstance(wheels, str) and wheels == "random" else _worn_wheels(wheels)

    total = n_assemblies * len(counts)
    parallel = joblib.Parallel(n_jobs=n_jobs, return_as="generator")
    made = parallel(
        joblib.delayed(_drawn_recording)(
            chosen, counts[index % len(counts)], lobes, worn_wheels, n_samples, sampling_rate, random_state,
            index, with_angle,
        )
        for index in range(total)
    )  # fmt: skip
    recordings: list[Recording] = []
    with stopped_quietly(made):
        for result in made:
            recordings.append(_unless_failed(result))
            if progress is not None:
                progress(len(recordings), total)
    return recordings


def make_rig_recording(
    rig: str | Rig = "R1",
    defects: LobeDefects | None = None,
    *,
    effects: Sequence[Effect] = (),
    duration_s: float = 1.8,
    sampling_rate: float = 25_600.0,
    noise_nm: float | None = None,
    random_state: int = 0,
    with_angle: bool = False,
) -> Recording:
    """Make one surrogate rig recording of an assembly with given defects.

    Parameters
    ----------
    rig : {"R0", "R1", "R2", "published"} or Rig, default "R1"
        Gearbox and rig with their spread.
    defects : LobeDefects, default healthy
        Worn or removed lobes.
    effects, duration_s, sampling_rate, noise_nm, random_state, with_angle
        As in :func:`make_rig_recordings`.

    Returns
    -------
    Recording
        As there. With removed lobes ``worn_lobes`` is None, ``defect_count`` counts both, and ``meta`` holds
        ``worn_lobes`` and ``removed_lobes``. Assembly and drift are those of the first recording that
        :func:`make_rig_recordings` makes with this seed.

    Raises
    ------
    TypeError, ValueError, SimulationFailed
        As in :func:`make_rig_recordings`.

    Examples
    --------
    >>> from cyclofeat.simulators import LobeDefects
    >>> recording = make_rig_recording("R0", LobeDefects.worn((0, 4)), duration_s=0.1)
    >>> recording.worn_lobes, recording.source, recording.assembly
    ((0, 4), 'surrogate', 'R0-0-0000')
    """
    from cyclofeat.simulators import LobeDefects

    defects = LobeDefects.healthy() if defects is None else defects
    if not isinstance(defects, LobeDefects):
        raise TypeError(f"defects must be LobeDefects, got {defects!r}")
    chosen = _with_effects(_rig(rig), effects)
    chosen, n_samples, sampling_rate = _checked(chosen, duration_s, sampling_rate, noise_nm)
    random_state = _whole("random_state", random_state, least=0)
    return _unless_failed(_recording(chosen, defects, n_samples, sampling_rate, random_state, 0, with_angle))


@dataclass(frozen=True)
class _Failure:
    """What became of a failed run, in a form that comes back from another process."""

    kind: type[SimulationFailed]
    message: str
    time: float
    contact: str


def _unless_failed(result: Recording | _Failure) -> Recording:
    if isinstance(result, Recording):
        return result
    # Not through its __init__, which words the message for a run whose parameters the caller has chosen.
    error = result.kind.__new__(result.kind, result.message)
    error.time, error.contact = result.time, result.contact
    raise error


def assembly_seed(rig: Rig, random_state: int, index: int) -> np.random.SeedSequence:
    """Seed of one recording. Its second child is that of the defects; the others are the simulator's."""
    # The rig's name counts: assemblies of two rigs are different ones, and one may train and the other test.
    return np.random.SeedSequence([random_state, *rig.name.encode()], spawn_key=(index,))


def _drawn_recording(
    rig: Rig,
    count: int,
    lobes: str,
    wheels: tuple[int, ...] | None,
    n_samples: int,
    sampling_rate: float,
    random_state: int,
    index: int,
    with_angle: bool,
) -> Recording | _Failure:
    """One recording with randomly placed defects."""
    from cyclofeat.simulators import LobeDefects

    random = np.random.default_rng(assembly_seed(rig, random_state, index).spawn(2)[1])
    n_lobes = rig.gearbox.n_lobes
    consecutive = lobes == "consecutive" or (lobes == "mixed" and bool(random.random() < 0.5))
    defects = LobeDefects.drawn(count, n_lobes, random, consecutive=consecutive, wheels=wheels)
    return _recording(rig, defects, n_samples, sampling_rate, random_state, index, with_angle)


def _recording(
    rig: Rig,
    defects: LobeDefects,
    n_samples: int,
    sampling_rate: float,
    random_state: int,
    index: int,
    with_angle: bool,
) -> Recording | _Failure:
    """One recording. All that is random in it follows from the rig's name, seed and index."""
    from cyclofeat.simulators import CompositeSimulator, SimulationFailed, settling_time
    from cyclofeat.simulators.rig import LONGEST_SETTLING

    seed = assembly_seed(rig, random_state, index)
    assembly = f"{rig.name}-{random_state}-{index:04d}"
    simulator = CompositeSimulator(rig)
    gearbox, effects = simulator.assemble(seed)
    output_turn = 2 * np.pi * gearbox.n_lobes  # as an angle of the input
    settling = settling_time(gearbox)
    if settling > LONGEST_SETTLING:
        raise ValueError(
            f"rig {rig.name} must have more damping: {_parameters(assembly, gearbox, defects)} settles in "
            f"{settling:.3g} s, more than {LONGEST_SETTLING:g} s; raise meter_damping_ratio or "
            "contact_damping"
        )
    try:
        run = simulator.simulate(
            defects, duration=n_samples / sampling_rate, sampling_rate=sampling_rate, seed=seed
        )
    except SimulationFailed as error:
        message = f"{_parameters(assembly, gearbox, defects)}: {error}"
        return _Failure(type(error), message, error.time, error.contact)
    angle = run.input_angle
    removed = defects.removed_lobes
    meta = {
        "rig": rig.name,
        "true_speed_rpm": _rpm(gearbox),
        "true_load_nm": float(gearbox.load_torque),
        "wheels": list(defects.wheels) if defects.defect_count else [],
        "brake_inertia_kg_m2": float(gearbox.brake_inertia),
        "meter_stiffness_nm_per_rad": float(gearbox.meter_stiffness),
        "meter_damping_nms_per_rad": float(gearbox.meter_damping),
        "stiffness_scale": float(gearbox.stiffness_scale),
        "contact_damping": float(gearbox.contact_damping),
        "clearance_m": float(gearbox.clearance),
        "start_angle_rad": float(angle[0] % output_turn),
        "settling_s": math.ceil(settling * sampling_rate) / sampling_rate,
        "drift_nm": math.hypot(rig.load_drift_nm, rig.broad_drift_nm),
        "noise_nm": rig.noise_nm,
    }
    if effects:
        meta["effects"] = [effect.to_dict() for effect in effects]
    if removed:
        meta |= {"worn_lobes": list(defects.worn_lobes), "removed_lobes": list(removed)}
    return Recording(
        run.torque_out,
        sampling_rate,
        angle=angle if with_angle else None,
        angle_of="input",
        angle_is_absolute=with_angle,
        assembly=assembly,
        defect_count=defects.defect_count,
        worn_lobes=None if removed else defects.worn_lobes,
        n_lobes=gearbox.n_lobes,
        speed_rpm=_rpm(rig.gearbox),
        load_nm=rig.gearbox.load_torque,
        source="surrogate",
        meta=meta,
    )


def _parameters(assembly: str, gearbox: CycloidalGearbox, defects: LobeDefects) -> str:
    brake = (
        f"brake_inertia {gearbox.brake_inertia:.4g} kg m2, meter_stiffness {gearbox.meter_stiffness:.4g} "
        f"Nm/rad, meter_damping {gearbox.meter_damping:.4g} Nms/rad"
        if gearbox.brake_inertia
        else "no brake"
    )
    removed = f", removed {defects.removed_lobes}" if defects.removed_lobes else ""
    return (
        f"assembly {assembly} (worn lobes {defects.worn_lobes}{removed} on wheels {defects.wheels}, counted "
        "from 0; "
        f"stiffness_scale {gearbox.stiffness_scale:.4g}, contact_damping {gearbox.contact_damping:.4g}, "
        f"clearance {gearbox.clearance:.3g} m, {_rpm(gearbox):.5g} RPM, load {gearbox.load_torque:.4g} Nm, "
        f"{brake})"
    )


def _rpm(gearbox: CycloidalGearbox) -> float:
    # rad/s and back leaves a residue in the last digits
    return round(float(gearbox.input_speed) * 60 / (2 * math.pi), 6)


def _checked(
    rig: Rig, duration_s: float, sampling_rate: float, noise_nm: float | None
) -> tuple[Rig, int, float]:
    """Rig with its noise, number of samples, and sampling rate."""
    sampling_rate = _number("sampling_rate", sampling_rate, "Hz")
    duration_s = _number("duration_s", duration_s, "s")
    for name, value in (("duration_s", duration_s), ("sampling_rate", sampling_rate)):
        if value <= 0:
            raise ValueError(f"{name} must be positive, got {value!r}")
    n_samples = round(duration_s * sampling_rate)
    if n_samples < 2:
        raise ValueError(
            f"duration_s must hold at least 2 samples at {sampling_rate:g} Hz, got {duration_s!r}"
        )
    if noise_nm is not None:
        rig = rig.replace(noise_nm=noise_nm)
    return rig, n_samples, sampling_rate


def rig_preset(name: str) -> Rig:
    """A rig by its name.

    Parameters
    ----------
    name : {"R0", "R1", "R2", "published"}
        In capitals or not. ``"R0"`` to ``"R2"`` are those of :class:`cyclofeat.simulators.Rig`.
        ``"published"`` is a rig whose surrogate torque has the mean, deviation, range and asymmetry of paper
        A's table 4 within the scatter of its eight discs; ``benchmarks/published_rig.py`` found its numbers,
        and ``published_rig.md`` there says what is matched and what is not. It shows that such a rig can be,
        not that theirs was one.

    Returns
    -------
    Rig

    Raises
    ------
    ValueError
        If there is no such rig.

    Examples
    --------
    >>> [effect.effect_id for effect in rig_preset("published").effects]
    ['proportional_drift', 'offset']
    """
    from cyclofeat.simulators import Rig

    if not isinstance(name, str) or name.lower() not in map(str.lower, _PRESETS):
        raise ValueError(f"name must be one of {_PRESETS}, got {name!r}")
    if name.lower() == "published":
        from cyclofeat.datasets._published_rig import fitted_values, rig_of_values

        return rig_of_values(fitted_values())
    return {"R0": Rig.r0, "R1": Rig.r1, "R2": Rig.r2}[name.upper()]()


def _rig(rig: Any) -> Rig:
    from cyclofeat.simulators import Rig

    if isinstance(rig, Rig):
        return rig
    try:
        return rig_preset(rig)
    except ValueError:
        raise ValueError(f"rig must be one of {_PRESETS} or a Rig, got {rig!r}") from None


def _with_effects(rig: Rig, effects: Any) -> Rig:
    if isinstance(effects, (str, bytes)) or not isinstance(effects, Iterable):
        return rig.replace(effects=effects)  # which says what is wrong with it
    added = tuple(effects)
    return rig.replace(effects=(*rig.effects, *added)) if added else rig


def _counts(defect_counts: Any, n_lobes: int) -> list[int]:
    if isinstance(defect_counts, str) or not isinstance(defect_counts, Iterable):
        raise TypeError(f"defect_counts must be several whole numbers, e.g. range(8), got {defect_counts!r}")
    counts = [_whole("defect_counts", count, least=0) for count in defect_counts]
    if not counts or len(set(counts)) < len(counts) or max(counts) > n_lobes:
        raise ValueError(f"defect_counts must be distinct and from 0 to {n_lobes}, got {counts}")
    return counts


def _worn_wheels(wheels: Any) -> tuple[int, ...]:
    try:
        found = tuple(sorted(wheels))
    except TypeError:
        found = ()
    if found not in _WHEELS:
        raise ValueError(f"wheels must be 'random', (0,), (1,) or (0, 1), got {wheels!r}")
    return tuple(int(wheel) for wheel in found)


def _whole(name: str, value: Any, *, least: int) -> int:
    if isinstance(value, (bool, np.bool_)) or not isinstance(value, (int, np.integer)):
        raise TypeError(f"{name} must be a whole number, got {value!r}")
    if value < least:
        raise ValueError(f"{name} must be at least {least}, got {value!r}")
    return int(value)


def _number(name: str, value: Any, unit: str) -> float:
    if isinstance(value, (bool, np.bool_)) or not isinstance(value, (int, float, np.integer, np.floating)):
        raise TypeError(f"{name} must be a number ({unit}), got {value!r}")
    if not math.isfinite(value):
        raise ValueError(f"{name} must be finite ({unit}), got {value!r}")
    return float(value)
