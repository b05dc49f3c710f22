"""Calibration of a counter's probabilities on assemblies not seen in training."""

from __future__ import annotations

from dataclasses import MISSING, dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.base import BaseEstimator
from sklearn.utils.metadata_routing import MetadataRouter, MethodMapping
from sklearn.utils.validation import has_fit_parameter

from cyclofeat._base.sklearn_private import fit_context
from cyclofeat.counting.calibration.pooling import learn_dependence, pool_opinions, pool_weights, safe_log
from cyclofeat.counting.estimators.trees import Counter
from cyclofeat.counting.evaluation.assembly_folds import (
    assemblies_of,
    drawn_seed,
    fit_clone,
    grouped_folds,
    held_out_proba,
)
from cyclofeat.features.base import at_least, parameter
from cyclofeat.signal.windows import Float


@dataclass(eq=False, repr=False)
class GroupCalibratedCounter(Counter):
    """Counter whose probabilities are calibrated on held-out assemblies.

    The counter is fitted once per fold without the fold's assemblies, the correction is learned from its
    probabilities for them, and the counter is then fitted to all. The correction raises all probabilities to
    one power, 1/temperature, and normalises them: it never changes the predicted count.

    Parameters
    ----------
    counter : classifier
        With ``predict_proba``; cloned, not changed.
    n_splits : int, default=5
        Folds by assembly; less where a class has fewer assemblies.
    random_state : int or None, default=None
        Seed of the folds.

    Attributes
    ----------
    classes_ : ndarray, shape (n_classes,)
    counter_ : classifier
        Fitted to all windows.
    temperature_ : float
        The reciprocal of the power.
    calibrated_ : bool
        Whether there were enough assemblies to hold some out.
    dependence_ : float or None
        How much several windows of an assembly err together, from 0 (not at all) to 1 (as one window): the
        correlation at which a :class:`LobeModel` combines them. None where no assembly has several windows.

    Notes
    -----
    Probabilities below 0.001 count as 0.001, because a zero of a forest only means that no tree has seen the
    class there. Every assembly has the same weight. By Laplace's rule of succession one of n + 2 assemblies
    is assumed to be wrong. If a class has a single assembly, probabilities are not changed. Groups and other
    metadata of ``fit`` reach each step that takes them as in :func:`evaluate`.

    Examples
    --------
    >>> import numpy as np
    >>> from sklearn.ensemble import RandomForestClassifier
    >>> random = np.random.default_rng(0)
    >>> assembly = np.repeat(np.arange(60), 2)
    >>> counts = assembly % 3
    >>> X = counts[:, np.newaxis] + random.normal(scale=0.3, size=(120, 1))
    >>> forest = RandomForestClassifier(30, random_state=0)
    >>> counter = GroupCalibratedCounter(forest, random_state=0).fit(X, counts, groups=assembly)
    >>> counter.predict_proba([[0.0], [0.5], [2.0]]).round(1)
    array([[1. , 0. , 0. ],
           [0.9, 0.1, 0. ],
           [0. , 0. , 1. ]])
    """

    counter: Any = parameter(MISSING, BaseEstimator)
    n_splits: int = parameter(5, at_least(2))
    random_state: int | None = parameter(None, "random_state")

    def get_metadata_routing(self) -> MetadataRouter:
        """Return the routing of ``fit``: groups to this estimator, all metadata to the counter.

        Returns
        -------
        sklearn.utils.metadata_routing.MetadataRouter
        """
        fit_to_fit = MethodMapping().add(caller="fit", callee="fit")
        router = MetadataRouter(owner=type(self).__name__).add_self_request(self)
        return router.add(counter=self.counter, method_mapping=fit_to_fit)

    def fit(self, X: ArrayLike, y: ArrayLike, groups: ArrayLike | None = None, **metadata: ArrayLike) -> Self:
        """Fit the counter and correct its probabilities.

        Parameters
        ----------
        X : array-like, shape (n_windows, n_samples)
            Windows of torque in Nm, or features.
        y : array-like, shape (n_windows,)
            Number of worn lobes.
        groups : array-like, shape (n_windows,), optional
            Assembly of each window, without which every window counts as one.
        **metadata : array-like, shape (n_windows, ...)
            What else a step of the counter takes of each window, such as ``worn`` and ``passage``.

        Returns
        -------
        self
        """
        self._fit_cross_val_proba(X, y, groups, **metadata)
        return self

    @fit_context(prefer_skip_nested_validation=False)
    def _fit_cross_val_proba(
        self, X: ArrayLike, y: ArrayLike, groups: ArrayLike | None = None, **metadata: ArrayLike
    ) -> Float:
        """Fit; return calibrated probabilities of the windows by counters that have not seen their assembly.

        NaN without folds.
        """
        known = {name: np.asarray(values) for name, values in metadata.items() if values is not None}
        steps = [self.counter, *self.counter.get_params(deep=True).values()]
        for name in known:
            if not any(hasattr(step, "fit") and has_fit_parameter(step, name) for step in steps):
                raise TypeError(f"fit got {name}, which no step of counter={self.counter} takes")
        windows, labels, rank = self._labelled(X, y)
        member = assemblies_of(groups, len(windows))
        seed = drawn_seed(self.random_state)
        folds = grouped_folds(rank, member, self.n_splits, seed)
        known["groups"] = member
        self.counter_ = fit_clone(self.counter, windows, labels, **known)
        self.temperature_ = 1.0
        self.dependence_: float | None = None
        self.calibrated_ = bool(folds)
        held_out = held_out_proba(self.counter, windows, labels, self.classes_, folds, **known)
        if folds:
            power = pool_weights(safe_log(held_out)[np.newaxis], rank, member)[0]
            # Exponent 0: the counter is uninformative, and all classes are equally probable.
            self.temperature_ = float(1 / max(power, 1e-6))
            held_out = self._calibrate(held_out)
            self.dependence_ = learn_dependence(held_out, rank, member)
        return held_out

    def _calibrate(self, proba: Float) -> Float:
        return pool_opinions(safe_log(proba)[np.newaxis], np.array([1 / self.temperature_]))

    def _proba(self, windows: NDArray[Any]) -> Float:
        return self._calibrate(np.asarray(self.counter_.predict_proba(windows)))
