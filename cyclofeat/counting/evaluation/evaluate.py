"""Evaluation that keeps all windows of one assembly on the same side of every split."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import KW_ONLY, dataclass, field
from numbers import Real
from typing import TYPE_CHECKING, Any

import joblib
import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.base import BaseEstimator
from sklearn.utils import check_array

from cyclofeat._base.checks import one_of, repr_of, whole
from cyclofeat._base.quantities import number_of
from cyclofeat.counting.evaluation.assembly_folds import (
    Folds,
    aligned_proba,
    fit_clone,
    grouped_folds,
    of_windows,
)
from cyclofeat.counting.evaluation.evaluation import Evaluation
from cyclofeat.counting.evaluation.scores import (
    bootstrap_interval,
    bootstrap_weights,
    calibration_sums,
    confusion_interval,
    expected_calibration_error,
    limits_at_ends,
    macro_f1,
    ratio_of_sums,
    rule_of_three,
    sums_by_assembly,
    window_weights,
)
from cyclofeat.recordings import Recording
from cyclofeat.signal.windows import Float, Int

if TYPE_CHECKING:
    from cyclofeat.counting.model.lobe_count import LobeCount

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
    hold_out : {"stratified", "leave-one-condition-out", "nothing"}, default="stratified"
        What is held out in turn: a share of the assemblies of every class
        (``StratifiedGroupKFold(shuffle=True)``); all windows of one condition (the training windows are then
        those of other conditions *and* other assemblies). ``"nothing"``: the counter is fitted already, to
        other assemblies, and only tested.
    conditions : array-like, shape (n_windows,), optional
        Load, speed, material or whatever the windows differ in besides the count, or the assemblies to leave
        out one by one. The accuracy of each condition is reported.
    n_splits : int, default=5
        Number of folds of ``"stratified"``.
    confidence : float, default=0.95
        Coverage of the bootstrap intervals.
    random_state : int, optional
        Seed of folds and bootstrap.
    n_jobs : int, optional
        Processes that fit folds in parallel, as in joblib: None is one, -1 all processors.
    progress : callable, optional
        Called as ``progress(fits_done, n_fits)``.
    """

    hold_out: str = "stratified"
    _: KW_ONLY
    conditions: ArrayLike | None = field(default=None, repr=False)
    n_splits: int = 5
    confidence: float = 0.95
    random_state: int | None = None
    n_jobs: int | None = None
    progress: Callable[[int, int], None] | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        if not 0 < self.confidence < 1:
            raise ValueError(f"confidence must lie between 0 and 1, got {self.confidence!r}")
        whole("n_splits", self.n_splits, 2)
        one_of("hold_out", self.hold_out, ("stratified", "leave-one-condition-out", "nothing"))


def evaluate(
    counter: BaseEstimator,
    X: ArrayLike | Sequence[Recording],
    y: ArrayLike | None = None,
    groups: ArrayLike | None = None,
    *,
    lobes: tuple[ArrayLike, ArrayLike] | None = None,
    protocol: Protocol | None = None,
) -> Evaluation:
    """Test a counter on assemblies that it has not seen.

    Parameters
    ----------
    counter : estimator
        Classifier of windows, or a :class:`LobeModel`; cloned for each fold, never changed. The groups of the
        training windows reach every step that takes ``groups`` in ``fit``, in pipelines and searches too, by
        scikit-learn's metadata routing, which need not be enabled; a request of ``False`` keeps them away.
    X : array-like, shape (n_windows, n_samples), or sequence of Recording
        Windows of torque in Nm; recordings for a :class:`LobeModel`.
    y, groups : array-like, shape (n_windows,) or (n_recordings,)
        Defect count and assembly of each window or recording: several recordings of one assembly are one
        group. Recordings state their own by default.
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
        other has; where counts are not numbers; where windows are not finite, constant, too short for a
        feature, or not as many as labels or groups.

    Examples
    --------
    >>> import numpy as np
    >>> from sklearn.naive_bayes import GaussianNB
    >>> random = np.random.default_rng(0)
    >>> assembly = np.repeat(np.arange(40), 2)
    >>> X = (assembly % 2)[:, np.newaxis] + random.normal(scale=0.1, size=(80, 3))
    >>> protocol = Protocol(n_splits=2, random_state=0)
    >>> print(evaluate(GaussianNB(), X, assembly % 2, assembly, protocol=protocol))
    accuracy 1.000 [0.928, 1.000], mean absolute error 0.000
    """
    protocol = protocol or Protocol()
    data = LabelledData.from_arrays(X, y, groups, lobes)
    conditions = protocol.conditions
    if conditions is not None:
        conditions = of_windows("conditions", conditions, len(data.y))
    answers = Answers.empty(data)
    if protocol.hold_out == "nothing":
        answers.add_fold(counter, np.arange(len(data.y)))
        return score_answers(answers, protocol, conditions)
    folds = folds_of(protocol, data, conditions)
    fits = joblib.Parallel(n_jobs=protocol.n_jobs, return_as="generator")(
        joblib.delayed(fit_clone)(counter, data.X[train], data.y[train], **data.fit_metadata(train))
        for train, _ in folds
    )
    for number, (fitted, (_, test)) in enumerate(zip(fits, folds, strict=True), start=1):
        answers.add_fold(fitted, test)
        if protocol.progress is not None:
            protocol.progress(number, len(folds))
    return score_answers(answers, protocol, conditions)


