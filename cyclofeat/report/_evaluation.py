"""The report of an evaluation: how often counters are right on assemblies that they have not seen."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cyclofeat import __version__
from cyclofeat.plotting._base import require_matplotlib
from cyclofeat.report._page import number, origin, target_of, versions, write_page

if TYPE_CHECKING:
    import os

    from cyclofeat.counting import Evaluation
    from cyclofeat.report._figures import Picture

_MOST_WRONG = 20


def write_evaluation_report(
    path: str | os.PathLike[str],
    results: Mapping[str, Evaluation],
    y: ArrayLike,
    groups: ArrayLike,
    *,
    sources: Sequence[str | None] = (),
    folds: str = "",
    settings: Mapping[str, object] | None = None,
) -> Path:
    """Write the report of an evaluation: one HTML file that needs nothing else.

    The answer comes first: accuracy with its interval. Then the methods beside each other, the confusion
    matrix, each count by itself, sets of lobes, calibration, the assemblies that were counted wrong, and how
    the folds were made. The file appears whole or not at all; one of that name is replaced.

    Parameters
    ----------
    path : path-like
        File to write, usually ``*.html``.
    results : mapping from str to cyclofeat.counting.Evaluation
        By method, on the same windows; details are those of the first.
    y : array-like of int, shape (n_windows,)
        True defect count of each window.
    groups : array-like, shape (n_windows,)
        Assembly of each window.
    sources : sequence of str or None
        ``Recording.source`` of each recording. Where one is ``"simulated"`` or ``"surrogate"`` the report
        says so, and calls nothing of it measured.
    folds : str, optional
        How the folds were made, beyond the protocol: their number, the seed.
    settings : mapping, optional
        What else the results were made from, label to value.

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
        If there are no results, or they are not of these windows.

    Examples
    --------
    >>> from cyclofeat.counting import evaluate, make_lobe_counter
    >>> from cyclofeat.report import write_evaluation_report
    >>> counter = make_lobe_counter(sampling_rate=25_600, calibrated=True)  # doctest: +SKIP
    >>> result = evaluate(counter, X, y, groups)  # doctest: +SKIP
    >>> write_evaluation_report("evaluation.html", {"lobe map": result}, y, groups)  # doctest: +SKIP
    """
    target = target_of(path)
    summary = summarise_evaluation(results, y, groups, sources=sources, folds=folds, settings=settings)
    return write_page(target, "evaluation.html", summary)


def summarise_evaluation(
    results: Mapping[str, Evaluation],
    y: ArrayLike,
    groups: ArrayLike,
    *,
    sources: Sequence[str | None] = (),
    folds: str = "",
    settings: Mapping[str, object] | None = None,
) -> dict[str, Any]:
    """All that the report of an evaluation shows, as plain values that JSON can hold.

    Parameters are those of :func:`write_evaluation_report`; pictures are data URIs.

    Returns
    -------
    dict
        ``title``, ``version``, ``surrogate``, ``origin``, ``main`` (name of the first method), ``tiles``,
        ``methods``, ``guess``, ``classes``, ``confusion``, ``calibration``, ``wrong``, ``n_more_wrong``,
        ``folds`` and ``provenance``.

    Raises
    ------
    ImportError, ValueError
        As :func:`write_evaluation_report`.
    """
    if not results:
        raise ValueError("results must hold at least one evaluation, got none")
    labels, member = np.asarray(y), np.asarray(groups)
    for name, result in results.items():
        if not labels.shape == member.shape == result.predictions.shape:
            raise ValueError(
                f"y and groups must have one value for each window, got shapes {labels.shape} and "
                f"{member.shape} for the {result.predictions.size} windows of {name!r}"
            )
    require_matplotlib("report")
    from cyclofeat.report._figures import confusion_picture

    _, surrogate, said_of_origin = origin(sources)
    main, first = next(iter(results.items()))
    wrong = _wrong(first, labels, member)
    return {
        "title": "Counting on assemblies not seen before",
        "version": __version__,
        "surrogate": surrogate,
        "origin": said_of_origin if sources else "",
        "main": main,
        "confidence": f"{100 * first.confidence:.3g}",
        "n_windows": int(labels.size),
        "n_assemblies": int(first.groups.size),
        "tiles": _tiles(first, results),
        "methods": [_method(name, result) for name, result in results.items()],
        "guess": float(np.max(np.unique(labels, return_counts=True)[1]) / labels.size),
        "with_lobes": any(result.exact_lobes is not None for result in results.values()),
        "with_sets": any(result.coverage is not None for result in results.values()),
        "classes": _classes(first, labels, member),
        "confusion": confusion_picture(first.confusion, [str(c) for c in first.classes]),
        "calibration": _calibration(first, labels, member),
        "wrong": wrong[:_MOST_WRONG],
        "n_more_wrong": max(len(wrong) - _MOST_WRONG, 0),
        "protocol": first.protocol,
        "folds": str(folds),
        "provenance": [
            *((str(label), str(value)) for label, value in (settings or {}).items()),
            ("windows", str(labels.size)),
            ("assemblies", str(first.groups.size)),
            ("made with", versions()),
        ],
    }


def _range(limits: Sequence[float] | None) -> str:
    return "" if limits is None else f"{limits[0]:.3f} to {limits[1]:.3f}"


def _tiles(first: Evaluation, results: Mapping[str, Evaluation]) -> list[dict[str, str]]:
    name, lobes = next(((n, r) for n, r in results.items() if r.exact_lobes is not None), ("", None))
    found: list[tuple[str, float, Sequence[float] | None, str]] = [
        ("Accuracy", first.accuracy, first.accuracy_interval, "of windows counted right"),
        (
            "Mean absolute error", first.mean_absolute_error, first.mean_absolute_error_interval,
            "worn lobes too many or too few",
        ),
    ]  # fmt: skip
    if lobes is not None and lobes.exact_lobes is not None:
        by = "of windows" if lobes is first else f"of windows, by {name}"
        found.append(("Exactly the right lobes", lobes.exact_lobes, lobes.exact_lobes_interval, by))
    if first.calibration_error is not None:
        found.append((
            "Calibration error", first.calibration_error, first.calibration_error_interval,
            "mean distance of probability and share of right answers",
        ))  # fmt: skip
    if first.coverage is not None:
        found.append(
            ("Coverage", first.coverage, first.coverage_interval, "of sets that hold the true count")
        )
    return [
        {"label": label, "value": f"{value:.3f}", "range": _range(limits), "text": text}
        for label, value, limits, text in found
    ]


def _method(name: str, result: Evaluation) -> dict[str, Any]:
    low, high = result.accuracy_interval
    return {
        "method": str(name),
        "accuracy": result.accuracy,
        "low": low,
        "high": high,
        "error": f"{result.mean_absolute_error:.3f}",
        "macro_f1": f"{result.macro_f1:.3f}",
        "calibration": "" if result.calibration_error is None else f"{result.calibration_error:.3f}",
        "lobes": "" if result.exact_lobes is None else f"{result.exact_lobes:.3f}",
        "lobes_range": _range(result.exact_lobes_interval),
        "coverage": "" if result.coverage is None else f"{result.coverage:.3f}",
        "set_size": "" if result.set_size is None else f"{result.set_size:.2f}",
        "refused": "" if result.refused is None else f"{result.refused:.3f}",
    }


def _classes(result: Evaluation, y: NDArray[Any], groups: NDArray[Any]) -> list[dict[str, Any]]:
    """Each count by itself: how often it was found, and how often an answer of it was right."""
    rows = []
    for k, label in enumerate(result.classes):
        cells = result.confusion[k]
        said = int(result.confusion[:, k].sum())
        others = np.where(np.arange(cells.size) == k, 0, cells)
        n_assemblies = int(np.unique(groups[y == label]).size)
        rows.append({
            "label": str(label),
            "windows": int(cells.sum()),
            "assemblies": n_assemblies,
            "found": f"{cells[k] / cells.sum():.3f}" if cells.sum() else "-",
            "range": _range(_of_class(result, k, n_assemblies)) if cells.sum() else "",
            "right": f"{cells[k] / said:.3f}" if said else "-",
            "taken_for": f"{result.classes[others.argmax()]} ({others.max()})" if others.any() else "",
        })  # fmt: skip
    return rows


def _of_class(result: Evaluation, k: int, n_assemblies: int) -> tuple[float, float]:
    """Range of the share of a count that was found; where all or none were, by the rule of three."""
    from cyclofeat.counting._scores import at_the_ends

    low, high = result.confusion_interval[:, k, k].tolist()
    found = float(result.confusion[k, k] / result.confusion[k].sum())
    return at_the_ends(found, (low, high), n_assemblies, 0.95)


def _calibration(result: Evaluation, y: NDArray[Any], groups: NDArray[Any]) -> Picture | None:
    if result.probabilities is None:
        return None
    from cyclofeat.counting._folds import shares
    from cyclofeat.counting._scores import N_BINS, calibration_sums
    from cyclofeat.report._figures import calibration_picture

    member = np.unique(groups, return_inverse=True)[1]
    sums = calibration_sums(
        result.probabilities.max(axis=1), y == result.predictions, shares(member), member
    ).sum(axis=0)
    said, was, weight = sums.reshape(3, N_BINS)
    used = weight > 0
    return calibration_picture(
        said[used] / weight[used], was[used] / weight[used], weight[used] / weight.sum()
    )


def _wrong(result: Evaluation, y: NDArray[Any], groups: NDArray[Any]) -> list[dict[str, Any]]:
    """Assemblies that were not always counted right, the worst first."""
    rows = []
    order = np.argsort(result.group_accuracy, kind="stable")
    for k in order[result.group_accuracy[order] < 1]:
        rows_of = groups == result.groups[k]
        said = Counter(result.predictions[rows_of].tolist())
        rows.append({
            "assembly": str(result.groups[k]),
            "true": ", ".join(str(count) for count in np.unique(y[rows_of])),
            "said": ", ".join(f"{count} ({number(n, 'window')})" for count, n in said.most_common()),
            "accuracy": f"{result.group_accuracy[k]:.2f}",
        })  # fmt: skip
    return rows
