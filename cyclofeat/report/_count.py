"""Report of a count: a model's answers for recordings, and their evidence."""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cyclofeat._base.quantities import in_words, lobes_text, source_in_words
from cyclofeat.plotting import TrainingDisplay
from cyclofeat.plotting.drawing import words_of
from cyclofeat.recordings.recording import facts_in_words
from cyclofeat.report import _figures
from cyclofeat.report._page import check_page_path, count_text, describe_origin, write_page
from cyclofeat.signal.lobes import SPEED_TOLERANCE

if TYPE_CHECKING:
    import os

    from cyclofeat.counting import LobeCount, LobeModel
    from cyclofeat.recordings import Recording

_N_FEATURE_PICTURES = 4
_MOST_SECTIONS = 6
_BESIDE_TRAINING = (6.0, 3.2)  # inches


@dataclass(frozen=True)
class CountedRecording:
    """Recording with a model's answer.

    Parameters
    ----------
    name : str
        Name in the report, usually of the file.
    recording : Recording
    count : cyclofeat.counting.LobeCount
        Answer of ``model.count(recording)``.
    model : cyclofeat.counting.LobeModel, optional
        The model that counted it. Default: that of the report.
    """

    name: str
    recording: Recording
    count: LobeCount
    model: LobeModel | None = None


