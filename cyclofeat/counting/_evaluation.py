"""Evaluation that keeps all windows of one assembly on the same side of every split."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import joblib
import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.base import BaseEstimator, clone
from sklearn.utils.validation import has_fit_parameter

from cyclofeat.counting._evaluation_summary import Answers, Evaluation, summarise
from cyclofeat.counting._folds import of_windows
from cyclofeat.counting._protocols import PROTOCOLS, Windows, folds_of, training_windows


def evaluate(
    counter: BaseEstimator,
    X: ArrayLike,
    y: ArrayLike,
    groups: ArrayLike | None = None,
    *,
    protocol: str = "stratified",
    conditions: ArrayLike | None = None,
    training: tuple[Any, ...] | None = None,
    worn: ArrayLike | None = None,
    passage: ArrayLike | None = None,
    n_splits: int = 5,
    confidence: float = 0.95,
    n_bootstrap: int = 1000,
    random_state: int = 0,
    n_jobs: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Evaluation:
    """Test a counter on assemblies that it has not seen.

    Parameters
    ----------
    counter : estimator
        Classifier of windows; cloned for each fold, never changed. One whose ``fit`` takes ``groups`` gets
        those of the training windows.
    X : array-like, shape (n_windows, n_samples)
        Windows of torque in Nm.
    y : array-like of int, shape (n_windows,)
        Defect count of each window.
    groups : array-like, shape (n_windows,)
        Assembly of each window: several recordings of one assembly are one group.
    protocol : {"stratified", "leave-one-assembly-out", "leave-one-condition-out"}
        What is held out in turn: a share of the assemblies of every class
        (``StratifiedGroupKFold(shuffle=True)``); one assembly; all windows of one condition - the training
        windows are then those of other conditions *and* other assemblies.
    conditions : array-like, shape (n_windows,), optional
        Load, speed, material or whatever the windows differ in beside the count. Needed to leave one out;
        given with another protocol, the accuracy of each condition is reported.
    training : tuple of array-like, optional
        ``(X, y, groups)`` of other windows to train on once - simulated ones, say - and to test on all of
        ``X``. ``protocol`` is then "train-test". With ``worn`` and ``passage``: five arrays.
    worn : array-like of bool, shape (n_windows, n_lobes), optional
        Worn lobes, for a counter that finds them; together with ``passage``.
    passage : array-like, shape (n_windows,), optional
        When lobe 0 passes, see :func:`passage_of_lobe_zero`.
    n_splits : int
        Number of folds of the stratified protocol.
    confidence : float
        Coverage of the bootstrap intervals.
    n_bootstrap : int
        Number of bootstrap draws over assemblies.
    random_state : int
        Seed of folds and bootstrap.
    n_jobs : int, optional
        Processes that fit folds side by side, as in joblib: None is one, -1 all processors.
    progress : callable, optional
        Called as ``progress(folds_done, n_folds)``.

    Returns
    -------
    Evaluation

    Raises
    ------
    ValueError
        Without groups; where a class has fewer assemblies than folds, a condition holds a count that no other
        has, or training and test share an assembly; where counts are not numbers; where windows are not
        finite, all constant, or of different lengths than labels or groups.

    Examples
    --------
    >>> import numpy as np
    >>> from sklearn.naive_bayes import GaussianNB
    >>> random = np.random.default_rng(0)
    >>> assembly = np.repeat(np.arange(40), 2)
    >>> X = (assembly % 2)[:, np.newaxis] + random.normal(scale=0.1, size=(80, 3))
    >>> print(evaluate(GaussianNB(), X, assembly % 2, assembly))
    accuracy 1.000 [0.928, 1.000], mean absolute error 0.000
    """
    data = Windows.checked(X, y, groups, worn, passage)
    if not 0 < confidence < 1:
        raise ValueError(f"confidence must lie between 0 and 1, got {confidence!r}")
    if n_splits < 2:
        raise ValueError(f"n_splits must be at least 2, got {n_splits!r}")
    if protocol not in PROTOCOLS:
        raise ValueError(f"protocol must be one of {PROTOCOLS}, got {protocol!r}")
    named = None if conditions is None else of_windows("conditions", conditions, len(data.y))
    classes = np.unique(data.y)
    answers = Answers.empty(data, classes)
    if training is not None:
        protocol = "train-test"
        trained_on = training_windows(training, data)
        fitted = _fit(counter, trained_on, np.arange(len(trained_on.y)))
        answers.enter(fitted, data, np.arange(len(data.y)))
        classes = answers.classes
        if progress is not None:
            progress(1, 1)
    else:
        folds = folds_of(protocol, data, named, n_splits, random_state)
        fits = joblib.Parallel(n_jobs=n_jobs, return_as="generator")(
            joblib.delayed(_fit)(counter, data, train) for train, _ in folds
        )
        for done, (fitted, (_, test)) in enumerate(zip(fits, folds, strict=True), start=1):
            answers.enter(fitted, data, test)
            if progress is not None:
                progress(done, len(folds))
    return summarise(data, answers, named, protocol, confidence, n_bootstrap, random_state)


def learning_curve(
    counter: BaseEstimator,
    X: ArrayLike,
    y: ArrayLike,
    groups: ArrayLike | None = None,
    *,
    n_assemblies: Sequence[int] = (2, 4, 8, 16),
    n_splits: int = 5,
    confidence: float = 0.95,
    n_bootstrap: int = 1000,
    random_state: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> dict[int, Evaluation]:
    """Scores against the number of training assemblies per class, on the same held-out assemblies.

    Parameters
    ----------
    counter, X, y, groups, n_splits, confidence, n_bootstrap, random_state
        As in :func:`evaluate`.
    n_assemblies : sequence of int
        Training assemblies of each class. Smaller sets are parts of larger ones.
    progress : callable, optional
        Called as ``progress(fits_done, n_fits)``.

    Returns
    -------
    dict of int to Evaluation

    Raises
    ------
    ValueError
        As :func:`evaluate`; also if a fold leaves a class fewer training assemblies than asked for.
    """
    data = Windows.checked(X, y, groups, None, None)
    folds = folds_of("stratified", data, None, n_splits, random_state)
    sizes = sorted(set(n_assemblies))
    if not sizes or sizes[0] < 1:
        raise ValueError(f"n_assemblies must hold whole numbers from 1 on, got {n_assemblies!r}")
    curve, done = {}, 0
    for size in sizes:
        answers = Answers.empty(data, np.unique(data.y))
        for number, (train, test) in enumerate(folds):
            random = np.random.default_rng([random_state, number])
            kept = []
            for label in np.unique(data.y):
                of_class = train[data.y[train] == label]
                names = random.permutation(np.unique(data.groups[of_class]))
                if names.size < size:
                    raise ValueError(
                        f"n_assemblies asks for {size} training assemblies per class, but class {label} has "
                        f"{names.size} in a fold: ask for fewer, or raise n_splits"
                    )
                kept.append(of_class[np.isin(data.groups[of_class], names[:size])])
            answers.enter(_fit(counter, data, np.concatenate(kept)), data, test)
            done += 1
            if progress is not None:
                progress(done, len(sizes) * len(folds))
        curve[int(size)] = summarise(data, answers, None, "stratified", confidence, n_bootstrap, random_state)
    return curve


def noise_sweep(
    counter: BaseEstimator,
    X: ArrayLike,
    y: ArrayLike,
    groups: ArrayLike | None = None,
    *,
    noise_nm: Sequence[float] = (0.05, 0.2, 0.5, 1.0, 2.0),
    training_noise_nm: float | str = "same",
    worn: ArrayLike | None = None,
    passage: ArrayLike | None = None,
    n_splits: int = 5,
    confidence: float = 0.95,
    n_bootstrap: int = 1000,
    random_state: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> dict[float, Evaluation]:
    """Scores against white noise added to the windows, on the same folds.

    Parameters
    ----------
    counter, X, y, groups, worn, passage, n_splits, confidence, n_bootstrap, random_state
        As in :func:`evaluate`. ``X`` holds noise of its own already: pass windows with little of it.
    noise_nm : sequence of float
        Standard deviations of the noise added, in Nm.
    training_noise_nm : float or "same"
        Standard deviation of the noise added to training windows, in Nm: that of the test windows, or a fixed
        one for a counter that does not know how noisy its windows will be.
    progress : callable, optional
        Called as ``progress(fits_done, n_fits)``.

    Returns
    -------
    dict of float to Evaluation

    Raises
    ------
    ValueError
        As :func:`evaluate`; also if noise is negative or not finite.
    """
    data = Windows.checked(X, y, groups, worn, passage)
    if isinstance(training_noise_nm, str) and training_noise_nm != "same":
        raise ValueError(f"training_noise_nm must be a number or 'same', got {training_noise_nm!r}")
    fixed = None if isinstance(training_noise_nm, str) else training_noise_nm
    for value in [*noise_nm, *([] if fixed is None else [fixed])]:
        if not (np.isfinite(value) and value >= 0):
            raise ValueError(f"noise_nm must hold finite numbers from 0 on, got {value!r}")
    folds = folds_of("stratified", data, None, n_splits, random_state)
    # One pattern of noise, scaled: what changes from level to level is the level alone.
    test_noise, train_noise = (
        np.random.default_rng([random_state, k]).standard_normal(data.X.shape) for k in (1, 2)
    )
    sweep, done = {}, 0
    for level in noise_nm:
        heard = data.with_torque(data.X + level * test_noise)
        trained = heard if fixed is None else data.with_torque(data.X + fixed * train_noise)
        answers = Answers.empty(data, np.unique(data.y))
        for train, test in folds:
            answers.enter(_fit(counter, trained, train), heard, test)
            done += 1
            if progress is not None:
                progress(done, len(noise_nm) * len(folds))
        sweep[float(level)] = summarise(
            heard, answers, None, "stratified", confidence, n_bootstrap, random_state
        )
    return sweep


def _fit(counter: BaseEstimator, data: Windows, train: NDArray[np.intp]) -> BaseEstimator:
    """A copy of the counter fitted to some windows, with what else its ``fit`` takes."""
    fitted = clone(counter)
    extra = {"groups": data.groups, "worn": data.worn, "passage": data.passage}
    taken = {
        name: values[train]
        for name, values in extra.items()
        if values is not None and has_fit_parameter(fitted, name)
    }
    return fitted.fit(data.X[train], data.y[train], **taken)
