"""Windows to be evaluated on, and which of them are held out together."""

from __future__ import annotations

from dataclasses import dataclass
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.model_selection import StratifiedGroupKFold
from sklearn.utils import check_array, check_consistent_length

from cyclofeat.counting._folds import Float, Folds, of_windows

PROTOCOLS = ("stratified", "leave-one-assembly-out", "leave-one-condition-out")
_LEAK = (
    "groups must name the assembly of every window, got None: windows of one recording look alike for "
    "reasons that have nothing to do with wear, so a split that puts them on both sides measures how well "
    "the counter recognises the recording. Pass the groups that Windower.transform returns"
)


@dataclass(frozen=True)
class Windows:
    """Checked windows with their labels."""

    X: NDArray[Any]
    y: NDArray[Any]
    groups: NDArray[Any]
    worn: NDArray[np.bool_] | None
    passage: Float | None

    @classmethod
    def checked(
        cls,
        X: ArrayLike,
        y: ArrayLike,
        groups: ArrayLike | None,
        worn: ArrayLike | None,
        passage: ArrayLike | None,
    ) -> Windows:
        if groups is None:
            raise ValueError(_LEAK)
        windows: NDArray[Any] = check_array(X, dtype=[np.float64, np.float32], input_name="X")
        labels, assemblies = np.asarray(y), np.asarray(groups)
        for name, values in (("y", labels), ("groups", assemblies)):
            if values.ndim != 1:
                raise ValueError(f"{name} must hold one value per window, got shape {values.shape}")
        check_consistent_length(windows, labels, assemblies)
        if not all(isinstance(label, Real) for label in labels.tolist()):
            raise ValueError(f"y must hold defect counts (numbers), got {labels.tolist()[0]!r}")
        constant = np.flatnonzero(windows.max(axis=1) == windows.min(axis=1))
        if constant.size and windows.shape[1] > 1:  # a single feature may well stand in place of a window
            raise ValueError(f"X must hold windows with variation, but window {constant[0]} is constant")
        if (worn is None) != (passage is None):
            raise ValueError("worn and passage must be given together: lobes are numbered by the passage")
        if worn is None or passage is None:
            return cls(windows, labels, assemblies, None, None)
        marks = np.asarray(worn, dtype=bool)
        if marks.ndim != 2 or len(marks) != len(windows):
            raise ValueError(
                f"worn must have shape (n_windows, n_lobes) with {len(windows)} windows, got {marks.shape}"
            )
        begins = of_windows("passage", passage, len(windows)).astype(float)
        return cls(windows, labels, assemblies, marks, begins)

    def with_torque(self, X: NDArray[Any]) -> Windows:
        return Windows(X, self.y, self.groups, self.worn, self.passage)


def training_windows(training: tuple[Any, ...], data: Windows) -> Windows:
    if not isinstance(training, tuple) or len(training) not in (3, 5):
        raise ValueError(
            "training must be a tuple (X, y, groups), or (X, y, groups, worn, passage), got "
            f"{type(training).__name__}" + (f" of {len(training)}" if isinstance(training, tuple) else "")
        )
    windows = Windows.checked(*(training if len(training) == 5 else (*training, None, None)))
    both = np.intersect1d(windows.groups, data.groups)
    if both.size:
        raise ValueError(
            f"training and test must not share assemblies, but both hold {both.tolist()[0]!r}: what the "
            "counter remembers of an assembly is no measure of what it says of others"
        )
    return windows


def folds_of(
    protocol: str, data: Windows, conditions: NDArray[Any] | None, n_splits: int, random_state: int
) -> Folds:
    if protocol == "leave-one-condition-out":
        return _by_condition(data, conditions)
    least = n_splits if protocol == "stratified" else 2
    for label in np.unique(data.y):
        n_assemblies = np.unique(data.groups[data.y == label]).size
        if n_assemblies < least:
            fewer = f"n_splits={n_splits}" if protocol == "stratified" else f"the 2 that {protocol} needs"
            raise ValueError(
                f"class {label} has {n_assemblies} assemblies, fewer than {fewer}: with one "
                "recording per class no split can estimate an accuracy; record more or lower n_splits"
            )
    if protocol == "leave-one-assembly-out":
        held_out = (data.groups == name for name in np.unique(data.groups))
        return [(np.flatnonzero(~rows), np.flatnonzero(rows)) for rows in held_out]
    splitter = StratifiedGroupKFold(n_splits=n_splits, shuffle=True, random_state=random_state)
    return list(splitter.split(data.X, data.y, data.groups))


def _by_condition(data: Windows, conditions: NDArray[Any] | None) -> Folds:
    if conditions is None:
        raise ValueError("conditions must name the condition of every window to leave one out, got None")
    names = np.unique(conditions)
    if names.size < 2:
        raise ValueError(f"conditions must name at least two conditions, got {names.tolist()} only")
    folds: Folds = []
    for name in names:
        test = conditions == name
        train = ~test & ~np.isin(data.groups, data.groups[test])
        missing = np.setdiff1d(data.y[test], data.y[train])
        if missing.size:
            raise ValueError(
                f"condition {name} holds count {missing[0]}, which no assembly of another condition has: "
                "record every count in at least two conditions, with an assembly of its own in each"
            )
        folds.append((np.flatnonzero(train), np.flatnonzero(test)))
    return folds
