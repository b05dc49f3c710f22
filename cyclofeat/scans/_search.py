"""Parts of both searches: options, classes of assemblies, and permutations."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import KW_ONLY, dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.utils import check_consistent_length, column_or_1d

from cyclofeat._base.checks import n_jobs, whole
from cyclofeat.signal.windows import Float

NO_GROUPS = (
    "groups must name the assembly of every window, got None: windows of one recording look alike for "
    "reasons that have nothing to do with wear, so without groups neither separability nor chance can be "
    "told. Pass the groups that Windower.transform returns"
)


@dataclass(frozen=True)
class Search:
    """Permutations, processes and progress of a search.

    Parameters
    ----------
    n_permutations : int, default=1000
        Number of permutations of the counts among assemblies, for p-values; 0 for none.
    random_state : int, default=0
        Seed of the permutations.
    n_jobs : int, default=1
        Number of processes of :func:`scan_wavelets`; -1 for all processors.
    progress : callable, optional
        Called by :func:`scan_wavelets` after each wavelet with the number done and their total.

    Raises
    ------
    TypeError, ValueError
        If a number is not whole, or out of its range.
    """

    n_permutations: int = 1000
    _: KW_ONLY
    random_state: int = 0
    n_jobs: int = 1
    progress: Callable[[int, int], object] | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        whole("n_permutations", self.n_permutations, least=0)
        whole("random_state", self.random_state, least=0)
        n_jobs(self.n_jobs)


def defect_counts(X: NDArray[Any], y: ArrayLike) -> tuple[Float, NDArray[np.intp]]:
    """Return the counts, increasing, and for each window the index of its count."""
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
    """Return the assembly of each window and the class of each assembly, both as indices."""
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


def permuted_means(units: Float, labels: NDArray[np.intp], search: Search) -> Iterator[Float]:
    """Class means with the labels permuted among the rows, once for each permutation of the search."""
    rng = np.random.default_rng(search.random_state)
    for _ in range(search.n_permutations):
        yield class_means(units, rng.permutation(labels))
