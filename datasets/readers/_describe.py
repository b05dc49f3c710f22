"""Description of a recording, with warnings of what would spoil a count."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from cyclofeat._base.quantities import from_1, in_words, lobes_text, number_of
from cyclofeat.datasets.readers._labels import WORN, samples_name
from cyclofeat.recordings import Recording
from cyclofeat.recordings.windower import SAMPLES_PER_TURN
from cyclofeat.signal.faults import clipped_share, mark_dropouts
from cyclofeat.signal.speed import follow_speed, search_speed

# Shares and deviations above which a count suffers.
_MOST_CLIPPED, _MOST_DROPPED, _SPEED_TOLERANCE = 1e-3, 1e-4, 0.015
# Parts of a record whose mean torque and speed are compared with the median; the shares by which those lie
# off it where a run-up begins, and where it goes on (a load that drifts lies off it, too).
_PARTS, _OTHER_LEVEL, _OTHER_SPEED = 50, (0.5, 0.2), (0.1, 0.1)


def describe(recording: Recording, *, reduction: int | None = None) -> dict[str, Any]:
    """Describe a recording: content, defects of the record, and what would spoil a count.

    Parameters
    ----------
    recording : Recording
    reduction : int, optional
        Input turns per output turn: the number of lobes. Default: what the recording states.

    Returns
    -------
    dict
        All of :func:`describe_recording`, and

        ``clipped_share`` : share of samples at the record's largest or smallest value where samples pile up
        there (runs of three and more, four times as many as at the next value).

        ``dropout_share`` : share of samples that repeat one value for much longer than usual, or are exactly
        0 between values far from it.

        ``speed_measured_rpm`` : input speed by the angle, else by the lobe lines near the nominal speed, or
        None. ``speed_from`` : "angle", "lobe lines" or None. ``speed_deviation`` : its relative deviation
        from the nominal speed, or None.

        ``output_turns`` : output turns recorded, by the measured speed, else the nominal one, or None.
        ``whole_output_turns`` (int) and ``unused_s`` : the rest after them, in s.

        ``run_up_s`` : time at the start, in s, in which speed or mean torque differ from the rest of the
        record, or None.

        ``angle_unit_assumed`` (bool), ``time_jitter`` (samples, or None), ``start_time`` (or None).

        ``warnings`` : list of str, what would spoil a count.

    Notes
    -----
    Lobe lines give the speed within 5.5 % of the nominal one, if they are those of a disc
    (``cyclofeat.signal.speed.follow_speed``); where none is stated, the only one that
    ``cyclofeat.signal.speed.search_speed`` finds. A constant record has neither clipped samples nor
    dropouts.

    Examples
    --------
    >>> import numpy as np
    >>> time = np.arange(51_200) / 25_600
    >>> torque = np.clip(22 + np.sin(2 * np.pi * 8 * time), None, 22.9)
    >>> facts = describe(Recording(torque, 25_600, speed_rpm=500))
    >>> round(facts["clipped_share"], 2), facts["whole_output_turns"]
    (0.14, 1)
    """
    reduction = _checked_reduction(recording, reduction)
    facts = _recording_facts(recording, *_measure_speed(recording, reduction), reduction)
    facts["warnings"] = _count_warnings(recording, facts, reduction)
    return facts


def record_warnings(recording: Recording, *, reduction: int | None = None) -> list[str]:
    """Return the warnings of :func:`describe` that a count does not give itself.

    A count states the speed that it finds in the torque, and that positions are relative. It raises an error
    where a recording is too short, has no speed or too low a sampling rate. Without the search for a speed,
    this takes less time than :func:`describe`.

    Parameters
    ----------
    recording : Recording
    reduction : int, optional
        As of :func:`describe`.

    Returns
    -------
    list of str

    Examples
    --------
    >>> record_warnings(Recording([21.0, 23.0], 25_600, meta={"time_jitter": 0.2}))
    ['the times jitter by up to 0.2 samples']
    """
    reduction = _checked_reduction(recording, reduction)
    speed = recording.mean_input_speed(reduction)
    return _record_warnings(recording, _recording_facts(recording, speed, "angle", reduction))


def _checked_reduction(recording: Recording, reduction: int | None) -> int:
    reduction = recording.n_lobes if reduction is None else reduction
    if reduction < 2:
        raise ValueError(f"reduction must be at least 2 (input turns per output turn), got {reduction!r}")
    return reduction


def _recording_facts(
    recording: Recording, speed: float | None, speed_from: str | None, reduction: int
) -> dict[str, Any]:
    """Return what :func:`describe` does, without warnings; ``speed`` is the measured one."""
    meta = recording.meta or {}
    facts = describe_recording(recording)
    nominal = recording.input_speed_hz
    known = speed or nominal
    turns = whole = unused = None
    if known is not None:
        turns = recording.duration * known / reduction
        whole = int(turns * (1 + 1e-6))  # a record of exactly one turn must not lose it to rounding
        unused = max(0.0, recording.duration * (1 - whole / turns))
    constant = facts["constant"]
    drops = np.zeros(recording.n_samples, dtype=bool) if constant else mark_dropouts(recording.torque)
    kept = recording.torque[~drops] if drops.any() else recording.torque
    clips = 0.0 if constant else float(clipped_share(kept) * np.mean(~drops))
    return facts | {
        "clipped_share": clips,
        "dropout_share": float(np.mean(drops)),
        "speed_measured_rpm": None if speed is None else 60 * speed,
        "speed_from": speed_from,
        "speed_deviation": None if speed is None or nominal is None else speed / nominal - 1,
        "output_turns": turns,
        "whole_output_turns": whole,
        "unused_s": unused,
        "run_up_s": _run_up(recording),
        "angle_unit_assumed": bool(meta.get("angle_unit_assumed", False)),
        "time_jitter": meta.get("time_jitter"),
        "start_time": meta.get("start_time"),
    }


def _run_up(recording: Recording) -> float | None:
    """Return how long a run-up at the start lasts, in s; None where there is none, or no steady rest."""
    size = recording.n_samples // _PARTS
    if not size:
        return None
    levels = [(recording.torque[: _PARTS * size].reshape(_PARTS, size).mean(axis=1), _OTHER_LEVEL)]
    if recording.angle is not None:
        edges = np.minimum(size * np.arange(_PARTS + 1), recording.n_samples - 1)
        levels.append((np.diff(recording.angle[edges]), _OTHER_SPEED))
    n_parts = 0
    for level, (begins, goes_on) in levels:
        usual = np.median(level)
        off, least = np.abs(level - usual), abs(usual)
        if off[0] > begins * least and off[_PARTS // 2 :].max() <= begins * least:
            n_parts = max(n_parts, int(np.argmax(off <= goes_on * least)))
    # With the next part, in which it may end; in tenths of a second.
    return math.ceil(10 * (n_parts + 1) * size / recording.sampling_rate) / 10 if n_parts else None


def _measure_speed(recording: Recording, reduction: int) -> tuple[float | None, str | None]:
    """Return the input speed in turns per second, and its source."""
    by_angle = recording.mean_input_speed(reduction)
    nominal = recording.input_speed_hz
    if by_angle is not None:
        return by_angle, "angle"
    torque, rate = recording.torque, recording.sampling_rate
    try:
        found = (
            search_speed(torque, rate, reduction)
            if nominal is None
            else [follow_speed(torque, rate, nominal, reduction)]
        )
    except ValueError:  # too short, or too low a rate for the lines
        return None, None
    if len(found) == 1 and found[0].fits:
        return found[0].speed_hz, "lobe lines"
    return None, None


def _count_warnings(recording: Recording, facts: dict[str, Any], reduction: int) -> list[str]:
    """Warnings of what would spoil a count, the gravest first."""
    notes = []
    if facts["whole_output_turns"] == 0:
        notes.append(
            f"the record holds {facts['output_turns']:.2g} output turns, a count needs one "
            f"({reduction} input turns)"
        )
    speed = facts["speed_measured_rpm"]
    if recording.speed_rpm is None and speed is None:
        notes.append("no speed is stated: the length of an output turn is not known")
    known = recording.speed_rpm if speed is None else speed
    if known is not None:
        needed = SAMPLES_PER_TURN * known / 60
        if recording.sampling_rate < needed:
            notes.append(
                f"{recording.sampling_rate:g} Hz are too few for all lobe lines of a count, which need "
                f"{needed:.0f} Hz: from fewer lines it is less accurate, and needs a model trained on them"
            )
    of_record = _record_warnings(recording, facts)
    if facts["constant"]:
        return of_record
    relative = [] if recording.angle is not None else ["no angle: positions of lobes will be relative"]
    return notes + of_record + relative


def _record_warnings(recording: Recording, facts: dict[str, Any]) -> list[str]:
    """Warnings of the record itself, whatever is counted in it, the gravest first."""
    if facts["constant"]:
        return [
            f"the record is constant ({facts['minimum']:g} {facts['unit']}): sensor dead or not connected?"
        ]
    notes = []
    if (run_up := facts["run_up_s"]) is not None:
        notes.append(
            f"run-up at the start: leave it out with --skip {run_up:g}, in Python recording.part({run_up:g})"
        )
    if facts["dropout_share"] > _MOST_DROPPED:
        notes.append(f"{100 * facts['dropout_share']:.2g} % of the samples are dropouts")
    if facts["clipped_share"] > _MOST_CLIPPED:
        notes.append(
            f"{100 * facts['clipped_share']:.2g} % of the samples are clipped at {facts['minimum']:g} or "
            f"{facts['maximum']:g} {facts['unit']}"
        )
    deviation = facts["speed_deviation"]
    if deviation is not None and abs(deviation) > _SPEED_TOLERANCE:
        notes.append(
            f"the input turns at {facts['speed_measured_rpm']:.5g} RPM by its {facts['speed_from']}, "
            f"{100 * deviation:+.2g} % off the nominal {recording.speed_rpm:.5g} RPM"
        )
    if facts["unit_assumed"]:
        notes.append(f"the file states no unit of {in_words(recording.quantity)}: {facts['unit']} assumed")
    if facts["angle_unit_assumed"]:
        notes.append("the file states no unit of the angle: rad assumed")
    if how := (recording.meta or {}).get("angle_from"):
        notes.append(f"the angle of the shaft {how}")
    if facts["time_jitter"]:
        notes.append(f"the times jitter by up to {facts['time_jitter']:g} samples")
    return notes


def describe_recording(recording: Recording) -> dict[str, Any]:
    """Describe the content of a recording: channel, unit, range, rate, duration and labels.

    Returns
    -------
    dict
        ``file``, ``channel``, ``quantity``, ``unit`` (that of the quantity, unless ``meta`` states another),
        ``unit_assumed`` (bool), ``minimum``, ``maximum``, ``mean``, ``std`` (in that unit), ``constant``
        (bool), ``sampling_rate`` (Hz), ``rate_from``, ``n_samples``, ``duration_s``, ``angle`` (None, or
        shaft and kind of zero), ``speed_rpm``, ``load_nm``, ``assembly``, ``run``, ``defect_count``,
        ``worn_lobes_from_1`` (list) and ``source``. Unknown values are None; JSON can hold all.

    Examples
    --------
    >>> facts = describe_recording(Recording([21.0, 23.0], 25_600, speed_rpm=500))
    >>> facts["unit"], facts["minimum"], facts["maximum"], facts["sampling_rate"], facts["n_samples"]
    ('Nm', 21.0, 23.0, 25600.0, 2)
    """
    torque = recording.torque
    meta = recording.meta or {}
    low, high = float(torque.min()), float(torque.max())
    angle = None
    if recording.angle is not None:
        angle = f"{recording.angle_of}, {'absolute' if recording.angle_is_absolute else 'relative'}"
    return {
        "file": meta.get("file"),
        "channel": meta.get("channel", samples_name(recording)),
        "quantity": recording.quantity,
        "unit": recording.unit,
        "unit_assumed": bool(meta.get("unit_assumed", False)),
        "minimum": low,
        "maximum": high,
        "mean": float(torque.mean()),
        "std": float(torque.std()),
        "constant": low == high,
        "sampling_rate": recording.sampling_rate,
        "rate_from": meta.get("rate_from"),
        "n_samples": recording.n_samples,
        "duration_s": recording.duration,
        "angle": angle,
        "speed_rpm": recording.speed_rpm,
        "load_nm": recording.load_nm,
        "assembly": recording.assembly,
        "run": recording.run,
        "defect_count": recording.defect_count,
        WORN: None if recording.worn_lobes is None else from_1(recording.worn_lobes),
        "source": recording.source,
    }


def one_line(recording: Recording) -> str:
    """Describe a recording in one line for people, lobes counted from 1.

    Examples
    --------
    >>> one_line(Recording([21.0, 23.0], 2_000, run="r7", worn_lobes=(0, 4)))
    "run 'r7': torque 21 to 23 Nm (mean 22), 2000 Hz, 2 samples = 0.001 s, no angle, 2 worn lobes (1, 5)"
    """
    facts = describe_recording(recording)
    names = [f"{key} {facts[key]!r}" for key in ("run", "assembly") if facts[key] is not None]
    name = ", ".join(([facts["file"]] if facts["file"] else []) + names)
    unit = facts["unit"] + (" (unit assumed)" if facts["unit_assumed"] else "")
    values = f"{facts['minimum']:.4g} to {facts['maximum']:.4g} {unit} (mean {facts['mean']:.4g})"
    channel, quantity = facts["channel"], in_words(recording.quantity)
    if recording.quantity != "output_torque":
        channel = quantity if channel == recording.quantity else f"{quantity} ({channel})"
    parts = [f"{channel} {values}"]
    if facts["constant"]:
        parts.append("CONSTANT")
    rate_from = f" from {facts['rate_from']}" if facts["rate_from"] else ""
    parts.append(f"{facts['sampling_rate']:g} Hz{rate_from}")
    parts.append(f"{facts['n_samples']} samples = {facts['duration_s']:.4g} s")
    if facts["speed_rpm"] is not None:
        parts.append(f"{facts['speed_rpm']:g} RPM")
    if facts["load_nm"] is not None:
        parts.append(f"load {facts['load_nm']:g} Nm")
    parts.append("no angle" if facts["angle"] is None else f"angle of the {facts['angle']}")
    if facts["defect_count"] is not None:
        lobes = lobes_text(recording.worn_lobes)
        count = facts["defect_count"]
        parts.append(number_of(count, "worn lobe") + (f" ({lobes})" if lobes else ""))
    if facts["source"]:
        parts.append(facts["source"])
    return f"{name}: {', '.join(parts)}" if name else ", ".join(parts)
