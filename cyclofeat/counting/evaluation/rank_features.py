"""Table of features by how they depend on the number of worn lobes."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats
from sklearn.base import clone
from sklearn.feature_selection import mutual_info_classif
from sklearn.utils import check_array, check_consistent_length
from threadpoolctl import threadpool_limits

from cyclofeat._base.displays import data_frame
from cyclofeat.counting.evaluation.assembly_folds import (
    assemblies_of,
    grouped_folds,
    of_windows,
    ordered_classes,
)
from cyclofeat.counting.evaluation.scores import bootstrap_weights
from cyclofeat.features.base import reject_short_windows
from cyclofeat.signal.windows import Float, Int

if TYPE_CHECKING:
    import pandas as pd


def rank_features(
    X: ArrayLike,
    y: ArrayLike,
    groups: ArrayLike,
    *,
    confidence: float = 0.95,
    random_state: int | None = None,
) -> pd.DataFrame:
    """Rank features by how gradually they depend on the number of worn lobes.

    Windows of one assembly are not independent: all numbers are of the mean of each feature over the windows
    of an assembly, and intervals are those of a bootstrap over assemblies. Give features that learn from
    training windows, such as :class:`~cyclofeat.features.CoherenceToReference`, of windows held out.

    Parameters
    ----------
    X : array-like or data frame, shape (n_windows, n_features)
        Features, with their names if it is a data frame.
    y : array-like of int, shape (n_windows,)
        Number of worn lobes.
    groups : array-like, shape (n_windows,)
        Assembly of each window, with one count.
    confidence : float, default=0.95
        Coverage of the intervals.
    random_state : int, optional
        Seed of the bootstrap and of the mutual information.

    Returns
    -------
    pandas.DataFrame, shape (n_features, 11)
        By feature, the most gradual first, that is, by the end of its trend's interval nearest to 0:
        ``trend``, trendability, Spearman's rank correlation with the count, from -1 to 1;
        ``monotonicity``, steps of the class means upwards less steps downwards, over all steps, from -1 to 1;
        ``_low`` and ``_high``, the ends of their intervals; ``mutual_information`` with the count, in bits,
        by nearest neighbours; ``anova_f`` and ``anova_p``, one-way analysis of variance; ``kruskal_h`` and
        ``kruskal_p``, Kruskal and Wallis's test by ranks. Both p-values are adjusted for the number of
        features (Benjamini and Hochberg). They tell whether counts differ, in any order.

    Raises
    ------
    ValueError
        If there are fewer than two counts, a count has fewer than two assemblies, an assembly has several
        counts, or values are not finite.

    Examples
    --------
    >>> import pandas as pd
    >>> from cyclofeat.counting import rank_features
    >>> count, noise = np.repeat([0, 1, 2], 8), np.random.default_rng(0).normal(size=24)
    >>> features = pd.DataFrame({"gradual": count + 0.1 * noise, "noise": noise})
    >>> table = rank_features(features, count, np.arange(24) // 2, random_state=0)
    >>> table[["trend", "monotonicity"]].round(2).loc["gradual"].tolist()
    [0.95, 1.0]
    """
    if not 0 < confidence < 1:
        raise ValueError(f"confidence must lie between 0 and 1, got {confidence!r}")
    values = check_array(X, dtype=np.float64, input_name="X")
    names = [str(name) for name in getattr(X, "columns", range(values.shape[1]))]
    check_consistent_length(values, y)
    classes, rank = ordered_classes(of_windows("y", y, len(values)))
    assemblies, member = np.unique(of_windows("groups", groups, len(values)), return_inverse=True)
    count: Int = np.zeros(assemblies.size, dtype=np.int64)
    count[member] = rank
    if (count[member] != rank).any():
        raise ValueError(f"assembly {assemblies[member[count[member] != rank][0]]} has several counts in y")
    if (fewest := np.bincount(count)).min() < 2:
        raise ValueError(f"count {classes[fewest.argmin()]} must have at least two assemblies, got one")
    means = np.zeros((assemblies.size, values.shape[1]))
    np.add.at(means, member, values)
    means /= np.bincount(member)[:, np.newaxis]
    freedom = classes.size - 1, assemblies.size - classes.size
    share = _share_between(means, count)
    f = share / np.maximum(1 - share, 1e-12) * freedom[1] / freedom[0]
    h = (assemblies.size - 1) * _share_between(stats.rankdata(means, axis=0), count)
    columns: dict[str, Any] = {"feature": names}
    weights = bootstrap_weights(assemblies.size, random_state).astype(float)
    tail = 50 * (1 - confidence)
    for name, score in (("trend", _rank_correlations), ("monotonicity", _monotonicities)):
        low, high = np.nanpercentile(score(means, count, weights), [tail, 100 - tail], axis=0)
        columns[name] = score(means, count, np.ones((1, assemblies.size)))[0]
        columns |= {f"{name}_low": low, f"{name}_high": high}
    fewest_neighbours = min(3, int(fewest.min()) - 1)
    with threadpool_limits(1):  # threads wait for each other longer than so few rows take
        information = mutual_info_classif(
            means, count, n_neighbors=fewest_neighbours, random_state=random_state
        )
    columns["mutual_information"] = information / np.log(2)
    for name, value, p in (
        ("anova_f", f, stats.f.sf(f, *freedom)),
        ("kruskal_h", h, stats.chi2.sf(h, freedom[0])),
    ):
        columns |= {name: value, f"{name[:-2]}_p": stats.false_discovery_control(p)}
    sure = np.where(columns["trend"] > 0, columns["trend_low"], -columns["trend_high"])
    table: pd.DataFrame = data_frame(columns).set_index("feature")
    return table.iloc[np.argsort(-sure, kind="stable")]


def features_held_out(
    transformer: Any, X: Float, y: Int, groups: NDArray[Any], *, random_state: int | None = None
) -> pd.DataFrame:
    """Return features by a transformer that has not learned from their assemblies, if counts have several."""
    rank = np.unique(y, return_inverse=True)[1]
    folds = grouped_folds(rank, assemblies_of(groups, len(y)), 5, random_state)
    folds = folds or [(np.arange(len(y)),) * 2]
    parts = []
    with reject_short_windows():
        for train, test in folds:
            fitted = clone(transformer).fit(X[train], y[train])
            parts.append(fitted.transform(X[test]))
    rows = np.concatenate(parts)[np.argsort(np.concatenate([test for _, test in folds]))]
    return data_frame(dict(zip(fitted.get_feature_names_out(), rows.T, strict=True)))


def _share_between(values: Float, count: Int) -> Float:
    """Return the share of the sum of squares that lies between counts; 0 for constant columns."""
    deviation = values - values.mean(axis=0)
    of_class = [(count == k).sum() * deviation[count == k].mean(axis=0) ** 2 for k in np.unique(count)]
    total = (deviation**2).sum(axis=0)
    least = values.size * (np.finfo(float).eps * np.abs(values).max(axis=0)) ** 2
    return np.asarray(np.divide(sum(of_class), total, out=np.zeros_like(total), where=total > least))


def _rank_correlations(means: Float, count: Int, weights: Float) -> Float:
    """Return Spearman's correlation with the count, shape (n_draws, n_features), 0 for constant features."""
    ranks, of_count = stats.rankdata(means, axis=0), stats.rankdata(count)
    ranks, of_count = ranks - ranks.mean(axis=0), of_count - of_count.mean()
    n = weights.sum(axis=1, keepdims=True)
    mean, mean_count = weights @ ranks / n, weights @ of_count[:, np.newaxis] / n
    covariance = (weights * of_count) @ ranks / n - mean * mean_count
    spread = weights @ ranks**2 / n - mean**2
    spread_count = weights @ of_count[:, np.newaxis] ** 2 / n - mean_count**2
    scale: NDArray[Any] = np.sqrt(np.maximum(spread * spread_count, 0))
    return np.asarray(np.divide(covariance, scale, out=np.zeros_like(covariance), where=scale > 1e-9))


def _monotonicities(means: Float, count: Int, weights: Float) -> Float:
    """Return up less down steps of the class means, over all steps; classes missing in a draw are skipped."""
    of_class = np.stack([weights * (count == k) for k in range(int(count.max()) + 1)], axis=1)
    n = of_class.sum(axis=2, keepdims=True)
    course = np.divide(of_class @ means, n, out=np.full((*n.shape[:2], means.shape[1]), np.nan), where=n > 0)
    steps = np.sign(np.diff(course, axis=1))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a draw without neighbouring classes
        return np.asarray(np.nanmean(steps, axis=1))
