"""Evaluation that keeps all windows of one assembly on the same side of every split."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import joblib
import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.base import BaseEstimator, clone
from sklearn.utils.validation import has_fit_parameter

from cyclofeat.counting.evaluation.assembly_folds import Int
from cyclofeat.counting.evaluation.protocol import Protocol, Windows, folds_of, training_windows, windows_of
from cyclofeat.counting.evaluation.summary import Answers, Evaluation, summarise


def evaluate(
    counter: BaseEstimator,
    X: ArrayLike,
    y: ArrayLike,
    groups: ArrayLike | None = None,
    *,
    lobes: tuple[ArrayLike, ArrayLike] | None = None,
    protocol: Protocol | None = None,
) -> Evaluation:
    """Test a counter on assemblies that it has not seen.

    Parameters
    ----------
    counter : estimator
        Classifier of windows; cloned for each fold, never changed. If its ``fit`` takes ``groups``, it gets
        those of the training windows.
    X : array-like, shape (n_windows, n_samples)
        Windows of torque in Nm.
    y : array-like of int, shape (n_windows,)
        Defect count of each window.
    groups : array-like, shape (n_windows,)
        Assembly of each window: several recordings of one assembly are one group.
    lobes : tuple of two arrays, optional
        ``(worn, passage)`` for a counter that locates lobes: worn lobes (bool, shape (n_windows, n_lobes),
        as from :meth:`WindowSet.worn_table`), and when lobe 0 passes (shape (n_windows,), as from
        :func:`passage_of_lobe_zero`).
    protocol : Protocol, optional
        What is held out, and how intervals are made. Default: ``Protocol()``, five folds by assembly.

    Returns
    -------
    Evaluation

    Raises
    ------
    ValueError
        Without groups; where a class has fewer assemblies than folds, or a condition holds a count that no
        other has; where counts are not numbers; where windows are not finite, all constant, or of different
        lengths than labels or groups.

    Examples
    --------
    >>> import numpy as np
    >>> from sklearn.naive_bayes import GaussianNB
    >>> random = np.random.default_rng(0)
    >>> assembly = np.repeat(np.arange(40), 2)
    >>> X = (assembly % 2)[:, np.newaxis] + random.normal(scale=0.1, size=(80, 3))
    >>> print(evaluate(GaussianNB(), X, assembly % 2, assembly, protocol=Protocol(n_splits=2)))
    accuracy 1.000 [0.928, 1.000], mean absolute error 0.000
    """
    protocol = protocol or Protocol()
    data = Windows.checked(X, y, groups, lobes)
    protocol.conditions_of(len(data.y))  # raises unless there is one per window
    return _over_folds(counter, data, data, folds_of(protocol, data), protocol)


def train_and_test(
    counter: BaseEstimator,
    training: tuple[Any, ...],
    test: tuple[Any, ...],
    *,
    protocol: Protocol | None = None,
) -> Evaluation:
    """Train a counter on some windows, simulated ones for example, and test it on others.

    Parameters
    ----------
    counter : estimator
        As for :func:`evaluate`.
    training, test : tuple of arrays
        ``(X, y, groups)`` or ``(X, y, groups, lobes)``, see :func:`evaluate`. They share no assembly.
    protocol : Protocol, optional
        Intervals and conditions of the test windows; nothing is held out.

    Returns
    -------
    Evaluation
        Its ``protocol`` is ``"train-test"``.

    Raises
    ------
    ValueError
        As :func:`evaluate`; also where training and test share an assembly.

    Examples
    --------
    >>> from sklearn.naive_bayes import GaussianNB
    >>> training = [[0.0], [0.2], [1.0], [1.2]], [0, 0, 1, 1], ["A", "B", "C", "D"]
    >>> test = [[0.1], [1.1]], [0, 1], ["E", "F"]
    >>> train_and_test(GaussianNB(), training, test).accuracy
    1.0
    """
    protocol = protocol or Protocol()
    data = windows_of("test", test)
    trained_on = training_windows(training, data)
    answers = Answers.empty(data)
    answers.enter(_fit(counter, trained_on, np.arange(len(trained_on.y))), data, np.arange(len(data.y)))
    protocol.report_progress(1, 1)
    return replace(summarise(data, answers, protocol), protocol="train-test")


def learning_curve(
    counter: BaseEstimator,
    X: ArrayLike,
    y: ArrayLike,
    groups: ArrayLike | None = None,
    *,
    n_assemblies: Sequence[int] = (2, 4, 8, 16),
    protocol: Protocol | None = None,
) -> dict[int, Evaluation]:
    """Evaluate with fewer training assemblies, on the same held-out assemblies.

    Parameters
    ----------
    counter, X, y, groups, protocol
        As in :func:`evaluate`.
    n_assemblies : sequence of int
        Training assemblies of each class. Smaller sets are parts of larger ones.

    Returns
    -------
    dict of int to Evaluation
        By number of training assemblies per class.

    Raises
    ------
    ValueError
        As :func:`evaluate`; also if a fold leaves a class fewer training assemblies than asked for.
    """
    protocol = protocol or Protocol()
    data = Windows.checked(X, y, groups)
    folds = folds_of(protocol, data)
    sizes = sorted(set(n_assemblies))
    if not sizes or sizes[0] < 1:
        raise ValueError(f"n_assemblies must hold whole numbers from 1 on, got {n_assemblies!r}")
    curve = {}
    for k, size in enumerate(sizes):
        smaller = [
            (_of_assemblies(data, train, size, np.random.default_rng([protocol.random_state, number])), test)
            for number, (train, test) in enumerate(folds)
        ]
        curve[int(size)] = _over_folds(counter, data, data, smaller, protocol, (k, len(sizes)))
    return curve


def _of_assemblies(
    data: Windows, train: NDArray[np.intp], size: int, random: np.random.Generator
) -> NDArray[np.intp]:
    """Training windows of ``size`` assemblies of each class."""
    parts = []
    for label in np.unique(data.y):
        of_class = train[data.y[train] == label]
        names = random.permutation(np.unique(data.groups[of_class]))
        if names.size < size:
            raise ValueError(
                f"n_assemblies asks for {size} training assemblies per class, but class {label} has "
                f"{names.size} in a fold: ask for fewer, or raise n_splits"
            )
        parts.append(of_class[np.isin(data.groups[of_class], names[:size])])
    return np.concatenate(parts)


def noise_sweep(
    counter: BaseEstimator,
    X: ArrayLike,
    y: ArrayLike,
    groups: ArrayLike | None = None,
    *,
    noise_nm: Sequence[float | tuple[float, float]] = (0.05, 0.2, 0.5, 1.0, 2.0),
    protocol: Protocol | None = None,
) -> dict[float, Evaluation]:
    """Evaluate with white noise added to the windows, on the same folds.

    Parameters
    ----------
    counter, X, y, groups, protocol
        As in :func:`evaluate`. ``X`` holds noise of its own already: pass windows with little of it.
    noise_nm : sequence of float or pairs of float
        Standard deviations of the noise added, in Nm. A pair is the noise of test and of training windows;
        a single number is that of both.

    Returns
    -------
    dict of float to Evaluation
        By the noise of the test windows.

    Raises
    ------
    ValueError
        As :func:`evaluate`; also if noise is negative or not finite.
    """
    protocol = protocol or Protocol()
    data = Windows.checked(X, y, groups)
    levels = [level if isinstance(level, tuple) else (level, level) for level in noise_nm]
    for value in np.ravel(levels):
        if not (np.isfinite(value) and value >= 0):
            raise ValueError(f"noise_nm must hold finite numbers from 0 on, got {float(value)!r}")
    folds = folds_of(protocol, data)
    # The same noise, scaled, so that only the level differs.
    test_noise, train_noise = (
        np.random.default_rng([protocol.random_state, k]).standard_normal(data.X.shape) for k in (1, 2)
    )
    sweep = {}
    for k, (tested, trained) in enumerate(levels):
        heard = data.with_torque(data.X + tested * test_noise)
        learned = heard if trained == tested else data.with_torque(data.X + trained * train_noise)
        sweep[float(tested)] = _over_folds(counter, learned, heard, folds, protocol, (k, len(levels)))
    return sweep


def _over_folds(
    counter: BaseEstimator,
    learned: Windows,
    heard: Windows,
    folds: Sequence[tuple[Int, Int]],
    protocol: Protocol,
    part: tuple[int, int] = (0, 1),
) -> Evaluation:
    """Fit to some windows of each fold, in parallel as the protocol says, and test on others.

    ``part`` is which of how many evaluations this is, for their common progress.
    """
    answers = Answers.empty(heard)
    fits = joblib.Parallel(n_jobs=protocol.n_jobs, return_as="generator")(
        joblib.delayed(_fit)(counter, learned, train) for train, _ in folds
    )
    done, n_parts = part[0] * len(folds), part[1]
    for number, (fitted, (_, test)) in enumerate(zip(fits, folds, strict=True), start=1):
        answers.enter(fitted, heard, test)
        protocol.report_progress(done + number, n_parts * len(folds))
    return summarise(heard, answers, protocol)


def _fit(counter: BaseEstimator, data: Windows, train: Int) -> BaseEstimator:
    """Fit a copy of the counter to some windows, with the further arguments that its ``fit`` accepts."""
    fitted = clone(counter)
    taken = {}
    for name in ("groups", "worn", "passage"):
        values = getattr(data, name)
        if values is not None and has_fit_parameter(fitted, name):
            taken[name] = values[train]
    return fitted.fit(data.X[train], data.y[train], **taken)
