"""Classifier learned from a table of effects: probabilities, look-alikes, and how typical a case is."""

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

_TIE = 0.2  # symmetric share of confusion from which two effects count as look-alikes
# Always tied: at one speed, load and direction they differ by less than a slightly wrong stiffness does, or
# not at all.
_TIED = (("gain", "offset"), ("load_drift", "sensor_drift"))
_COMPONENTS = 12  # of the Gaussians
_N_TREES = 400
FOLDS = 5
_SETS_PER_DRAW = 6
_FEWEST_SETS = 30  # from which an effect is learned
_NULL_SETS = 1000  # without effect, for the threshold of what is found
_SMALLEST = 0.05  # a cell's spread is at least this, in its unit


class Scale:
    """Deviations in standard errors, cell by cell and uncorrelated, on a logarithmic scale with sign."""

    def __init__(self, null: Float) -> None:
        self.spread = np.sqrt(null.var(axis=0, ddof=1) + _SMALLEST**2)
        self._uncorrelating = uncorrelating(null / self.spread)

    def features(self, mean: Float, variance: Float, n: int) -> Float:
        """Features of sets of n recordings from their means and variances, each (..., n_cells)."""
        ratio = np.log((variance + _SMALLEST**2) / self.spread**2)
        # Normal recordings: the logarithm of their variance spreads by sqrt(2 / (n - 1)).
        of_spreads = signed_log(ratio * np.sqrt((n - 1) / 2))
        return np.concatenate([self.of_means(mean, n), of_spreads], axis=-1)

    def of_means(self, mean: Float, n: int) -> Float:
        """Part of the features that comes from the means."""
        alone = mean / self.spread * np.sqrt(n)
        return np.concatenate([signed_log(alone), signed_log(alone @ self._uncorrelating)], axis=-1)


class Learned:
    """Classifier of effects for comparisons of one number of recordings.

    ``confusion`` (n_effects, n_effects) holds shares of out-of-fold names by true effect, ``temperature`` the
    power by which the forest's votes are sharpened to probabilities, ``detectable`` the share of the sets of
    each effect that would be detected. Effects of a group in ``tie_groups`` are confused in more than a fifth
    of the cases, or always tied.
    """

    def __init__(self, table: EffectTable, n: int, alpha: float, random_state: int, n_jobs: int) -> None:
        random = np.random.default_rng([random_state, n])
        null = table.null_deviations()
        self.names = table.names
        self.scale = Scale(null)
        of_null = null[random.integers(len(null), size=(_NULL_SETS, n))]
        # What sets without effect exceed with a share alpha.
        threshold = np.quantile(self._largest(of_null.mean(axis=1), n), 1 - alpha)
        features, labels, draws = [], [], []
        self.detectable: dict[str, float] = {}
        for k, name in enumerate(table.names):
            means, variances, of_draw = _sets(table, null, name, n, random)
            size = self._largest(means, n)
            found = size > threshold
            self.detectable[name] = float(found.mean())
            # An effect that is never found is learned from its strongest sets, so that it can be named.
            if found.sum() < _FEWEST_SETS:
                found = size >= np.sort(size)[-min(_FEWEST_SETS, size.size)]
            features.append(self.scale.features(means[found], variances[found], n))
            labels.append(np.full(found.sum(), k))
            draws.append(of_draw[found] + k * len(table.used))
        X, y, groups = np.vstack(features), np.concatenate(labels), np.concatenate(draws)
        # As if every effect came equally often, for any share of its draws that can be found.
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
        """Other effects of the group of ties."""
        group = next((group for group in self.tie_groups if name in group), (name,))
        return tuple(other for other in group if other != name)

    def _largest(self, means: Float, n: int) -> Float:
        """Largest deviation of each set of n recordings, in standard errors."""
        return np.asarray(np.abs(means / self.scale.spread).max(axis=1) * np.sqrt(n))


def _sets(
    table: EffectTable, null: Float, name: str, n: int, random: np.random.Generator
) -> tuple[Float, Float, NDArray[np.intp]]:
    """Means and variances of sets of n recordings with an effect, and the draw of each set.

    Each draw with at least two simulated recordings has _SETS_PER_DRAW.
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
    """Measure of how typical features are of each class: a Gaussian per class on the leading components.

    The conformal p of a class is the share of its own cases that are no more typical, each judged like the
    new one by the Gaussian that was made without it (cross-conformal, Vovk 2015).
    """

    def __init__(
        self,
        features: Float,
        labels: NDArray[np.intp],
        folds: Iterable[tuple[NDArray[np.intp], NDArray[np.intp]]],
    ) -> None:
        # Per fold: components and Gaussians, and how far the cases of each class lie that they have not seen.
        # Components too are made without them: those that a sample spreads along most flatter it.
        self.folds: list[tuple[PCA, list[tuple[LedoitWolf, Float]]]] = []
        for train, test in folds:
            # The default for tables of this size draws random numbers.
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