def write_count_report(
    model: LobeModel,
    counted: Iterable[CountedRecording],
    path: str | os.PathLike[str],
    *,
    failures: Mapping[str, str] | None = None,
    settings: Mapping[str, object] | None = None,
    most_sections: int = _MOST_SECTIONS,
) -> Path:
    """Write the report of a count as one HTML file, and return its path.

    The answer comes first: count, lobes, probability, set of counts if the model gives one, and warnings.
    Then the evidence: the disc with its lobes, torque, spectrum, orders, and the features beside those of the
    training windows. Several recordings have a summary and a table before their sections. For a recording
    that was refused and has no tachometer, the report omits pictures that need its speed. A file of that name
    is replaced.

    Parameters
    ----------
    model : cyclofeat.counting.LobeModel
    counted : iterable of CountedRecording
        Iterated once. Of a generator, only recordings with a section stay in memory.
    path : path-like
        File to write, ``*.html``.
    failures : mapping from str to str, optional
        Recordings that could not be counted: name to reason. Read after ``counted``.
    settings : mapping, optional
        Other settings, label to value.
    most_sections : int, default=6
        Recordings with a section: refused ones first, then the least probable. The others have only a line in
        the table (a section takes some 0.4 MB).

    Returns
    -------
    pathlib.Path

    Raises
    ------
    ValueError
        If there is nothing to report, or ``most_sections`` is negative.

    Examples
    --------
    >>> from cyclofeat.report import CountedRecording, write_count_report
    >>> recording = read_recording("rig.tdms", speed_rpm=500)  # doctest: +SKIP
    >>> counted = [CountedRecording("rig.tdms", recording, model.count(recording))]  # doctest: +SKIP
    >>> write_count_report(model, counted, "count.html")  # doctest: +SKIP
    """
    from cyclofeat.counting.evaluation.evaluation import count_reasons

    check_page_path(path)
    if most_sections < 0:
        raise ValueError(f"most_sections must not be negative, got {most_sections!r}")
    rows: list[dict[str, Any]] = []
    sources: list[str | None] = []
    others: dict[str, object] = {}
    urgent: list[tuple[bool, float, int, CountedRecording]] = []
    for place, item in enumerate(counted):
        row = _answer_row(item)
        rows.append(row)
        sources.append(item.recording.source)
        if item.model is not None and item.model is not model:
            label = f"model for {in_words(item.recording.quantity)} trained on"
            others[label] = item.model.card_["description"]
        # Refused recordings are the most urgent, then the least probable.
        entry = (not row["refused"], row["probability"], place, item)
        urgent = heapq.nsmallest(most_sections, [*urgent, entry])
    failed = [{"name": str(name), "reason": str(reason)} for name, reason in (failures or {}).items()]
    if not rows and not failed:
        raise ValueError("counted must hold at least one recording, got none")
    sections = []
    for *_, place, item in sorted(urgent, key=lambda entry: entry[2]):
        rows[place]["anchor"] = f"recording-{place + 1}"
        drawn = _recording_section(item.model or model, item, _figures.MOST_SAMPLES // len(urgent))
        sections.append(rows[place] | drawn)
    _, surrogate, origin = describe_origin(sources)
    several = len(rows) + len(failed) > 1
    kinds = dict.fromkeys(drawn["kind"] for section in sections for drawn in section["features"])
    summary = {
        "title": "Worn lobes" if several or not rows else f"Worn lobes: {rows[0]['name']}",
        "surrogate": surrogate,
        "origin": origin if rows else "",
        "several": several,
        "reasons": count_reasons(row["reason"] for row in rows),
        "rows": rows,
        "failures": failed,
        "sections": sections,
        "n_more": len(rows) - len(sections),
        "features": [{"name": kind} | vars(words_of(kind)) for kind in kinds],
        "n_lobes": model.n_lobes_,
        "calibrated": bool(model.card_.get("calibrated")),
        "model": _describe_model(model),
        "provenance": dict(settings or {}) | others,
    }
    return write_page(path, "count.html", summary)


def _answer_row(item: CountedRecording) -> dict[str, Any]:
    """Return the answer of a model for a recording."""
    count, stated = item.count, item.recording.defect_count
    return {
        "anchor": "",
        "name": str(item.name),
        "count": count.defect_count,
        "lobes": lobes_text(count.lobes, item.recording.n_lobes),
        "relative": bool(count.lobe_probability) and not count.absolute,
        "probability": count.probability[count.defect_count],
        "refused": count.refused,
        "reason": count.reason,
        "n_warnings": len(count.warnings),
        "wear": None if count.wear_um is None else count.wear_um.in_words(),
        "stated": stated,
        "wrong": stated is not None and stated != count.defect_count,
    }


def _recording_section(model: LobeModel, item: CountedRecording, most_samples: int) -> dict[str, Any]:
    from cyclofeat.counting.model.turning import turning_of
    from cyclofeat.datasets import describe
    from cyclofeat.datasets.readers import record_warnings

    count, recording = item.count, item.recording
    speed_hz, turned_hz = recording.input_speed_hz, turning_of(recording, model.n_lobes_).speed_hz
    if speed_hz is None or abs(turned_hz / speed_hz - 1) > SPEED_TOLERANCE:
        # At least so fast that the recording holds one output turn.
        speed_hz = max(turned_hz, model.n_lobes_ / recording.duration)
    described = describe(recording.replace(speed_rpm=60 * speed_hz, n_lobes=model.n_lobes_))
    # The speed is known by a tachometer, or if the torque is like that of training.
    speed_known = recording.angle is not None or not count.refused
    measured = described["speed_measured_rpm"]
    if not speed_known:
        by = "not found: refused, and without a tachometer"
    elif measured is None:
        by = "not found: no lobe lines stand out of the torque"
    else:
        by = f"{measured:.5g} RPM, by the {'tachometer' if recording.angle is not None else 'lobe lines'}"
    stated = recording.speed_rpm
    of_record = record_warnings(recording.replace(n_lobes=model.n_lobes_))
    return {
        "speed_known": speed_known,
        "warnings": list(dict.fromkeys([*count.warnings, *of_record])),
        "shares": dict(sorted(count.probability.items())),
        "windows": [window.to_dict() for window in count.windows],
        "window_turns": model.windower_.output_turns,
        "stated_text": ""
        if recording.defect_count is None
        else count_text(recording.defect_count, recording.worn_lobes, recording.n_lobes),
        "lobe_shares": list(count.lobe_probability),
        "lobes_counted": list(count.lobes),
        "recorded": {
            **facts_in_words(recording),
            "input speed": None,
            "speed stated": "none"
            if stated is None
            else f"{stated:g} RPM, the nominal speed by file or option",
            "speed measured": by,
            "source": source_in_words(recording.source) or "not stated",
        },
        "training_distance": None if np.isnan(count.distance) else float(count.distance),
        "pictures": _figures.recording_pictures(
            recording.replace(n_lobes=model.n_lobes_), count, speed_hz if speed_known else None, most_samples
        ),
        "features": [] if model.domain_ is None or not speed_known else _draw_features(model, item),
    }


def _draw_features(model: LobeModel, item: CountedRecording) -> list[dict[str, Any]]:
    """Draw the features of a recording beside the training windows of its count and of those next to it."""
    recording, trained, count = item.recording, sorted(item.count.probability), item.count.defect_count
    if item.count.lobe_probability and not item.count.absolute:  # lobes count from the first sample
        recording = recording.replace(angle_is_absolute=False)
    display = TrainingDisplay(model, recording)
    place = trained.index(count)
    # Is it one less, or one more?
    counts = (count, *trained[max(0, place - 1) : place], *trained[place + 1 : place + 2])
    alt = f"Features of the recording beside training windows with {', '.join(map(str, counts))} worn lobes: "
    features = []
    for kind in display.kinds[:_N_FEATURE_PICTURES]:
        words, draw = words_of(kind), partial(display.plot, kind=kind, counts=counts)
        picture = _figures.draw_picture(draw, _BESIDE_TRAINING, alt + words.title)
        features.append({"kind": kind, "title": words.title, "text": words.text, "picture": picture})
    return features


def _describe_model(model: LobeModel) -> dict[str, Any]:
    from cyclofeat.counting.evaluation.evaluation import score_text

    card = model.card_
    scores = card.get("cross_validation")
    sources = ", ".join(card.get("sources", ()))
    return {
        "trained on": card.get("description") or "not stated",
        "source": f"{sources} recordings" if sources else None,
        "windows": card.get("n_windows"),
        "counts": ", ".join(map(str, card["classes"])),
        "for recordings": model.made_for(),
        "depth of wear": None if model.wear_ is None else model.wear_.made_for(),
        "cross-validation": "none: accuracy unknown"
        if scores is None
        else f"{score_text(scores)}; window by window, {scores['n_assemblies']} assemblies held out in turn, "
        f"{100 * scores['confidence']:.3g} % interval",
        "versions": ", ".join(f"{name} {value}" for name, value in card["versions"].items()),
    }
