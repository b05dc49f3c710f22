"""Classifier of effects, trained on their table: probabilities, look-alikes, and conformal p."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar
from scipy.sparse.csgraph import connected_components
from sklearn.covariance import LedoitWolf
from sklearn.decomposition import PCA
from sklearn.ensemble import ExtraTreesClassifier
from sklearn.model_selection import StratifiedGroupKFold, cross_val_predict

from cyclofeat.gap.summaries import signed_log, uncorrelating
from cyclofeat.gap.what._table import EffectTable

Float = NDArray[np.float64]

_TIE = 0.2  # mean confusion of two effects from which they count as look-alikes
# Always tied: at one speed, load and direction they differ less than two models with slightly different
# stiffness, or not at all.
_TIED = (("gain", "offset"), ("load_drift", "sensor_drift"))
_COMPONENTS = 12  # principal components for the Gaussians
_N_TREES = 400
FOLDS = 5
_SETS_PER_DRAW = 6
_FEWEST_SETS = 30  # detectable sets with which an effect is learned
_NULL_SETS = 1000  # sets without effect, for the threshold of detection
_SMALLEST = 0.05  # added in quadrature to the spread of a cell, in its unit


class Scale:
    """Conversion of deviations to features: standard errors, plain and decorrelated, on a log scale."""

    def __init__(self, null: Float) -> None:
        self.spread = np.sqrt(null.var(axis=0, ddof=1) + _SMALLEST**2)
        self._uncorrelating = uncorrelating(null / self.spread)

    def features(self, mean: Float, variance: Float, n: int) -> Float:
        """Features of sets of n recordings from their means and variances, each (..., n_cells)."""
        ratio = np.log((variance + _SMALLEST**2) / self.spread**2)
        # The logarithm of the variance of n normal values has a standard deviation of sqrt(2 / (n - 1)).
        of_spreads = signed_log(ratio * np.sqrt((n - 1) / 2))
        return np.concatenate([self.of_means(mean, n), of_spreads], axis=-1)

    def of_means(self, mean: Float, n: int) -> Float:
        """Features of the means alone."""
        alone = mean / self.spread * np.sqrt(n)
        return np.concatenate([signed_log(alone), signed_log(alone @ self._uncorrelating)], axis=-1)


class Learned:
    """Classifier of effects for comparisons with n recordings.

    ``confusion`` (n_effects, n_effects) holds, by true effect, the shares of the effects named out of fold.
    ``temperature`` sharpens the forest's votes to probabilities. ``detectable`` is the share of each effect's
    sets that would be detected. Effects in one group of ``tie_groups`` are confused in more than a fifth of
    the cases, or always tied.
    """

    def __init__(self, table: EffectTable, n: int, alpha: float, random_state: int, n_jobs: int) -> None:
        random = np.random.default_rng([random_state, n])
        null = table.null_deviations()
        self.names = table.names
        self.scale = Scale(null)
        of_null = null[random.integers(len(null), size=(_NULL_SETS, n))]
        # A share alpha of the sets without effect exceeds it.
        threshold = np.quantile(self._largest(of_null.mean(axis=1), n), 1 - alpha)
        features, labels, draws = [], [], []
        self.detectable: dict[str, float] = {}
        for k, name in enumerate(table.names):
            means, variances, of_draw = _sets(table, null, name, n, random)
            size = self._largest(means, n)
            found = size > threshold
            self.detectable[name] = float(found.mean())
            # An effect that is hardly ever detected is learned from its strongest sets.
            if found.sum() < _FEWEST_SETS:
                found = size >= np.sort(size)[-min(_FEWEST_SETS, size.size)]
            features.append(self.scale.features(means[found], variances[found], n))
            labels.append(np.full(found.sum(), k))
            draws.append(of_draw[found] + k * len(table.used))
        X, y, groups = np.vstack(features), np.concatenate(labels), np.concatenate(draws)
        # Balanced: equal prior probability of all effects, whatever share of their sets is detectable.
        forest = ExtraTreesClassifier(
            _N_TREES, min_samples_leaf=2, class_weight="balanced", random_state=random_state, n_jobs=n_jobs
        )
        folds = list(StratifiedGroupKFold(FOLDS, shuffle=True, random_state=random_state).split(X, y, groups))
        votes = cross_val_predict(forest, X, y, cv=folds, method="predict_proba")
        self.temperature = _temperature(votes, y)
        self.forest = forest.fit(X, y)
        self.confusion = np.zeros((len(table.names), len(table.names)))
        np.add.at(self.confusion, (y, votes.argmax(axis=1)), 1.0)
        self.confusion /= self.confusion.sum(axis=1, keepdims=True)
        self.tie_groups = _ties(self.confusion, list(table.names))
        self.typical = Typical(X, y, folds)

    def look_alikes(self, name: str) -> tuple[str, ...]:
        """Other effects in the tie group of an effect."""
        group = next((group for group in self.tie_groups if name in group), (name,))
        return tuple(other for other in group if other != name)

    def _largest(self, means: Float, n: int) -> Float:
        """Largest deviation over the cells of each set of n recordings, in standard errors."""
        return np.asarray(np.abs(means / self.scale.spread).max(axis=1) * np.sqrt(n))


def _sets(
    table: EffectTable, null: Float, name: str, n: int, random: np.random.Generator
) -> tuple[Float, Float, NDArray[np.intp]]:
    """Means and variances of sets of n recordings with an effect, and the draw of each set.

    Each draw with at least two simulated recordings gives _SETS_PER_DRAW sets.
    """
    means, variances, draws = [], [], []
    for k, (values, used) in enumerate(zip(table.deviations(name), table.used, strict=True)):
        usable = np.isfinite(values[:, 0])
        if usable.sum() < 2:
            continue
        values, used = values[usable], used[usable]
        shift = (values - null[used]).mean(axis=0)
        residuals = (values - values.mean(axis=0)) * np.sqrt(len(values) / (len(values) - 1))
        drawn = residuals[random.integers(len(values), size=(_SETS_PER_DRAW, n))]
        means.append(shift + drawn.mean(axis=1))
        variances.append(drawn.var(axis=1, ddof=1))
        draws.append(np.full(_SETS_PER_DRAW, k))
    return np.vstack(means), np.vstack(variances), np.concatenate(draws)


class Typical:
    """Cross-conformal p of each class (Vovk 2015), from a Gaussian per class on the leading components.

    The p of a class is the share of its training cases that are at least as far from the Gaussian as the new
    case. Each training case is measured with the Gaussian of a fold that does not contain it.
    """

    def __init__(
        self,
        features: Float,
        labels: NDArray[np.intp],
        folds: Iterable[tuple[NDArray[np.intp], NDArray[np.intp]]],
    ) -> None:
        # Per fold: components, Gaussians, and the distances of the held-out cases of each class. The
        # components must not see these cases either, or their distances would be too small.
        self.folds: list[tuple[PCA, list[tuple[LedoitWolf, Float]]]] = []
        for train, test in folds:
            # The default solver for tables of this size is randomised.
            components = PCA(min(_COMPONENTS, features.shape[1]), svd_solver="full").fit(features[train])
            known, left_out = (components.transform(features[part]) for part in (train, test))
            of_class = []
            for k in np.unique(labels):
                gaussian = LedoitWolf().fit(known[labels[train] == k])
                of_class.append((gaussian, gaussian.mahalanobis(left_out[labels[test] == k])))
            self.folds.append((components, of_class))

    def conformal_p(self, features: Float) -> Float:
        """p of each class, shape (n, n_classes)."""
        farther: Float | float = 0.0
        total = np.zeros(len(self.folds[0][1]))
        for components, of_class in self.folds:
            points = components.transform(features)
            farther = farther + np.column_stack(
                [
                    np.sum(own[None] >= gaussian.mahalanobis(points)[:, None], axis=1)
                    for gaussian, own in of_class
                ]
            )
            total += [own.size for _, own in of_class]
        return np.asarray((farther + 1) / (total + 1))


def sharpened(votes: Float, temperature: float) -> Float:
    logits = np.log(np.maximum(votes, 1e-4)) / temperature
    powers = np.exp(logits - logits.max(axis=1, keepdims=True))
    return np.asarray(powers / powers.sum(axis=1, keepdims=True))


def _temperature(votes: Float, labels: NDArray[np.intp]) -> float:
    """Temperature of the smallest out-of-fold log loss."""

    def loss(log_temperature: float) -> float:
        sharp = sharpened(votes, float(np.exp(log_temperature)))
        return float(-np.mean(np.log(np.maximum(sharp[np.arange(len(labels)), labels], 1e-12))))

    return float(np.exp(minimize_scalar(loss, bounds=(-3.0, 2.0), method="bounded").x))


def _ties(confusion: Float, names: list[str]) -> list[tuple[str, ...]]:
    symmetric = (confusion + confusion.T) / 2
    np.fill_diagonal(symmetric, 0.0)
    tied = symmetric > _TIE
    for pair in _TIED:
        if set(pair) <= set(names):
            tied[names.index(pair[0]), names.index(pair[1])] = True
    _, of = connected_components(tied, directed=False)
    groups = [tuple(np.array(names)[of == k].tolist()) for k in np.unique(of)]
    return [group for group in groups if len(group) > 1]
