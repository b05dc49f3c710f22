"""Report of a count: a model's answers for recordings, and their evidence."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cyclofeat import __version__
from cyclofeat._base.quantities import in_words, number_of
from cyclofeat.plotting.drawing import require_matplotlib
from cyclofeat.plotting.kinds import feature_of, words_of
from cyclofeat.report._page import (
    check_page_path,
    count_heading,
    count_text,
    describe_origin,
    lobes_text,
    probability_text,
    summary_tile,
    versions_line,
    write_page,
)

if TYPE_CHECKING:
    import os

    from cyclofeat.counting import LobeCount, LobeModel
    from cyclofeat.recordings import Recording

_N_FEATURE_PICTURES = 4
MOST_SAMPLES = 240_000  # of torque in a page, which they make 1.3 MB larger


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
    """

    name: str
    recording: Recording
    count: LobeCount


def write_count_report(
    model: LobeModel,
    counted: Iterable[CountedRecording],
    path: str | os.PathLike[str],
    *,
    failures: Mapping[str, str] | None = None,
    settings: Mapping[str, object] | None = None,
    most_sections: int = 12,
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
    most_sections : int, default=12
        Recordings with a section: refused ones first, then the least probable. The others have only a line in
        the table (a section takes 1 to 2 MB).

    Raises
    ------
    ImportError
        If jinja2 or matplotlib is not installed.
    FileNotFoundError
        If the folder does not exist.
    ValueError
        If there is nothing to report, or ``most_sections`` is negative.

    Examples
    --------
    >>> from cyclofeat.report import CountedRecording, write_count_report
    >>> recording = read_recording("rig.tdms", speed_rpm=500)  # doctest: +SKIP
    >>> counted = [CountedRecording("rig.tdms", recording, model.count(recording))]  # doctest: +SKIP
    >>> write_count_report(model, counted, "count.html")  # doctest: +SKIP
    """
    target = check_page_path(path)
    summary = summarise_count(
        model, counted, failures=failures, settings=settings, most_sections=most_sections
    )
    return write_page(target, "count.html", summary)


def summarise_count(
    model: LobeModel,
    counted: Iterable[CountedRecording],
    *,
    failures: Mapping[str, str] | None = None,
    settings: Mapping[str, object] | None = None,
    most_sections: int = 12,
) -> dict[str, Any]:
    """Summarise a count in plain values that JSON can hold.

    Parameters and errors are those of :func:`write_count_report`; pictures are data URIs.

    Returns
    -------
    dict
        ``title``, ``version``, ``surrogate``, ``origin``, ``several``, ``tiles`` (summary), ``rows`` (one per
        recording), ``with_stated``, ``with_wear``, ``failures``, ``sections``, ``n_more`` (recordings without
        section), ``features`` (definitions of those drawn), ``n_lobes``, ``calibrated``, ``model`` and
        ``provenance``.
    """
    if most_sections < 0:
        raise ValueError(f"most_sections must not be negative, got {most_sections!r}")
    require_matplotlib()
    rows: list[dict[str, Any]] = []
    sources: list[str | None] = []
    urgent: list[tuple[int, CountedRecording]] = []
    for place, item in enumerate(counted):
        rows.append(_table_row(item))
        sources.append(item.recording.source)
        urgent = sorted([*urgent, (place, item)], key=_sort_key)[:most_sections]
    failed = {str(name): str(reason) for name, reason in (failures or {}).items()}
    if not rows and not failed:
        raise ValueError("counted must hold at least one recording, got none")
    sections = []
    for place, item in sorted(urgent, key=lambda one: one[0]):
        rows[place]["anchor"] = f"recording-{place + 1}"
        sections.append(rows[place] | _recording_section(model, item, MOST_SAMPLES // len(urgent)))
    _, surrogate, said_of_origin = describe_origin(sources)
    several = len(rows) + len(failed) > 1
    return {
        "title": "Worn lobes" if several or not rows else f"Worn lobes: {rows[0]['name']}",
        "version": __version__,
        "surrogate": surrogate,
        "origin": said_of_origin if rows else "",
        "several": several,
        "tiles": _summary_tiles(rows, failed),
        "rows": rows,
        "with_stated": any(row["stated"] for row in rows),
        "with_wear": any(row["wear"] for row in rows),
        "failures": [{"name": name, "reason": reason} for name, reason in failed.items()],
        "sections": sections,
        "n_more": len(rows) - len(sections),
        "features": _feature_definitions(sections),
        "n_lobes": model.n_lobes_,
        "calibrated": bool(model.card_.get("calibrated")),
        "model": _describe_model(model),
        "provenance": [
            *((str(label), str(value)) for label, value in (settings or {}).items()),
            ("made with", versions_line()),
        ],
    }


def _sort_key(placed: tuple[int, CountedRecording]) -> tuple[bool, float]:
    """Sorting key: refused recordings first, then the least probable."""
    count = placed[1].count
    return not count.refused, count.probability[count.defect_count]


def _summary_tiles(rows: Sequence[Mapping[str, Any]], failed: Mapping[str, str]) -> list[dict[str, Any]]:
    """Tiles of the summary: recordings counted, the worst, and those that need a look."""
    sound = [row for row in rows if not row["refused"]]
    by_count = Counter(row["count"] for row in sound)
    parts = [f"{n} with {count_text(count, ())}" for count, n in sorted(by_count.items())]
    tiles = [summary_tile("Counted", f"{len(sound)} of {len(rows) + len(failed)}", ", ".join(parts))]
    if sound:
        worst = max(by_count)
        names = [row["name"] for row in sound if row["count"] == worst]
        tiles.append(summary_tile("Worst", count_heading(worst), _first_names(names) if worst else "in any"))
    refused = [row["name"] for row in rows if row["refused"]]
    if refused:
        tiles.append(
            summary_tile("Refused", str(len(refused)), f"not reliable: {_first_names(refused)}", True)
        )
    if failed:
        tiles.append(summary_tile("Could not be counted", str(len(failed)), _first_names(list(failed)), True))
    wrong = [row["name"] for row in sound if row["wrong"]]
    if wrong:
        tiles.append(summary_tile("Other than stated", str(len(wrong)), _first_names(wrong), True))
    return tiles


def _first_names(names: Sequence[str], most: int = 3) -> str:
    """The first of many names."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more


def _table_row(item: CountedRecording) -> dict[str, Any]:
    """Line of a recording in the table; the anchor of its section is added later."""
    count, recording = item.count, item.recording
    stated = recording.defect_count
    return {
        "anchor": "",
        "name": str(item.name),
        "count": count.defect_count,
        "lobes": lobes_text(count.lobes, count.absolute),
        "probability": probability_text(count.probability[count.defect_count]),
        "refused": count.refused,
        "n_warnings": len(count.warnings),
        "wear": None if count.wear_um is None else count.wear_um.in_words(),
        "stated": "" if stated is None else str(stated),
        "wrong": stated is not None and stated != count.defect_count,
    }


def _recording_section(model: LobeModel, item: CountedRecording, most_samples: int) -> dict[str, Any]:
    from cyclofeat.datasets import describe
    from cyclofeat.datasets.readers import record_warnings

    count, recording = item.count, item.recording
    shares = sorted(count.probability.items())
    speed_hz = model.speed_of(recording)
    described = describe(recording.replace(speed_rpm=60 * speed_hz), reduction=model.n_lobes_)
    of_record = record_warnings(recording, reduction=model.n_lobes_)
    # Return the answer of each window.
    window_table = [
        {
            "time": f"{window.start_s:.4g} to {window.stop_s:.4g} s",
            "count": window.defect_count,
            "probability": probability_text(window.probability),
            "reason": window.reason,
        }
        for window in count.windows
    ]
    return {
        "heading": count_heading(count.defect_count),
        "reason": count.reason,
        "speed_known": _speed_known(item),
        "warnings": list(dict.fromkeys([*count.warnings, *of_record])),
        "shares": [{"count": c, "value": p, "text": probability_text(p)} for c, p in shares],
        "windows": f"{number_of(count.n_windows, 'window')} of one output turn "
        f"({count.windows[0].stop_s - count.windows[0].start_s:.4g} s)",
        "stated_text": ""
        if recording.defect_count is None
        else count_text(recording.defect_count, recording.worn_lobes),
        "lobe_table": [
            {"lobe": lobe + 1, "value": share, "text": probability_text(share), "worn": lobe in count.lobes}
            for lobe, share in enumerate(count.lobe_probability)
        ],
        "relative": bool(count.lobe_probability) and not count.absolute,
        "recorded": _describe_recorded(model, item, described),
        "window_table": window_table,
        **_draw_evidence(model, item, speed_hz, most_samples),
    }


def _speed_known(item: CountedRecording) -> bool:
    """Return True if the speed is known by a tachometer, or the torque is like that of training."""
    return item.recording.angle is not None or not item.count.refused


def _describe_recorded(
    model: LobeModel, item: CountedRecording, described: Mapping[str, Any]
) -> list[tuple[str, str]]:
    """Describe the recording: label and value."""
    recording = item.recording
    angle = "none: no tachometer"
    if recording.angle is not None:
        zero = "absolute" if recording.angle_is_absolute else "relative"
        angle = f"of the {recording.angle_of} shaft, {zero}"
    stated, measured = recording.speed_rpm, described["speed_measured_rpm"]
    if not _speed_known(item):
        by = "not found: refused, and without a tachometer"
    elif measured is None:
        by = "not found: no lobe lines stand out of the torque"
    else:
        by = f"{measured:.5g} RPM, by the {'tachometer' if recording.angle is not None else 'lobe lines'}"
    lines = {
        "length": f"{recording.duration:.4g} s, {recording.sampling_rate:g} Hz",
        in_words(recording.quantity): f"{recording.torque.min():.4g} to {recording.torque.max():.4g} "
        f"{recording.unit}, mean {recording.torque.mean():.4g} {recording.unit}",
        "speed stated": f"{stated:g} RPM, the nominal speed by file or option"
        if stated is not None
        else "none",
        "speed measured": by,
        "load stated": None if recording.load_nm is None else f"{recording.load_nm:g} Nm",
        "angle": angle,
        "assembly": recording.assembly,
        "source": recording.source or "not stated",
    }
    return [(label, str(value)) for label, value in lines.items() if value is not None]


def _draw_evidence(
    model: LobeModel, item: CountedRecording, speed_hz: float, most_samples: int
) -> dict[str, Any]:
    """Pictures of a recording, and of its features if the model has a training domain."""
    from cyclofeat.plotting import (
        LobeMapDisplay,
        LobeMarks,
        OrderDisplay,
        SpectrumDisplay,
        TorqueDisplay,
        TrainingDisplay,
    )
    from cyclofeat.report._figures import distance_picture, feature_picture, recording_pictures, window_spans

    count, recording = item.count, item.recording
    if recording.angle_is_absolute and count.lobe_probability and not count.absolute:
        # The model counts lobes from the first sample, and so must the picture.
        recording = recording.replace(angle_is_absolute=False)
    torque = TorqueDisplay.from_recording(recording)
    of_torque: dict[str, Any] = {"windows": window_spans(count.windows), "most_samples": most_samples}
    if _speed_known(item):
        lobe_map = LobeMapDisplay.from_recording(
            recording,
            input_speed_hz=speed_hz,
            n_lobes=model.n_lobes_,
            marks=LobeMarks(counted=count.lobes, probability=count.lobe_probability or None),
            outline=_disc_outline(model.n_lobes_, count.lobes),
        )
        at: dict[str, Any] = {"input_speed_hz": lobe_map.input_speed_hz, "n_lobes": model.n_lobes_}
        pictures = recording_pictures(
            torque,
            SpectrumDisplay.from_recording(recording, **at),
            OrderDisplay.from_recording(recording, **at),
            lobe_map,
            **of_torque,
        )
    else:
        # Lines marked at a wrong speed would mislead.
        unmarked = SpectrumDisplay.from_recording(recording.replace(speed_rpm=None))
        pictures = recording_pictures(torque, unmarked, **of_torque)
    evidence: dict[str, Any] = {"pictures": pictures, "distance": None, "features": []}
    if model.domain_ is not None:
        display = TrainingDisplay.from_estimator(model, recording)
        nearest = tuple(sorted(count.probability, key=lambda c: -count.probability[c])[:2])
        evidence["distance"] = distance_picture(display)
        evidence["features"] = [
            {
                "kind": kind,
                "title": words_of(kind).title,
                "text": words_of(kind).text,
                "picture": feature_picture(display, kind, nearest),
            }
            for kind in (display.kinds[:_N_FEATURE_PICTURES] if _speed_known(item) else ())
        ]
    return evidence | {"territory": _describe_distance(count)}


def _feature_definitions(sections: Sequence[Mapping[str, Any]]) -> list[dict[str, str]]:
    """Title, name in the code and formula of each kind of feature that is drawn."""
    kinds = dict.fromkeys(drawn["kind"] for section in sections for drawn in section["features"])
    rows = {kind: feature_of(kind) for kind in kinds}
    return [
        {
            "title": words_of(kind).title,
            "name": kind,
            "formula": "" if row is None else f"{row.formula} ({row.source})",
        }
        for kind, row in rows.items()
    ]


def _disc_outline(n_lobes: int, worn: tuple[int, ...]) -> Any:
    """Outline of a disc in the proportions of the papers: recordings do not state their gearbox."""
    from cyclofeat.simulators.gearbox import CycloidalProfile

    n_pins = n_lobes + 1
    profile = CycloidalProfile(
        eccentricity=0.7 / n_pins, n_pins=n_pins, shortening=0.7, pin_radius=1.5 / n_pins
    )
    return profile.outline(worn)


def _describe_distance(count: LobeCount) -> dict[str, str]:
    """Describe the distance of the recording from the training windows."""
    if np.isnan(count.distance):
        return {"heading": "Unknown", "text": "the model does not know what it was trained on"}
    return {
        "heading": "Outside" if count.distance > 1 else "Inside",
        "text": f"what the model was trained on: distance {count.distance:.2f}, where 1 is the edge",
    }


def _describe_model(model: LobeModel) -> list[tuple[str, str]]:
    from cyclofeat.counting.evaluation.evaluation import score_text

    card = model.card_
    scores = card.get("cross_validation")
    sources = ", ".join(card.get("sources", ()))
    lines = {
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
    return [(label, str(value)) for label, value in lines.items() if value is not None]
