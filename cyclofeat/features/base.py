"""Base class of all transformers of windows."""

from __future__ import annotations

import warnings
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import MISSING, Field, dataclass, field
from numbers import Integral, Real
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn import get_config
from sklearn.base import BaseEstimator, TransformerMixin
from sklearn.utils import check_consistent_length, column_or_1d, gen_batches
from sklearn.utils.validation import check_is_fitted, validate_data

from cyclofeat._base.sklearn_private import Interval, check_feature_names_in, fit_context
from cyclofeat.signal.windows import Float

POSITIVE = Interval(Real, 0, None, closed="neither")
# Defaults and constraints of the parameters by which transformers refine the input speed.
INPUT_SPEED_HZ = 500 / 60, POSITIVE
N_LOBES = 15, Interval(Integral, 3, None, closed="left")
SPEED_TOLERANCE = 0.015, Interval(Real, 0, 0.2, closed="left")
_MOST_REFERENCES = 8
_CHUNK_SAMPLES = 2**20  # 8 MiB of float64 samples at one time
_CHUNK_WINDOWS = 4096  # short windows have results that are larger than themselves


def parameter(default: Any, *constraints: Any) -> Any:
    """Return the dataclass field of a parameter; scikit-learn checks that a value meets one constraint."""
    return field(default=default, metadata={"constraints": list(constraints)})


class CheckedEstimator(BaseEstimator):
    """Base of estimators that are dataclasses (``eq=False, repr=False``), their fields :func:`parameter`."""

    _parameter_constraints: ClassVar[dict[str, list[Any]]] = {}

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        # A field is its default once the class is a dataclass.
        own = {name: x.metadata["constraints"] for name, x in vars(cls).items() if isinstance(x, Field)}
        cls._parameter_constraints = cls._parameter_constraints | own


def at_least(least: int) -> Interval:
    """Return the constraint of whole numbers from a least one on."""
    return Interval(Integral, least, None, closed="left")


class ShortWindowWarning(UserWarning, ValueError):
    """Warning that windows hold fewer samples than a method needs; an error where counters are trained."""


