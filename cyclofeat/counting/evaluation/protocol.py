"""Protocol of an evaluation, and its windows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass, field, replace
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.model_selection import StratifiedGroupKFold
from sklearn.utils import check_array, check_consistent_length

from cyclofeat._base.checks import one_of, short
from cyclofeat.counting.evaluation.assembly_folds import Float, Folds, of_windows

HOLD_OUT = ("stratified", "leave-one-assembly-out", "leave-one-condition-out")
_LEAK = (
    "groups must name the assembly of every window, got None: windows of one recording look alike for "
    "reasons that have nothing to do with wear, so a split that puts them on both sides measures how well "
    "the counter recognises the recording. Pass the groups that Windower.transform returns"
)


@dataclass(frozen=True)
class Protocol:
    """Protocol of an evaluation: what is held out, how intervals are made, and how it runs.

    Parameters
    ----------
    hold_out : {"stratified", "leave-one-assembly-out", "leave-one-condition-out"}, default="stratified"
        What is held out in turn: a share of the assemblies of every class
        (``StratifiedGroupKFold(shuffle=True)``); one assembly; all windows of one condition (the training
        windows are then those of other conditions *and* other assemblies).
    conditions : array-like, shape (n_windows,), optional
        Load, speed, material or whatever the windows differ in besides the count. Required to leave one
        condition out; otherwise the accuracy of each condition is reported.
    n_splits : int, default=5
        Number of folds of ``"stratified"``.
    confidence : float, default=0.95
        Coverage of the bootstrap intervals.
    n_bootstrap : int, default=1000
        Number of bootstrap draws over assemblies.
    random_state : int, default=0
        Seed of folds and bootstrap.
    n_jobs : int, optional
        Processes that fit folds in parallel, as in joblib: None is one, -1 all processors.
    progress : callable, optional
        Called as ``progress(fits_done, n_fits)``.

    Raises
    ------
    ValueError
        If a parameter is out of its range.
    """

    hold_out: str = "stratified"
    _: KW_ONLY
    conditions: ArrayLike | None = field(default=None, repr=False)
    n_splits: int = 5
    confidence: float = 0.95
    n_bootstrap: int = 1000
    random_state: int = 0
    n_jobs: int | None = None
    progress: Callable[[int, int], None] | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        if not 0 < self.confidence < 1:
            raise ValueError(f"confidence must lie between 0 and 1, got {self.confidence!r}")
        if self.n_splits < 2:
            raise ValueError(f"n_splits must be at least 2, got {self.n_splits!r}")
        one_of("hold_out", self.hold_out, HOLD_OUT)

    def report_progress(self, fits_done: int, n_fits: int) -> None:
        """Call ``progress``, if there is one."""
        if self.progress is not None:
            self.progress(fits_done, n_fits)

    def conditions_of(self, n_windows: int) -> NDArray[Any] | None:
        """Return the condition of each window, checked; None without conditions."""
        return None if self.conditions is None else of_windows("conditions", self.conditions, n_windows)


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
        lobes: tuple[ArrayLike, ArrayLike] | None = None,
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
        if constant.size and windows.shape[1] > 1:  # a single feature instead of a window may be constant
            raise ValueError(f"X must hold windows with variation, but window {constant[0]} is constant")
        if lobes is None:
            return cls(windows, labels, assemblies, None, None)
        if not isinstance(lobes, tuple) or len(lobes) != 2:
            raise ValueError(f"lobes must be a tuple (worn, passage), got {short(lobes)}")
        worn, passage = lobes
        marks = np.asarray(worn, dtype=bool)
        if marks.ndim != 2 or len(marks) != len(windows):
            raise ValueError(
                f"worn must have shape (n_windows, n_lobes) with {len(windows)} windows, got {marks.shape}"
            )
        begins = of_windows("passage", passage, len(windows)).astype(float)
        return cls(windows, labels, assemblies, marks, begins)

    def with_torque(self, X: NDArray[Any]) -> Windows:
        """Return the same labels with other windows."""
        return replace(self, X=X)


def windows_of(name: str, arrays: tuple[Any, ...]) -> Windows:
    """Return checked windows of a tuple ``(X, y, groups)`` or ``(X, y, groups, lobes)``."""
    if not isinstance(arrays, tuple) or len(arrays) not in (3, 4):
        raise ValueError(
            f"{name} must be a tuple (X, y, groups) or (X, y, groups, lobes), got {short(arrays)}"
        )
    return Windows.checked(*arrays)


def training_windows(training: tuple[Any, ...], data: Windows) -> Windows:
    """Return checked training windows that share no assembly with ``data``."""
    windows = windows_of("training", training)
    both = np.intersect1d(windows.groups, data.groups)
    if both.size:
        raise ValueError(
            f"training and test must not share assemblies, but both hold {both.tolist()[0]!r}: what the "
            "counter remembers of an assembly is no measure of what it says of others"
        )
    return windows


def folds_of(protocol: Protocol, data: Windows) -> Folds:
    """Return the indices of training and test windows of each fold."""
    if protocol.hold_out == "leave-one-condition-out":
        return _by_condition(data, protocol.conditions_of(len(data.y)))
    stratified = protocol.hold_out == "stratified"
    least = protocol.n_splits if stratified else 2
    for label in np.unique(data.y):
        n_assemblies = np.unique(data.groups[data.y == label]).size
        if n_assemblies < least:
            fewer = f"n_splits={least}" if stratified else f"the 2 that {protocol.hold_out} needs"
            assemblies = "1 assembly" if n_assemblies == 1 else f"{n_assemblies} assemblies"
            lower = " or lower n_splits" if stratified and n_assemblies > 1 else ""
            raise ValueError(
                f"class {label} has {assemblies}, fewer than {fewer}: each fold holds out another; "
                f"record more{lower}"
            )
    if not stratified:
        held_out = (data.groups == name for name in np.unique(data.groups))
        return [(np.flatnonzero(~rows), np.flatnonzero(rows)) for rows in held_out]
    splitter = StratifiedGroupKFold(
        n_splits=protocol.n_splits, shuffle=True, random_state=protocol.random_state
    )
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
