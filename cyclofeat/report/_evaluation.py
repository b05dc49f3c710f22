"""Report of an evaluation: scores of counters on assemblies that they have not seen."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cyclofeat.plotting import EvaluationDisplay
from cyclofeat.report import _figures
from cyclofeat.report._page import check_page_path, describe_origin, write_page

if TYPE_CHECKING:
    import os

    from cyclofeat.counting import Evaluation

_MOST_WRONG = 20
# What not every evaluation has.
_OPTIONAL = ("accepted_accuracy", "refused", "exact_lobes", "calibration_error")
_ABSENT = dict.fromkeys(["windows", *_OPTIONAL, *(f"{name}_interval" for name in _OPTIONAL)])


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

    Returns
    -------
    pathlib.Path

    Raises
    ------
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
    check_page_path(path)
    if not results:
        raise ValueError("results must hold at least one evaluation, got none")
    main, first = next(iter(results.items()))
    for name, result in results.items():
        if not (np.array_equal(result.labels, first.labels) and np.array_equal(result.groups, first.groups)):
            raise ValueError(f"results must be of the same windows, but {name!r} is of others than {main!r}")
    _, surrogate, origin = describe_origin(sources)
    labels, windows = first.labels, first.windows
    unit = "window" if windows is None else "recording"
    classes = first.class_scores()
    for k, row in enumerate(classes):
        others = np.where(np.arange(first.classes.size) == k, 0, first.confusion[k])
        row["taken_for"] = f"{first.classes[others.argmax()]} ({others.max()})" if others.any() else ""
    summary = {
        "title": "Counting on assemblies not seen before",
        "surrogate": surrogate,
        "origin": origin if sources else "",
        "main": main,
        "unit": unit,
        "agreement": first.agreement(),
        "confidence": f"{100 * first.confidence:.3g}",
        "n_rows": int(labels.size),
        "n_assemblies": int(first.groups.size),
        "methods": [_ABSENT | result.to_dict() | {"method": str(name)} for name, result in results.items()],
        "guess": float(np.max(np.unique(labels, return_counts=True)[1]) / labels.size),
        "classes": classes,
        "parts": [_summarise_part(unit, first)]
        + ([] if windows is None else [_summarise_part("window", windows)]),
        "refusals": None if first.reasons is None else list(first.to_dict()["reasons"].items()),
        "wrong": _wrong_assemblies(first)[:_MOST_WRONG],
        "n_more_wrong": max(int(np.sum(first.group_accuracy < 1)) - _MOST_WRONG, 0),
        "protocol": first.protocol,
        "folds": str(folds),
        "provenance": dict(settings or {})
        | {"windows": int((windows or first).labels.size), "assemblies": int(first.groups.size)},
    }
    return write_page(path, "evaluation.html", summary)


def _wrong_assemblies(result: Evaluation) -> list[dict[str, Any]]:
    """Return the assemblies that were not always counted right, the worst first."""
    wrong = []
    for k in np.argsort(result.group_accuracy, kind="stable")[: np.sum(result.group_accuracy < 1)]:
        of_group = result.assemblies == result.groups[k]
        wrong.append({
            "assembly": str(result.groups[k]),
            "true": np.unique(result.labels[of_group]).tolist(),
            "answers": Counter(result.predictions[of_group].tolist()).most_common(),
            "accuracy": float(result.group_accuracy[k]),
        })  # fmt: skip
    return wrong


def _summarise_part(unit: str, result: Evaluation) -> dict[str, Any]:
    """Return scores and pictures of recordings or of their windows."""
    display = EvaluationDisplay(result)
    alt = "Confusion matrix: windows by true and predicted number of worn lobes"
    confusion = _figures.draw_picture(partial(display.plot, "confusion"), (display.side, display.side), alt)
    calibration = None
    if result.certainty is not None:
        alt = "Calibration: share of right answers by probability said, beside the diagonal"
        calibration = _figures.draw_picture(partial(display.plot, "calibration"), (5.2, 5.2), alt)
    n = int(result.labels.size)
    drawn = {"unit": unit, "n": n, "confusion": confusion, "calibration": calibration}
    return _ABSENT | result.to_dict() | drawn