@contextmanager
def reject_short_windows() -> Iterator[None]:
    """Raise :class:`ShortWindowWarning` as an error."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", ShortWindowWarning)
        yield


def check_reach(transformer: Any, highest: float, what: str, verb: str, advice: str) -> None:
    """Raise ValueError if what a transformer needs reaches beyond half of the sampling rate."""
    if highest > transformer.sampling_rate / 2:
        raise ValueError(
            f"sampling_rate={transformer.sampling_rate:g} holds frequencies up to "
            f"{transformer.sampling_rate / 2:g}, but {what} at "
            f"input_speed_hz={transformer.input_speed_hz:g} {verb} {highest:g}: {advice}"
        )


def half_output_turn(sampling_rate: float, input_speed_hz: float, n_lobes: int) -> tuple[int, str]:
    """Return the samples of half an output turn, without which no lobe differs from run-out, in words too."""
    return int(sampling_rate * n_lobes / input_speed_hz / 2), "half an output turn"


def reference_windows(
    X: NDArray[Any], y: ArrayLike | None, label: Any, by_default: tuple[str, int]
) -> tuple[NDArray[Any], Any]:
    """Return up to 8 windows of a class, evenly spread over its windows, and its label.

    ``by_default`` is the label that stands for another where no window has it, and the place of that one in
    sorted order. Without labels in ``y`` it stands for all windows; the label returned is then None.
    """
    name, place = by_default
    rows = np.arange(len(X))
    if y is not None:
        labels = column_or_1d(y)
        check_consistent_length(rows, labels)
        classes = np.unique(labels).tolist()
        if label == name and name not in classes:
            label = classes[place]
        if label not in classes:
            known = ", ".join(map(repr, classes))
            raise ValueError(f"reference must be {name!r} or a label in y ({known}), got {label!r}")
        rows = np.flatnonzero(labels == label)
    elif label != name:
        raise ValueError(f"reference={label!r} is a label of y, but fit was given no y")
    spread = np.linspace(0, rows.size - 1, min(rows.size, _MOST_REFERENCES))
    return X[rows[np.rint(spread).astype(int)]], None if y is None else label


@dataclass(eq=False, repr=False)
class WindowTransformer(TransformerMixin, CheckedEstimator, ABC):
    """Base of the transformers that turn each window into one row of features.

    A subclass implements ``_feature_names`` and ``_compute_features``. One that learns from
    training windows, or whose parameters must fit the windows, implements ``_fit_windows``. One whose method
    needs windows of some length states it in ``_shortest_window``. Windows are processed in chunks: spectra
    never fill the memory.
    """

    sampling_rate: float = parameter(MISSING, POSITIVE)

    def needed_samples(self) -> int:
        """Return the fewest samples of a window from which the features mean something."""
        return self._shortest_window()[0]

    def _shortest_window(self) -> tuple[int, str]:
        """Return ``needed_samples()``, and in words what these hold."""
        return 2, "two samples"

    def _warn_of_short_windows(self, X: NDArray[Any]) -> None:
        (n_windows, n_samples), (needed, what) = X.shape, self._shortest_window()
        if n_samples < needed:
            turned = f"; is X, of shape {X.shape}, transposed?" if n_windows > n_samples else ""
            warnings.warn(
                f"{type(self).__name__} needs windows of at least {needed} samples ({what}), got "
                f"{n_samples}: its features mean little{turned}",
                ShortWindowWarning,
                stacklevel=1,  # from one place, so that fit_transform shows it once
            )

    def _fit_windows(self, X: NDArray[Any], y: ArrayLike | None) -> None:
        """Check parameters against validated windows and learn state; ``y`` is as given."""

    @abstractmethod
    def _feature_names(self) -> list[str]:
        """Names of the features; called on a fitted transformer."""

    @abstractmethod
    def _compute_features(self, X: NDArray[Any]) -> Float:
        """Features, shape (n_windows, n_features), of a chunk of validated windows; must not write to X."""

    def _of_chunks(self, chunks: Iterable[NDArray[Any]]) -> list[Float]:
        """Features of chunks of windows, in their order."""
        return [self._compute_features(chunk) for chunk in chunks]

    @fit_context(prefer_skip_nested_validation=True)
    def fit(self, X: ArrayLike, y: ArrayLike | None = None) -> Self:
        """Check the parameters against windows of torque in Nm, shape (n_windows, n_samples), and learn.

        Labels ``y``, shape (n_windows,), are ignored by transformers that learn nothing. Windows with fewer
        than :meth:`needed_samples` give a warning, here and in :meth:`transform`.
        """
        windows = validate_data(self, X, dtype=[np.float64, np.float32])
        self._fit_windows(windows, y)
        self._warn_of_short_windows(windows)
        return self

    def transform(self, X: ArrayLike) -> Float:
        """Return the features of windows of torque in Nm, which are as long as those given to ``fit``.

        They are float64, shape (n_windows, n_features), in the order of ``get_feature_names_out``, or a data
        frame after ``set_output``.
        """
        check_is_fitted(self)
        windows = validate_data(self, X, reset=False, dtype=[np.float64, np.float32])
        self._warn_of_short_windows(windows)
        n_windows, n_samples = windows.shape
        samples = min(_CHUNK_SAMPLES, int(get_config()["working_memory"] * 2**17))
        parts = gen_batches(n_windows, min(max(samples // n_samples, 1), _CHUNK_WINDOWS))
        # C order: sums over columns-first arrays round differently.
        chunks = (np.ascontiguousarray(windows[part]) for part in parts)
        return np.concatenate(self._of_chunks(chunks))

    def get_feature_names_out(self, input_features: ArrayLike | None = None) -> NDArray[np.object_]:
        """Return the names of the features, shape (n_features,).

        ``input_features``, the names of a window's samples, are checked against those seen in ``fit``.
        """
        check_is_fitted(self)
        check_feature_names_in(self, input_features, generate_names=False)
        return np.asarray(self._feature_names(), dtype=object)
