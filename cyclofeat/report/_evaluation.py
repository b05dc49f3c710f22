"""Report of an evaluation: scores of counters on assemblies that they have not seen."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cyclofeat import __version__
from cyclofeat._base.quantities import number_of
from cyclofeat.plotting.drawing import require_matplotlib
from cyclofeat.report._page import check_page_path, describe_origin, versions_line, write_page

if TYPE_CHECKING:
    import os

    from cyclofeat.counting import Evaluation

_MOST_WRONG = 20


def write_evaluation_report(
    results: Mapping[str, Evaluation],
    path: str | os.PathLike[str],
    *,
    sources: Sequence[str | None] = (),
    folds: str = "",
    settings: Mapping[str, object] | None = None,
) -> Path:
    """Write the report of an evaluation as one HTML file, and return its path.

    Accuracy with its interval comes first, then all methods, refusals, the confusion matrix, each count, sets
    of lobes, calibration, the assemblies that were counted wrong, and the folds. A file of that name is
    replaced.

    Parameters
    ----------
    results : mapping from str to cyclofeat.counting.Evaluation
        By method, on the same windows or recordings; details are those of the first.
    path : path-like
        File to write, ``*.html``.
    sources : sequence of str or None
        ``Recording.source`` of each recording. The report says which are ``"simulated"`` or ``"surrogate"``.
    folds : str, optional
        Number and seed of the folds.
    settings : mapping, optional
        Other settings, label to value.

    Raises
    ------
    ImportError
        If jinja2 or matplotlib is not installed.
    FileNotFoundError
        If the folder does not exist.
    ValueError
        If there are no results, or they are of different windows or recordings.

    Examples
    --------
    >>> from cyclofeat.counting import evaluate, make_lobe_counter
    >>> from cyclofeat.report import write_evaluation_report
    >>> counter = make_lobe_counter(sampling_rate=25_600)  # doctest: +SKIP
    >>> result = evaluate(counter, X, y, groups)  # doctest: +SKIP
    >>> write_evaluation_report({"lobe map": result}, "evaluation.html")  # doctest: +SKIP
    """
    target = check_page_path(path)
    summary = summarise_evaluation(results, sources=sources, folds=folds, settings=settings)
    return write_page(target, "evaluation.html", summary)


def summarise_evaluation(
    results: Mapping[str, Evaluation],
    *,
    sources: Sequence[str | None] = (),
    folds: str = "",
    settings: Mapping[str, object] | None = None,
) -> dict[str, Any]:
    """Summarise an evaluation in plain values that JSON can hold.

    Parameters and errors are those of :func:`write_evaluation_report`; pictures are data URIs.

    Returns
    -------
    dict
        ``title``, ``version``, ``surrogate``, ``origin``, ``main`` (name of the first method), ``unit``
        (``"recording"`` or ``"window"``), ``tiles``, ``methods``, ``guess``, ``classes``, ``parts`` (pictures
        of recordings, and of their windows), ``refusals``, ``wrong``, ``n_more_wrong``, ``folds`` and
        ``provenance``.
    """
    if not results:
        raise ValueError("results must hold at least one evaluation, got none")
    main, first = next(iter(results.items()))
    for name, result in results.items():
        if not (np.array_equal(result.labels, first.labels) and np.array_equal(result.groups, first.groups)):
            raise ValueError(f"results must be of the same windows, but {name!r} is of others than {main!r}")
    require_matplotlib()
    _, surrogate, origin_text = describe_origin(sources)
    wrong = _wrong_assemblies(first)
    labels = first.labels
    unit = "window" if first.windows is None else "recording"
    parts = [_draw_pictures(unit, first)]
    if first.windows is not None:
        parts.append(_draw_pictures("window", first.windows))
    trained = "a model that was trained without its assembly"
    return {
        "title": "Counting on assemblies not seen before",
        "version": __version__,
        "surrogate": surrogate,
        "origin": origin_text if sources else "",
        "main": main,
        "unit": unit,
        "counted_by": "the stored model" if first.protocol == "nothing" else trained,
        "confidence": f"{100 * first.confidence:.3g}",
        "n_rows": int(labels.size),
        "n_assemblies": int(first.groups.size),
        "tiles": _score_tiles(first, results, unit),
        "methods": [_method_row(name, result) for name, result in results.items()],
        "guess": float(np.max(np.unique(labels, return_counts=True)[1]) / labels.size),
        "with_lobes": any(result.exact_lobes is not None for result in results.values()),
        "with_windows": any(result.windows is not None for result in results.values()),
        "classes": _class_rows(first),
        "parts": parts,
        "refusals": None if first.reasons is None else list(first.refusal_counts().items()),
        "wrong": wrong[:_MOST_WRONG],
        "n_more_wrong": max(len(wrong) - _MOST_WRONG, 0),
        "protocol": first.protocol,
        "folds": str(folds),
        "provenance": [
            *((str(label), str(value)) for label, value in (settings or {}).items()),
            ("windows", str(labels.size if first.windows is None else first.windows.labels.size)),
            ("assemblies", str(first.groups.size)),
            ("made with", versions_line()),
        ],
    }


def _draw_pictures(unit: str, result: Evaluation) -> dict[str, Any]:
    """Return the pictures of the confusion and of the calibration of recordings or windows."""
    from cyclofeat.plotting import EvaluationDisplay
    from cyclofeat.report._figures import calibration_picture, confusion_picture

    display = EvaluationDisplay(result)
    return {
        "unit": unit,
        "n": int(result.labels.size),
        "accuracy": f"{result.accuracy:.3f}",
        "range": _range_text(result.accuracy_interval),
        "confusion": confusion_picture(display),
        "calibration": None if result.certainty is None else calibration_picture(display),
        "calibration_error": _rounded_text(result.calibration_error),
    }


def _rounded_text(value: float | None) -> str:
    return "" if value is None else f"{value:.3f}"


def _range_text(limits: Sequence[float] | None) -> str:
    return "" if limits is None else f"{limits[0]:.3f} to {limits[1]:.3f}"


def _score_tiles(first: Evaluation, results: Mapping[str, Evaluation], unit: str) -> list[dict[str, str]]:
    name, lobes = next(((n, r) for n, r in results.items() if r.exact_lobes is not None), ("", first))
    by = f"of {unit}s" if lobes is first else f"of {unit}s, by {name}"
    windows = first.windows
    tiles: list[tuple[str, float | None, Sequence[float] | None, str]] = [
        ("Accuracy", first.accuracy, first.accuracy_interval, f"of {unit}s counted right"),
        (
            "Accuracy without refused", first.accepted_accuracy, first.accepted_accuracy_interval,
            f"of {unit}s that are not refused",
        ),
        ("Refused", first.refused, None, f"of {unit}s"),
        (
            "Single windows", None if windows is None else windows.accuracy,
            None if windows is None else windows.accuracy_interval, "of output turns counted right alone",
        ),
        (
            "Mean absolute error", first.mean_absolute_error, first.mean_absolute_error_interval,
            "worn lobes too many or too few",
        ),
        ("Exactly the right lobes", lobes.exact_lobes, lobes.exact_lobes_interval, by),
        (
            "Calibration error", first.calibration_error, first.calibration_error_interval,
            "mean distance of probability and share of right answers",
        ),
    ]  # fmt: skip
    return [
        {"label": label, "value": f"{value:.3f}", "range": _range_text(limits), "text": text}
        for label, value, limits, text in tiles
        if value is not None
    ]


def _method_row(name: str, result: Evaluation) -> dict[str, Any]:
    low, high = result.accuracy_interval
    return {
        "method": str(name),
        "accuracy": result.accuracy,
        "low": low,
        "high": high,
        "error": f"{result.mean_absolute_error:.3f}",
        "macro_f1": f"{result.macro_f1:.3f}",
        "calibration": _rounded_text(result.calibration_error),
        "lobes": _rounded_text(result.exact_lobes),
        "lobes_range": _range_text(result.exact_lobes_interval),
        "windows": "" if result.windows is None else f"{result.windows.accuracy:.3f}",
        "accepted": _rounded_text(result.accepted_accuracy),
        "refused": _rounded_text(result.refused),
    }


def _class_rows(result: Evaluation) -> list[dict[str, Any]]:
    """Return for each count how often it was recognised, and how often an answer of it was right."""
    rows = []
    for k, row in enumerate(result.class_scores()):
        others = np.where(np.arange(result.classes.size) == k, 0, result.confusion[k])
        rows.append({
            "label": str(row["defect_count"]),
            "windows": row["n_windows"],
            "assemblies": row["n_assemblies"],
            "found": "-" if math.isnan(row["recall"]) else f"{row['recall']:.3f}",
            "range": ""
                if math.isnan(row["recall"])
                else _range_text((row["recall_low"], row["recall_high"])),
            "right": "-" if math.isnan(row["precision"]) else f"{row['precision']:.3f}",
            "taken_for": f"{result.classes[others.argmax()]} ({others.max()})" if others.any() else "",
        })  # fmt: skip
    return rows


def _wrong_assemblies(result: Evaluation) -> list[dict[str, Any]]:
    """Return the assemblies that were not always counted right, the worst first."""
    rows, unit = [], "window" if result.windows is None else "recording"
    order = np.argsort(result.group_accuracy, kind="stable")
    for k in order[result.group_accuracy[order] < 1]:
        rows_of_group = result.assemblies == result.groups[k]
        answers = Counter(result.predictions[rows_of_group].tolist())
        rows.append({
            "assembly": str(result.groups[k]),
            "true": ", ".join(str(count) for count in np.unique(result.labels[rows_of_group])),
            "said": ", ".join(f"{count} ({number_of(n, unit)})" for count, n in answers.most_common()),
            "accuracy": f"{result.group_accuracy[k]:.2f}",
        })  # fmt: skip
    return rows