@dataclass(frozen=True)
class LabelledData:
    """Checked windows, or recordings, with their labels."""

    X: NDArray[Any]
    y: NDArray[Any]
    groups: NDArray[Any]
    worn: NDArray[np.bool_] | None = None
    passage: Float | None = None

    @classmethod
    def from_arrays(
        cls,
        X: ArrayLike | Sequence[Recording],
        y: ArrayLike | None,
        groups: ArrayLike | None,
        lobes: tuple[ArrayLike, ArrayLike] | None = None,
    ) -> LabelledData:
        given: NDArray[Any]
        if isinstance(X, (list, tuple, np.ndarray)) and len(X) and all(isinstance(x, Recording) for x in X):
            given = np.fromiter(X, dtype=object)
            y = [recording.defect_count for recording in given] if y is None else y
            stated = [recording.assembly for recording in given]
            groups = stated if groups is None and None not in stated else groups
        else:
            given = check_array(X, dtype=[np.float64, np.float32], input_name="X")
            constant = np.flatnonzero(given.max(axis=1) == given.min(axis=1))
            if constant.size and given.shape[1] > 1:  # a single feature instead of a window may be constant
                raise ValueError(f"X must hold windows with variation, but window {constant[0]} is constant")
        if groups is None:
            raise ValueError(_LEAK)
        labels = of_windows("y", np.asarray(y), len(given))
        assemblies = of_windows("groups", groups, len(given))
        for label in labels.tolist():
            if not isinstance(label, Real):
                raise ValueError(f"y must hold defect counts (numbers), got {label!r}")
        if lobes is None:
            return cls(given, labels, assemblies)
        if not isinstance(lobes, tuple) or len(lobes) != 2:
            raise ValueError(f"lobes must be a tuple (worn, passage), got {repr_of(lobes)}")
        worn, passage = lobes
        marks = np.asarray(worn, dtype=bool)
        if marks.ndim != 2 or len(marks) != len(given):
            raise ValueError(
                f"worn must have shape (n_windows, n_lobes) with {len(given)} windows, got {marks.shape}"
            )
        begins = of_windows("passage", passage, len(given)).astype(float)
        return cls(given, labels, assemblies, marks, begins)

    def fit_metadata(self, rows: Int | slice) -> dict[str, Any]:
        """Return what ``fit`` may take beside ``X`` and ``y``, for some windows."""
        columns = {"groups": self.groups, "worn": self.worn, "passage": self.passage}
        return {name: values[rows] for name, values in columns.items() if values is not None}


def folds_of(protocol: Protocol, data: LabelledData, conditions: NDArray[Any] | None) -> Folds:
    """Return the indices of training and test windows of each fold."""
    if protocol.hold_out == "leave-one-condition-out":
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
    for label in np.unique(data.y):
        n_assemblies = np.unique(data.groups[data.y == label]).size
        if n_assemblies < protocol.n_splits:
            raise ValueError(
                f"class {label} has {number_of(n_assemblies, 'assembly')}, fewer than n_splits = "
                f"{protocol.n_splits}: each fold holds out another; record more or take fewer folds"
            )
    return grouped_folds(data.y, data.groups, protocol.n_splits, protocol.random_state)


@dataclass
class Answers:
    """Answers of counters for held-out windows, or for held-out recordings; as in :class:`Evaluation`."""

    data: LabelledData
    classes: NDArray[Any]
    predictions: NDArray[Any]
    certainty: Float
    folds: Int
    proba: Float | None = None
    exact: NDArray[np.bool_] | None = None
    reasons: NDArray[np.str_] | None = None
    counts: dict[int, LobeCount] = field(default_factory=dict)

    @classmethod
    def empty(cls, data: LabelledData) -> Answers:
        """Return a table for the answers about ``data``, still empty."""
        n = len(data.y)
        return cls(data, np.unique(data.y), np.empty_like(data.y), np.full(n, np.nan), np.full(n, -1))

    def add_fold(self, fitted: Any, test: NDArray[np.intp]) -> None:
        """Store the answers of a fitted counter for some windows or recordings, the next fold."""
        X = self.data.X[test]
        self.folds[test] = self.folds.max() + 1
        classes = np.union1d(self.classes, getattr(fitted, "classes_", self.classes))
        proba: Float | None = None
        if hasattr(fitted, "count_all"):
            counts = fitted.count_all(X)
            self.counts |= dict(zip(test.tolist(), counts, strict=True))
            self.predictions[test] = [count.defect_count for count in counts]
            proba = np.array([[count.probability.get(c, 0.0) for c in classes.tolist()] for count in counts])
        else:
            self.predictions[test] = fitted.predict(X)
            if hasattr(fitted, "predict_proba"):
                proba = aligned_proba(fitted, X, classes)
        if proba is not None:
            # A counter may know counts that the test does not contain, or other folds.
            wider = np.zeros((len(self.data.y), classes.size))
            if self.proba is not None:
                wider[:, np.searchsorted(classes, self.classes)] = self.proba
            wider[test] = proba
            self.proba = wider
            self.certainty[test] = proba.max(axis=1)
        self.classes = classes
        if self.data.worn is not None and self.data.passage is not None and hasattr(fitted, "predict_lobes"):
            self.exact = np.zeros(len(self.data.y), dtype=bool) if self.exact is None else self.exact
            worn = fitted.predict_lobes(X, self.data.passage[test])
            self.exact[test] = np.all(worn == self.data.worn[test], axis=1)

    def of_windows(self) -> Answers:
        """Return the answers for the windows of the recordings that were counted."""
        windows = [(row, window) for row, count in sorted(self.counts.items()) for window in count.windows]
        rows = np.array([row for row, _ in windows])
        return Answers(
            LabelledData(rows, self.data.y[rows], self.data.groups[rows]),
            self.classes,
            np.array([window.defect_count for _, window in windows]),
            np.array([window.probability for _, window in windows]),
            self.folds[rows],
            reasons=np.array([window.reason for _, window in windows]),
        )


