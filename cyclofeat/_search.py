"""What searches over many definitions share: classes of assemblies, and chance by permutation."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.utils import check_consistent_length, column_or_1d

Float = NDArray[np.float64]
NO_GROUPS = (
    "groups must name the assembly of every window, got None: windows of one recording look alike for "
    "reasons that have nothing to do with wear, so without groups neither separability nor chance can be "
    "told. Pass the groups that Windower.transform returns"
)


def defect_counts(X: NDArray[Any], y: ArrayLike) -> tuple[Float, NDArray[np.intp]]:
    """Counts, increasing, and for each window which of them it has."""
    try:
        y = np.asarray(column_or_1d(y), dtype=np.float64)
    except (TypeError, ValueError):
        raise ValueError(f"y must hold one defect count per window, as a number, got {y!r:.60}") from None
    check_consistent_length(X, y)
    counts, labels = np.unique(y, return_inverse=True)
    if len(counts) < 2 or not np.isfinite(counts).all():
        raise ValueError(f"y must hold at least two defect counts, finite, got {counts.tolist()}")
    return counts, labels


def assemblies(
    X: NDArray[Any], groups: ArrayLike, labels: NDArray[np.intp]
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Assembly of each window, and class of each assembly, both as indices."""
    given = column_or_1d(groups)
    check_consistent_length(X, given)
    names, assembly = np.unique(given, return_inverse=True)
    of_assembly = np.empty(len(names), dtype=np.intp)
    of_assembly[assembly] = labels
    mixed = np.flatnonzero(of_assembly[assembly] != labels)
    if mixed.size:
        raise ValueError(
            f"groups must name assemblies with one defect count each, but {given[mixed[0]]!r} has windows "
            "of two counts"
        )
    return assembly, of_assembly


def class_means(values: Float, labels: NDArray[np.intp]) -> Float:
    """Mean of the rows of each label 0, 1, ..."""
    numbers = np.bincount(labels)
    sums = np.zeros((len(numbers), values.shape[1]))
    np.add.at(sums, labels, values)
    return sums / numbers[:, np.newaxis]


def permuted_means(
    units: Float, labels: NDArray[np.intp], n_permutations: int, random_state: int
) -> Iterator[Float]:
    """Class means with the labels permuted among the rows, again and again."""
    rng = np.random.default_rng(random_state)
    for _ in range(n_permutations):
        yield class_means(units, rng.permutation(labels))
