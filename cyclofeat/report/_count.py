"""The report of a count: what a model says of recordings, on what grounds, and how far to trust it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cyclofeat import __version__
from cyclofeat.plotting._base import require_matplotlib
from cyclofeat.recording import Windower
from cyclofeat.report._page import (
    count_text,
    lobes_text,
    number,
    origin,
    probability_text,
    target_of,
    versions,
    write_page,
)

if TYPE_CHECKING:
    import os

    from cyclofeat.counting import LobeCount, LobeModel
    from cyclofeat.recording import Recording
    from cyclofeat.report._figures import Picture

_N_FEATURE_PICTURES = 4


@dataclass(frozen=True)
class CountedRecording:
    """One recording with what a model said of it.

    Parameters
    ----------
    name : str
        As the report is to call it, usually its file.
    recording : Recording
    count : cyclofeat.counting.LobeCount
        What ``model.count(recording)`` returned.
    """

    name: str
    recording: Recording
    count: LobeCount


def write_count_report(
    path: str | os.PathLike[str],
    model: LobeModel,
    counted: Sequence[CountedRecording],
    *,
    failures: Mapping[str, str] | None = None,
    settings: Mapping[str, object] | None = None,
    most_sections: int = 12,
) -> Path:
    """Write the report of a count: one HTML file that needs nothing else.

    The answer comes first: count, lobes, probability, set of counts where the model gives one, and what to
    know before relying on it. Then the evidence: the disc with its lobes, torque, spectrum, orders, and the
    features beside those of the training windows. Several recordings have a table before their sections.
    The file appears whole or not at all; one of that name is replaced.

    Parameters
    ----------
    path : path-like
        File to write, usually ``*.html``.
    model : cyclofeat.counting.LobeModel
        What counted.
    counted : sequence of CountedRecording
    failures : mapping from str to str, optional
        Recordings that could not be counted: name to reason.
    settings : mapping, optional
        What else the report was made from, label to value.
    most_sections : int, default=12
        Recordings with a section of their own, those that need a look first: refused, then least probable.
        The others have their line in the table only (a section takes 1 to 2 MB).

    Returns
    -------
    pathlib.Path
        The file.

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
    >>> write_count_report("count.html", model, counted)  # doctest: +SKIP
    """
    target = target_of(path)
    summary = summarise_count(
        model, counted, failures=failures, settings=settings, most_sections=most_sections
    )
    return write_page(target, "count.html", summary)


def summarise_count(
    model: LobeModel,
    counted: Sequence[CountedRecording],
    *,
    failures: Mapping[str, str] | None = None,
    settings: Mapping[str, object] | None = None,
    most_sections: int = 12,
) -> dict[str, Any]:
    """All that the report of a count shows, as plain values that JSON can hold.

    Parameters are those of :func:`write_count_report`; pictures are data URIs.

    Returns
    -------
    dict
        ``title``, ``version``, ``surrogate``, ``origin``, ``rows`` (one for each recording), ``failures``,
        ``sections``, ``n_more`` (recordings without one), ``n_lobes``, ``calibrated``, ``model`` and
        ``provenance``.

    Raises
    ------
    ImportError, ValueError
        As :func:`write_count_report`.
    """
    failed = dict(failures or {})
    if not counted and not failed:
        raise ValueError("counted must hold at least one recording, got none")
    if most_sections < 0:
        raise ValueError(f"most_sections must not be negative, got {most_sections!r}")
    require_matplotlib("report")
    _, surrogate, said_of_origin = origin([item.recording.source for item in counted])
    with_section = _to_look_at(counted, most_sections)
    several = len(counted) + len(failed) > 1
    return {
        "title": "Worn lobes" if several or not counted else f"Worn lobes: {counted[0].name}",
        "version": __version__,
        "surrogate": surrogate,
        "origin": said_of_origin if counted else "",
        "several": several,
        "totals": _totals(counted, failed),
        "rows": [_row(k, item, k in with_section) for k, item in enumerate(counted)],
        "with_stated": any(item.recording.defect_count is not None for item in counted),
        "failures": [{"name": str(name), "reason": str(reason)} for name, reason in failed.items()],
        "sections": [_section(k, model, counted[k]) for k in with_section],
        "n_more": len(counted) - len(with_section),
        "n_lobes": model.n_lobes,
        "calibrated": bool(model.card.get("calibrated")),
        "model": _of_model(model),
        "provenance": [
            *((str(label), str(value)) for label, value in (settings or {}).items()),
            ("made with", versions()),
        ],
    }


def _to_look_at(counted: Sequence[CountedRecording], most: int) -> list[int]:
    """Places of the recordings that need a look most, in the order given."""

    def urgency(k: int) -> tuple[bool, float]:
        count = counted[k].count
        return not count.refused, count.probability[count.defect_count]

    return sorted(sorted(range(len(counted)), key=urgency)[:most])


# -- the answer


def _totals(counted: Sequence[CountedRecording], failed: Mapping[str, str]) -> str:
    """What all recordings come to, in a sentence."""
    n_refused = sum(item.count.refused for item in counted)
    by_count = Counter(item.count.defect_count for item in counted if not item.count.refused)
    parts = [f"{n} with {count_text(count, ())}" for count, n in sorted(by_count.items())]
    parts += [f"{n_refused} refused"] if n_refused else []
    parts += [f"{len(failed)} could not be counted"] if failed else []
    return f"{number(len(counted) + len(failed), 'recording')}: {', '.join(parts)}."


def _row(place: int, item: CountedRecording, linked: bool) -> dict[str, Any]:
    count, recording = item.count, item.recording
    stated = recording.defect_count
    return {
        "anchor": f"recording-{place + 1}" if linked else "",
        "name": str(item.name),
        "count": count.defect_count,
        "lobes": lobes_text(count.lobes, count.absolute),
        "probability": probability_text(count.probability[count.defect_count]),
        "refused": count.refused,
        "n_warnings": len(count.warnings),
        "stated": "" if stated is None else str(stated),
        "wrong": stated is not None and stated != count.defect_count,
    }


def _section(place: int, model: LobeModel, item: CountedRecording) -> dict[str, Any]:
    count, recording = item.count, item.recording
    shares = sorted(count.probability.items())
    return _row(place, item, True) | {
        "heading": _heading(count),
        "reason": count.reason,
        "warnings": [*count.warnings, *_quality(recording, model)],
        "shares": [{"count": c, "value": p, "text": probability_text(p)} for c, p in shares],
        "sets": _sets(model, recording),
        "windows": f"{number(count.n_windows, 'window')} of one output turn "
        f"({model.n_lobes / model.input_speed_hz:.4g} s)",
        "stated_text": ""
        if recording.defect_count is None
        else count_text(recording.defect_count, recording.worn_lobes),
        "lobe_table": [
            {"lobe": lobe + 1, "value": share, "text": probability_text(share), "worn": lobe in count.lobes}
            for lobe, share in enumerate(count.lobe_probability)
        ],
        "relative": bool(count.lobe_probability) and not count.absolute,
        "recorded": _recorded(recording),
        **_evidence(model, item),
    }


def _heading(count: LobeCount) -> str:
    text = count_text(count.defect_count, ())
    return f"Refused (else {text})" if count.refused else text[0].upper() + text[1:]


def _quality(recording: Recording, model: LobeModel) -> list[str]:
    """What in the recording itself would spoil a count, but for what the count has said already."""
    from cyclofeat.datasets import describe

    found = describe(recording, reduction=model.n_lobes)["warnings"]
    return [note for note in found if not note.startswith(("no angle", "no speed"))]


def _sets(model: LobeModel, recording: Recording) -> dict[str, Any] | None:
    """Counts that cannot be excluded, window by window, where the model gives such sets."""
    if not hasattr(model.counter, "predict_counts"):
        return None
    windows = Windower(input_speed_hz=model.input_speed_hz, reduction=model.n_lobes).windows([recording])
    found = Counter(str(answer) for answer in model.counter.predict_counts(windows.X))
    coverage = 100 * float(model.counter.coverage)
    return {
        "coverage": f"{coverage:.4g} %",
        "sets": [f"{text} ({n} of {len(windows)})" for text, n in found.most_common()],
    }


def _recorded(recording: Recording) -> list[tuple[str, str]]:
    """What the recording is, label and value."""
    angle = "none"
    if recording.angle is not None:
        zero = "absolute" if recording.angle_is_absolute else "relative"
        angle = f"of the {recording.angle_of} shaft, {zero}"
    found = {
        "length": f"{recording.duration:.4g} s, {recording.sampling_rate:g} Hz",
        "torque": f"{recording.torque.min():.4g} to {recording.torque.max():.4g} Nm, "
        f"mean {recording.torque.mean():.4g} Nm",
        "speed": None if recording.speed_rpm is None else f"{recording.speed_rpm:g} RPM (stated)",
        "load": None if recording.load_nm is None else f"{recording.load_nm:g} Nm (stated)",
        "angle": angle,
        "assembly": recording.assembly,
        "source": recording.source or "not stated",
    }
    return [(label, str(value)) for label, value in found.items() if value is not None]


# -- the evidence


def _evidence(model: LobeModel, item: CountedRecording) -> dict[str, Any]:
    """Pictures of a recording, and of its features where the model knows those of its training."""
    from cyclofeat.plotting import (
        LobeMapDisplay,
        OrderDisplay,
        SpectrumDisplay,
        TorqueDisplay,
        TrainingDisplay,
    )
    from cyclofeat.report._figures import recording_pictures, training_pictures

    count, recording = item.count, item.recording
    if recording.angle_is_absolute and count.lobe_probability and not count.absolute:
        # Lobes counted from the first sample: the picture must count alike.
        recording = recording.replace(angle_is_absolute=False)
    lobe_map = LobeMapDisplay.from_recording(
        recording,
        input_speed_hz=model.input_speed_hz,
        n_lobes=model.n_lobes,
        counted_lobes=count.lobes,
        lobe_probability=count.lobe_probability or None,
        outline=_outline(model.n_lobes, count.lobes),
    )
    speed = lobe_map.input_speed_hz
    pictures = recording_pictures(
        TorqueDisplay.from_recording(recording),
        SpectrumDisplay.from_recording(recording, input_speed_hz=speed, n_lobes=model.n_lobes),
        OrderDisplay.from_recording(recording, input_speed_hz=speed, n_lobes=model.n_lobes),
        lobe_map,
    )
    training: list[dict[str, Picture | str]] = []
    if model.domain is not None:
        display = TrainingDisplay.from_estimator(model, recording)
        nearest = sorted(count.probability, key=lambda c: -count.probability[c])[:2]
        training = training_pictures(display, tuple(nearest), _N_FEATURE_PICTURES)
    return {"pictures": pictures, "training": training, "territory": _territory(count)}


def _outline(n_lobes: int, worn: tuple[int, ...]) -> Any:
    """A disc in the proportions of the papers' one: recordings do not state their gearbox."""
    from cyclofeat.simulators import CycloidalProfile

    n_pins = n_lobes + 1
    profile = CycloidalProfile(
        eccentricity=0.7 / n_pins, n_pins=n_pins, shortening=0.7, pin_radius=1.5 / n_pins
    )
    return profile.outline(worn)


