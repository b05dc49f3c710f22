"""Cross-validation folds by assembly, and probabilities for assemblies that an estimator has not seen."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn import config_context
from sklearn.base import BaseEstimator, clone
from sklearn.model_selection import StratifiedGroupKFold
from sklearn.utils import check_random_state
from sklearn.utils.metadata_routing import MetadataRouter, get_routing_for_object
from sklearn.utils.multiclass import check_classification_targets

from cyclofeat.features.base import reject_short_windows
from cyclofeat.signal.windows import Float, Int

Folds = list[tuple[NDArray[np.intp], NDArray[np.intp]]]


def drawn_seed(random_state: int | None) -> int:
    """Return a seed, so that several steps can use the same random numbers."""
    return int(check_random_state(random_state).randint(2**31 - 1))


def of_windows(name: str, values: ArrayLike, n_windows: int, unit: str = "window") -> NDArray[Any]:
    """Return one value per window as an array, or raise ``ValueError`` with the argument's name."""
    array = np.asarray(values)
    if array.shape != (n_windows,):
        raise ValueError(
            f"{name} must hold one value per {unit}, shape ({n_windows},), got shape {array.shape}"
        )
    # A column of a data frame may hold objects.
    for where, value in enumerate(array.tolist() if array.dtype.kind in "fcO" else []):
        if value is None or (isinstance(value, (float, complex)) and not np.isfinite(value)):
            raise ValueError(f"{name} must hold a value for every {unit}, got {value} at {unit} {where}")
    return array


def ordered_classes(y: NDArray[Any]) -> tuple[NDArray[Any], Int]:
    """Return the sorted classes and the index of each window's class; ``ValueError`` for a single class."""
    check_classification_targets(y)
    classes, rank = np.unique(y, return_inverse=True)
    if classes.size < 2:
        raise ValueError(f"y must hold at least two classes, got 1 class: {classes.tolist()[0]!r}")
    return classes, np.asarray(rank, dtype=np.int64)


def assemblies_of(groups: ArrayLike | None, n_windows: int) -> Int:
    """Return the number of each window's assembly, from 0; without groups every window is one assembly."""
    if groups is None:
        return np.arange(n_windows)
    return np.asarray(np.unique(of_windows("groups", groups, n_windows), return_inverse=True)[1])


def fewest_assemblies(member: Int, y: NDArray[Any]) -> int:
    """Return the number of assemblies of the class that has the fewest."""
    return min(np.unique(member[y == label]).size for label in np.unique(y))


def grouped_folds(y: NDArray[Any], member: Int, n_splits: int, random_state: int | None) -> Folds:
    """Return folds that hold out whole assemblies, with even classes; [] if a class has only one assembly.

    There are at most ``n_splits`` folds, and no more than the rarest class has assemblies.
    """
    possible = min(n_splits, fewest_assemblies(member, y))
    if possible < 2:
        return []
    folds = StratifiedGroupKFold(possible, shuffle=True, random_state=random_state)
    return [(train, test) for train, test in folds.split(np.zeros(len(y)), y, member) if test.size]


def fit_clone(estimator: BaseEstimator, X: Any, y: NDArray[Any], **metadata: Any) -> BaseEstimator:
    """Fit a clone of an estimator, with the metadata that it or its steps take, and return it.

    Metadata reach steps of pipelines, searches and splitters by scikit-learn's metadata routing, enabled or
    not, unless a step's request is ``False``. Windows too short for a feature are an error.
    """
    with config_context(enable_metadata_routing=True), reject_short_windows():
        fitted = clone(estimator)
        for part in [fitted, *fitted.get_params(deep=True).values()]:
            if hasattr(part, "set_fit_request") and hasattr(part, "get_metadata_routing"):
                routing = get_routing_for_object(part)
                if isinstance(routing, MetadataRouter):  # of a meta-estimator, which may take metadata itself
                    routing = getattr(dict(routing).get("$self_request"), "router", None)
                stated = {} if routing is None else routing.fit.requests
                open_requests = {name: True for name in metadata if name in stated and stated[name] is None}
                if open_requests:
                    part.set_fit_request(**open_requests)
        taken = get_routing_for_object(fitted).consumes("fit", metadata)
        fitted.fit(X, y, **{name: metadata[name] for name in metadata if name in taken})
    for part in estimators_in(fitted):
        vars(part).pop("_metadata_request", None)  # so that files do not hold them
    return fitted


def estimators_in(estimator: Any) -> list[Any]:
    """Return an estimator and all estimators and dataclasses that it holds, outer ones first."""
    inside: list[Any] = []
    waiting = [estimator]
    while waiting:
        item = waiting.pop()
        if isinstance(item, BaseEstimator) or hasattr(type(item), "__dataclass_fields__"):
            inside.append(item)
            waiting += reversed(vars(item).values())
        elif isinstance(item, dict):
            waiting += reversed(item.values())
        elif isinstance(item, (list, tuple)):
            waiting += reversed(item)
        elif isinstance(item, np.ndarray) and item.dtype == object:
            waiting += item.ravel().tolist()[::-1]
    return inside


def aligned_proba(estimator: BaseEstimator, X: NDArray[Any], classes: NDArray[Any]) -> Float:
    """``predict_proba`` with a column for each of ``classes``, 0 for one that was not in training."""
    proba = np.zeros((len(X), len(classes)))
    proba[:, np.searchsorted(classes, estimator.classes_)] = estimator.predict_proba(X)
    return proba


def held_out_proba(
    estimator: BaseEstimator, X: NDArray[Any], y: NDArray[Any], classes: NDArray[Any], folds: Folds,
    **metadata: NDArray[Any],
) -> Float:  # fmt: skip
    """Return the probabilities of each window by a copy of the estimator trained without its assembly.

    Shape (n_windows, n_classes); NaN for windows that no fold holds out.
    """
    proba = np.full((len(y), len(classes)), np.nan)
    for train, test in folds:
        known = {name: values[train] for name, values in metadata.items()}
        fitted = fit_clone(estimator, X[train], y[train], **known)
        proba[test] = aligned_proba(fitted, X[test], classes)
    return proba