def score_answers(answers: Answers, protocol: Protocol, conditions: NDArray[Any] | None = None) -> Evaluation:
    """Return the scores of answers; intervals are those of a bootstrap over assemblies."""
    labels, predictions, classes = answers.data.y, answers.predictions, answers.classes
    groups, member = np.unique(answers.data.groups, return_inverse=True)
    drawn = bootstrap_weights(groups.size, protocol.random_state)
    scores: dict[str, Any] = {}

    def add_score(name: str, function: Callable[[Float], Float], sums: Float, n: int | None = None) -> None:
        """Add a score of sums over each assembly with its interval; of a share of ``n`` assemblies."""
        value, limits = bootstrap_interval(function, sums, drawn, protocol.confidence)
        limits = limits if n is None else limits_at_ends(value, limits, n, protocol.confidence)
        scores.update({name: value, f"{name}_interval": limits})

    def add_share(name: str, hits: NDArray[np.bool_], counted: NDArray[np.bool_]) -> None:
        columns = np.column_stack([hits & counted, counted])
        n_assemblies = np.unique(member[counted]).size
        add_score(name, ratio_of_sums, sums_by_assembly(columns, member), n_assemblies)

    right, every = labels == predictions, np.ones(labels.size, dtype=bool)
    add_share("accuracy", right, every)
    # Unsigned numbers would wrap around.
    errors = np.abs(labels.astype(float) - predictions.astype(float))
    add_score(
        "mean_absolute_error", ratio_of_sums, sums_by_assembly(np.column_stack([errors, every]), member)
    )
    if not errors.any():  # upper limit by the rule of three, with errors of one lobe
        scores["mean_absolute_error_interval"] = (0.0, rule_of_three(groups.size, protocol.confidence))
    if np.isfinite(answers.certainty).all():
        sums = calibration_sums(answers.certainty, right, window_weights(member), member)
        add_score("calibration_error", expected_calibration_error, sums)
        scores |= {"certainty": answers.certainty, "probabilities": answers.proba}
    exact, reasons = answers.exact, answers.reasons
    if answers.counts:
        counts = [answers.counts[row] for row in range(labels.size)]
        reasons = np.array([count.reason for count in counts])
        worn = [recording.worn_lobes for recording in answers.data.X]
        if None not in worn and all(count.absolute for count in counts):
            exact = np.array([set(c.lobes) == set(lobes) for c, lobes in zip(counts, worn, strict=True)])
        scores["windows"] = score_answers(answers.of_windows(), protocol)
    if exact is not None:
        add_share("exact_lobes", exact, every)
    if reasons is not None:
        accepted = reasons == ""
        scores |= {"reasons": reasons, "refused": float(np.mean(~accepted))}
        if accepted.any():
            add_share("accepted_accuracy", right, accepted)
    if conditions is not None:
        names = np.unique(conditions).tolist()
        scores["by_condition"] = {name: float(right[conditions == name].mean()) for name in names}
    cells = np.zeros((groups.size, classes.size, classes.size), dtype=np.int64)
    np.add.at(cells, (member, *(np.searchsorted(classes, counts) for counts in (labels, predictions))), 1)
    add_score(
        "macro_f1", lambda sums: macro_f1(sums.reshape(*sums.shape[:-1], *cells.shape[1:])),
        cells.reshape(groups.size, -1).astype(float), groups.size,
    )  # fmt: skip
    return Evaluation(
        **scores, confusion=cells.sum(axis=0), classes=classes, groups=groups, predictions=predictions,
        confusion_interval=confusion_interval(cells, drawn, protocol.confidence), labels=labels,
        group_accuracy=np.bincount(member, right) / np.bincount(member), assemblies=answers.data.groups,
        confidence=protocol.confidence, folds=answers.folds, protocol=protocol.hold_out,
    )  # fmt: skip