def _territory(count: LobeCount) -> dict[str, str]:
    """Whether the recording is like those that the model was trained on."""
    if np.isnan(count.distance):
        return {"heading": "Unknown", "text": "the model does not know what it was trained on"}
    return {
        "heading": "Outside" if count.distance > 1 else "Inside",
        "text": f"what the model was trained on: {count.distance:.2g} of the largest distance inside",
    }


# -- what it rests on


def _of_model(model: LobeModel) -> list[tuple[str, str]]:
    from cyclofeat.counting import score_text

    card = model.card
    scores = card.get("cross_validation")
    sources = ", ".join(card.get("sources", ()))
    found = {
        "trained on": card.get("description") or "not stated",
        "source": f"{sources} recordings" if sources else None,
        "windows": card.get("n_windows"),
        "counts": ", ".join(map(str, card["classes"])),
        "for recordings at": f"{model.sampling_rate:g} Hz and {60 * model.input_speed_hz:g} RPM",
        "cross-validation": "none: accuracy unknown"
        if scores is None
        else f"{score_text(scores)}; window by window, {scores['n_assemblies']} assemblies held out in turn, "
        f"{100 * scores['confidence']:.3g} % interval",
        "versions": ", ".join(f"{name} {value}" for name, value in card["versions"].items()),
    }
    return [(label, str(value)) for label, value in found.items() if value is not None]
