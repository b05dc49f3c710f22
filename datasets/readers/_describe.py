"""Description of a recording, with warnings of what would spoil a count."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from cyclofeat._base.quantities import from_1, in_words, lobes_text, number_of, source_in_words
from cyclofeat.datasets.readers._words import WORN, samples_name
from cyclofeat.recordings import Recording
from cyclofeat.recordings.windower import SAMPLES_PER_TURN, WINDOW_TURNS
from cyclofeat.signal.faults import clipped_share, mark_dropouts
from cyclofeat.signal.speed import follow_speed, search_speed

# Shares and deviations above which a count suffers.
_MOST_CLIPPED, _MOST_DROPPED, _SPEED_TOLERANCE = 1e-3, 1e-4, 0.015
# Parts of a record whose mean torque and speed are compared with the median; the shares by which those lie
# off it where a run-up begins, and where it goes on (a load that drifts lies off it, too).
_PARTS, _OTHER_LEVEL, _OTHER_SPEED = 50, (0.5, 0.2), (0.1, 0.1)

# Facts that a recording's meta and attributes of these names state.
_OF_FILE = ("file", "rate_from", "time_jitter", "gaps", "part", "start_time", "table")
_OF_RECORDING = (
    "quantity", "unit", "sampling_rate", "n_samples", "speed_rpm", "load_nm", "assembly", "run",
    "defect_count", "source",
)  # fmt: skip


def describe(recording: Recording) -> dict[str, Any]:
    """Describe a recording: content, defects of the record, and what would spoil a count.

    Parameters
    ----------
    recording : Recording
        Its ``n_lobes`` is the number of input turns per output turn.

    Returns
    -------
    dict
        Values that JSON can hold; unknown ones are None. Content: ``file``, ``channel``, ``quantity``,
        ``unit``, ``unit_assumed``, ``minimum``, ``maximum``, ``mean``, ``std`` (in that unit), ``constant``,
        ``sampling_rate`` (Hz), ``rate_from``, ``n_samples``, ``duration_s``, ``angle`` (shaft and kind of
        zero), ``angle_unit_assumed``, ``speed_rpm``, ``load_nm``, ``assembly``, ``run``, ``defect_count``,
        ``worn_lobes_from_1``, ``source``, ``time_jitter`` (samples), ``gaps`` (list of [sample after it,
        samples missing]), ``part`` (stretch between gaps), ``start_time``, ``table`` (how a text was read).

        ``clipped_share``, ``dropout_share`` : shares of samples at the record's largest or smallest value,
        where samples pile up there; and of those that repeat one value for long, or are 0 amid other values.

        ``speed_measured_rpm`` : input speed by the angle, else by the lobe lines (``speed_from``), and its
        relative deviation ``speed_deviation`` from the nominal one. ``output_turns`` : length of the record.
        ``run_up_s`` : time at the start, in s, in which speed or mean torque differ from the rest.

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
    >>> round(facts["clipped_share"], 2), round(facts["output_turns"], 2)
    (0.14, 1.11)
    """
    facts = _recording_facts(recording, search=True)
    warnings = _record_warnings(recording, facts)
    if facts["constant"]:
        return facts | {"warnings": warnings}
    # The gravest first.
    notes = []
    if (turns := facts["output_turns"]) is not None and turns < WINDOW_TURNS:
        notes.append(f"the record holds {turns:.3g} output turns, a count needs {WINDOW_TURNS}")
    speed = recording.speed_rpm if facts["speed_measured_rpm"] is None else facts["speed_measured_rpm"]
    if speed is None:
        notes.append("no speed is stated: the length of an output turn is not known")
    elif recording.sampling_rate < (needed := SAMPLES_PER_TURN * speed / 60):
        notes.append(
            f"{recording.sampling_rate:g} Hz are too few for all lobe lines of a count, which need "
            f"{needed:.0f} Hz: from fewer lines it is less accurate, and needs a model trained on them"
        )
    relative = [] if recording.angle is not None else ["no angle: positions of lobes will be relative"]
    return facts | {"warnings": notes + warnings + relative}


def record_warnings(recording: Recording) -> list[str]:
    """Return the warnings of :func:`describe` that a count does not give itself.

    A count states the speed that it finds in the torque, and that positions are relative; a short record, no
    speed or too low a rate are its errors. No speed is sought here, which takes the most time.
    """
    return _record_warnings(recording, _recording_facts(recording, search=False))


def _recording_facts(recording: Recording, *, search: bool) -> dict[str, Any]:
    """Return the description without warnings; ``search`` measures the speed in a record without angle."""
    torque, meta, counted = recording.torque, recording.meta or {}, recording.for_counting()
    low, high = float(torque.min()), float(torque.max())
    speed, speed_from = recording.mean_input_speed(), "angle"
    nominal = recording.input_speed_hz
    if speed is None and search:
        speed, speed_from = _speed_of_lines(counted), "lobe lines"
    known = speed or nominal
    samples = torque
    if recording.bad_spans:  # as marked: they are not counted
        edges = np.ceil(np.array(recording.bad_spans) * recording.sampling_rate).astype(int)
        samples = np.delete(torque, np.r_[tuple(slice(*ends) for ends in edges)])
        samples = samples if samples.size else torque
    drops = np.zeros(samples.size, dtype=bool) if low == high else mark_dropouts(samples)
    rest = samples[~drops] if drops.any() else samples
    return {
        **{name: meta.get(name) for name in _OF_FILE},
        **{name: getattr(recording, name) for name in _OF_RECORDING},
        "channel": meta.get("channel", samples_name(recording)),
        "unit_assumed": bool(meta.get("unit_assumed", False)),
        "angle_unit_assumed": bool(meta.get("angle_unit_assumed", False)),
        "minimum": low,
        "maximum": high,
        "mean": float(torque.mean()),
        "std": float(torque.std()),
        "constant": low == high,
        "duration_s": recording.duration,
        "angle": _angle_text(recording),
        WORN: None if recording.worn_lobes is None else from_1(recording.worn_lobes),
        "clipped_share": 0.0 if low == high else float(clipped_share(rest) * np.mean(~drops)),
        "dropout_share": float(np.mean(drops)),
        "speed_measured_rpm": None if speed is None else 60 * speed,
        "speed_from": None if speed is None else speed_from,
        "speed_deviation": None if speed is None or nominal is None else speed / nominal - 1,
        "output_turns": None if known is None else recording.duration * known / recording.n_lobes,
        "run_up_s": _run_up_time(counted),
    }


def _angle_text(recording: Recording) -> str | None:
    zero = "absolute" if recording.angle_is_absolute else "relative"
    return None if recording.angle is None else f"{recording.angle_of}, {zero}"


def _run_up_time(recording: Recording) -> float | None:
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


def _speed_of_lines(recording: Recording) -> float | None:
    """Return the input speed in turns per second by the lobe lines; None unless one speed fits."""
    torque, rate, nominal = recording.torque, recording.sampling_rate, recording.input_speed_hz
    try:
        if nominal is None:
            speeds = search_speed(torque, rate, recording.n_lobes)
        else:
            speeds = [follow_speed(torque, rate, nominal, recording.n_lobes)]
    except ValueError:  # too short, or too low a rate for the lines
        return None
    return speeds[0].speed_hz if len(speeds) == 1 and speeds[0].fits else None


def _record_warnings(recording: Recording, facts: dict[str, Any]) -> list[str]:
    """Warnings of the record itself, whatever is counted in it, the gravest first."""
    if facts["constant"]:
        return [
            f"the record is constant ({facts['minimum']:g} {facts['unit']}): sensor dead, not connected, or "
            "at the end of its range?"
        ]
    notes = []
    if (run_up := facts["run_up_s"]) is not None:
        notes.append(
            f"run-up at the start: leave it out with --skip {run_up:g}, in Python recording.crop({run_up:g})"
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
    return notes + list((recording.meta or {}).get("time_notes", []))


def one_line(recording: Recording) -> str:
    """Describe a recording in one line for people, lobes counted from 1.

    Examples
    --------
    >>> one_line(Recording([21.0, 23.0], 2_000, run="r7", worn_lobes=(0, 4)))
    "run 'r7': torque 21 to 23 Nm (mean 22), 2000 Hz, 2 samples = 0.001 s, no angle, 2 worn lobes (1, 5)"
    """
    torque, meta = recording.torque, recording.meta or {}
    channel, quantity = meta.get("channel", samples_name(recording)), in_words(recording.quantity)
    if recording.quantity != "output_torque":
        channel = quantity if channel == recording.quantity else f"{quantity} ({channel})"
    low, high, lobes = torque.min(), torque.max(), lobes_text(recording.worn_lobes, recording.n_lobes)
    unit = recording.unit + (" (unit assumed)" if meta.get("unit_assumed") else "")
    worn, angle = f" ({lobes})" if lobes else "", _angle_text(recording)
    origin = {name: f" from {meta[name]}" for name in ("rate_from", "speed_from") if meta.get(name)}
    names = [
        str(meta.get("file") or ""),
        f"part {meta['part']}" if meta.get("part") else "",
        "" if recording.run is None else f"run {recording.run!r}",
        "" if recording.assembly is None else f"assembly {recording.assembly!r}",
    ]
    parts = [
        f"{channel} {low:.4g} to {high:.4g} {unit} (mean {torque.mean():.4g})",
        "CONSTANT" if low == high else "",
        f"{recording.sampling_rate:g} Hz{origin.get('rate_from', '')}",
        f"{recording.n_samples} samples = {recording.duration:.4g} s",
        "" if recording.speed_rpm is None else f"{recording.speed_rpm:g} RPM{origin.get('speed_from', '')}",
        "" if recording.load_nm is None else f"load {recording.load_nm:g} Nm",
        f"angle of the {angle}" if angle else "no angle",
        "" if recording.defect_count is None else number_of(recording.defect_count, "worn lobe") + worn,
        source_in_words(recording.source),
    ]
    return ": ".join(filter(None, [", ".join(filter(None, names)), ", ".join(filter(None, parts))]))
