"""The report of the demonstration: summarised to plain values, then rendered, then written."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cyclofeat import __version__
from cyclofeat.plotting._base import require_matplotlib
from cyclofeat.report._page import (
    SIMULATED,
    count_text,
    lobes_text,
    probability_text,
    target_of,
    write_page,
)

if TYPE_CHECKING:
    import os

    from cyclofeat.recording import Recording


def write_demo_report(
    path: str | os.PathLike[str],
    *,
    title: str,
    provenance: Mapping[str, object],
    accuracy_rows: Sequence[Mapping[str, Any]],
    examples: Sequence[Mapping[str, Any]] = (),
    predictions: Sequence[Mapping[str, Any]] = (),
    confusion: ArrayLike | None = None,
    class_labels: Sequence[object] | None = None,
    notes: Sequence[str] = (),
) -> Path:
    """Write the demonstration's report: one HTML file that needs nothing else.

    It states in its head that all recordings are surrogates: simulated torque with simulated brake drift and
    noise. The file appears whole or not at all; one of that name is replaced.

    Parameters
    ----------
    path : path-like
        File to write, usually ``*.html``.
    title : str
        Heading.
    provenance : mapping of str
        What the results were made from, label to value: rig, training set, seeds, ...
    accuracy_rows : sequence of mapping
        One for each method, the toolkit's own first: ``method`` (str), ``accuracy``, ``low`` and ``high``
        (ends of its 95 % interval over assemblies), ``mean_absolute_error`` (in lobes).
    examples : sequence of mapping
        Drawn side by side on common scales: ``recording`` (Recording; simulated or surrogate, one output turn
        or longer, of known speed), ``heading`` (str). Optional: ``predicted``, a mapping as from
        ``LobeCount.to_dict()`` with ``defect_count``, ``probability`` (by count: a mapping or a sequence from
        0), ``lobes`` (counted from 0), ``lobe_probability`` (per lobe, may be empty) and
        ``lobes_absolute`` (default: as the recording's angle); ``outline``, array of complex, see
        :class:`cyclofeat.plotting.LobeMapDisplay`.
    predictions : sequence of mapping
        One for each file: ``file``, ``true`` and ``predicted`` (counts), ``probability`` (of the predicted
        count). Optional: ``true_lobes`` and ``lobes`` (predicted), counted from 0, and ``lobes_absolute``
        (default True). Other keys are ignored.
    confusion : array-like of int, shape (n_classes, n_classes), optional
        Windows of true class (row) predicted as class (column), by the first of the methods.
    class_labels : sequence, optional
        Labels of the classes; default 0, 1, ...
    notes : sequence of str
        What the reader should know; a paragraph each.

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
        If a key is missing, a value is out of its range, or a recording is not simulated.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> row = {"method": "LobeMap", "accuracy": 0.95, "low": 0.92, "high": 0.98, "mean_absolute_error": 0.1}
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = pathlib.Path(folder, "report.html")
    ...     _ = write_demo_report(file, title="Demo", provenance={"rig": "R1"}, accuracy_rows=[row])
    ...     "SURROGATE" in file.read_text(encoding="utf-8")
    True
    """
    target = target_of(path)
    summary = summarise_demo(
        title=title,
        provenance=provenance,
        accuracy_rows=accuracy_rows,
        examples=examples,
        predictions=predictions,
        confusion=confusion,
        class_labels=class_labels,
        notes=notes,
    )
    return write_page(target, "demo.html", summary)


def summarise_demo(
    *,
    title: str,
    provenance: Mapping[str, object],
    accuracy_rows: Sequence[Mapping[str, Any]],
    examples: Sequence[Mapping[str, Any]] = (),
    predictions: Sequence[Mapping[str, Any]] = (),
    confusion: ArrayLike | None = None,
    class_labels: Sequence[object] | None = None,
    notes: Sequence[str] = (),
) -> dict[str, Any]:
    """All that the demonstration's report shows, as plain values that JSON can hold.

    Parameters are those of :func:`write_demo_report`; pictures are data URIs.

    Returns
    -------
    dict
        ``title``, ``version``, ``provenance``, ``methods``, ``chance`` (accuracy of a guess, or None),
        ``examples``, ``predictions``, ``n_right``, ``with_lobes``, ``confusion`` (picture or None) and
        ``notes``.

    Raises
    ------
    ImportError, ValueError
        As :func:`write_demo_report`.
    """
    methods = [_method(f"accuracy_rows[{i}]", row) for i, row in enumerate(accuracy_rows)]
    files = [_prediction(f"predictions[{i}]", row) for i, row in enumerate(predictions)]
    matrix, labels = _confusion(confusion, class_labels)
    return {
        "title": str(title),
        "version": __version__,
        "provenance": {str(label): str(value) for label, value in provenance.items()},
        "methods": methods,
        "chance": None if labels is None else 1 / len(labels),
        "examples": _examples(examples),
        "predictions": files,
        "n_right": sum(file["right"] for file in files),
        "with_lobes": any(file["lobes"] or file["true_lobes"] for file in files),
        "confusion": None if matrix is None or labels is None else _confusion_picture(matrix, labels),
        "notes": [str(note) for note in notes],
    }


# -- from arguments to plain values


def _required(where: str, row: Mapping[str, Any], keys: Sequence[str]) -> list[Any]:
    missing = [key for key in keys if key not in row]
    if missing:
        raise ValueError(f"{where} must hold {', '.join(keys)}; {', '.join(missing)} is missing")
    return [row[key] for key in keys]


def _share(where: str, value: Any) -> float:
    share = float(value)
    if not 0 <= share <= 1:
        raise ValueError(f"{where} must lie between 0 and 1, got {value!r}")
    return share


def _method(where: str, row: Mapping[str, Any]) -> dict[str, Any]:
    method, error = _required(where, row, ("method", "mean_absolute_error"))
    shares = _required(where, row, ("accuracy", "low", "high"))
    accuracy, low, high = (_share(where, value) for value in shares)
    return {
        "method": str(method),
        "accuracy": accuracy,
        "low": low,
        "high": high,
        "mean_absolute_error": float(error),
    }


def _prediction(where: str, row: Mapping[str, Any]) -> dict[str, Any]:
    file, true, predicted, probability = _required(where, row, ("file", "true", "predicted", "probability"))
    return {
        "file": str(file),
        "true": int(true),
        "predicted": int(predicted),
        "right": int(true) == int(predicted),
        "probability": probability_text(_share(where, probability)),
        "true_lobes": lobes_text(row.get("true_lobes")),
        "lobes": lobes_text(row.get("lobes"), row.get("lobes_absolute", True)),
    }


def _confusion(
    confusion: ArrayLike | None, class_labels: Sequence[object] | None
) -> tuple[NDArray[np.int64] | None, list[str] | None]:
    labels = None if class_labels is None else [str(label) for label in class_labels]
    if confusion is None:
        return None, labels
    matrix = np.asarray(confusion)
    if matrix.ndim != 2 or matrix.shape[0] != matrix.shape[1] or matrix.size == 0:
        raise ValueError(f"confusion must be a square array of counts, got shape {matrix.shape}")
    if labels is None:
        labels = [str(label) for label in range(len(matrix))]
    if len(labels) != len(matrix):
        raise ValueError(
            f"class_labels must hold one label for each of {len(matrix)} classes, got {len(labels)}"
        )
    return matrix.astype(np.int64), labels


def _examples(examples: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Texts and pictures of the examples."""
    if not examples:
        return []
    require_matplotlib("report")
    from cyclofeat.plotting import LobeMapDisplay, SpectrumDisplay, TorqueDisplay
    from cyclofeat.report._figures import example_pictures

    texts, torques, spectra, maps = [], [], [], []
    for index, example in enumerate(examples):
        where = f"examples[{index}]"
        recording, heading = _required(where, example, ("recording", "heading"))
        if recording.source not in SIMULATED:
            raise ValueError(
                f"{where} must hold a recording whose source is one of {SIMULATED}, since the report calls "
                f"all of them surrogates; got source={recording.source!r}"
            )
        predicted = example.get("predicted") or {}
        if not predicted.get("lobes_absolute", True) and recording.angle_is_absolute:
            # Lobes counted from the first sample: the picture must count alike.
            recording = recording.replace(angle_is_absolute=False)
        lobe_map = LobeMapDisplay.from_recording(
            recording,
            lobe_probability=predicted.get("lobe_probability") or None,
            outline=example.get("outline"),
        )
        torques.append(TorqueDisplay.from_recording(recording))
        spectra.append(SpectrumDisplay.from_recording(recording, input_speed_hz=lobe_map.input_speed_hz))
        maps.append(lobe_map)
        texts.append({"heading": str(heading)} | _example_texts(where, recording, predicted))
    pictures = example_pictures(torques, spectra, maps)
    return [text | {"pictures": drawn} for text, drawn in zip(texts, pictures, strict=True)]


def _example_texts(where: str, recording: Recording, predicted: Mapping[str, Any]) -> dict[str, Any]:
    found: dict[str, Any] = {"true": "not stated", "predicted": None, "right": None}
    if recording.defect_count is not None:
        found["true"] = count_text(recording.defect_count, recording.worn_lobes)
    found["recording"] = "" if recording.assembly is None else str(recording.assembly)
    if predicted:
        count, probability = _required(f"{where}['predicted']", predicted, ("defect_count", "probability"))
        by_count = (
            {int(k): float(p) for k, p in probability.items()}
            if isinstance(probability, Mapping)
            else dict(enumerate(float(p) for p in probability))
        )
        share = _share(f"{where}['predicted']['probability']", by_count.get(int(count), 0.0))
        absolute = predicted.get("lobes_absolute", recording.angle_is_absolute)
        text = count_text(int(count), predicted.get("lobes"), absolute)
        found["predicted"] = f"{text} (probability {probability_text(share)})"
        if recording.defect_count is not None:
            found["right"] = int(count) == recording.defect_count
    return found


def _confusion_picture(matrix: NDArray[np.int64], labels: list[str]) -> dict[str, Any]:
    require_matplotlib("report")
    from cyclofeat.report._figures import confusion_picture

    return confusion_picture(matrix, labels)
