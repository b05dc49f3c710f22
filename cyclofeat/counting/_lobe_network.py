"""Small network that tells worn lobes from sound ones, and where the fold begins."""

from __future__ import annotations

import warnings

import numpy as np
from sklearn.exceptions import ConvergenceWarning
from sklearn.linear_model import LogisticRegression
from sklearn.neural_network import MLPClassifier
from sklearn.pipeline import Pipeline, make_pipeline
from sklearn.preprocessing import StandardScaler

from cyclofeat.counting._assembly_folds import Float, Int
from cyclofeat.counting._lobe_sets import Bool
from cyclofeat.signal import lobes
from cyclofeat.signal.windows import Complex

# Probabilities of lobes nearer to 0 or 1 than this are no surer than it.
_LEAST_LOBE = 1e-4
# Places within a lobe at which the first slot is tried to begin where no tachometer tells.
_BEGINNINGS = 8
# Windows tried at all those places at once, so that their views do not fill the memory.
_BLOCK = 256
# Phase of the mesh line, in turns, at the passage of a worn lobe on the assumed rigs: it settles where slots
# begin in training without a tachometer.
_MESH_PHASE = 0.5
# Examples that the network sees at once, and least number of times that it sees some in each epoch.
_BATCH, _STEPS = 200, 48
# The kind of a view begun between two lobes, beside sound (0) and worn (1) ones, and how far between.
_BETWEEN = 2
_BESIDE = (0.25, 0.75)


def views_of_lobes(lines: Complex, begins: Float, n_lobes: int, points_per_lobe: int) -> Float:
    """The fold seen from each lobe: (n_windows, n_lobes, n_lobes * points_per_lobe), of unit std."""
    folded = lobes.fold(lobes.shift(lines, begins), n_lobes, 16)
    points = folded.reshape(len(lines), n_lobes, points_per_lobe, -1).mean(axis=3)
    scale = points.std(axis=(1, 2), keepdims=True)
    points = np.divide(points, scale, out=np.zeros_like(points), where=scale > 0)
    turn = (np.arange(n_lobes) + np.arange(n_lobes)[:, np.newaxis]) % n_lobes
    return np.asarray(points[:, turn].reshape(len(lines), n_lobes, -1))


def training_views(
    lines: Complex, begins: Float, worn: Bool, points_per_lobe: int, random_state: int
) -> tuple[Float, Int]:
    """Views to train a network on, and their kinds: sound lobe, worn lobe, begun between two lobes."""
    n_lobes = worn.shape[1]
    beside = begins + np.random.default_rng(random_state).uniform(*_BESIDE, len(lines)) / n_lobes
    X = np.concatenate([views_of_lobes(lines, at, n_lobes, points_per_lobe) for at in (begins, beside)])
    kind = np.concatenate([worn.ravel().astype(int), np.full(worn.size, _BETWEEN)])
    return X.reshape(-1, X.shape[-1]), kind


def train_network(X: Float, kind: Int, n_hidden: int, n_epochs: int, random_state: int) -> Pipeline:
    """Train the network on views of shape (n_views, n_points)."""
    network = MLPClassifier(
        (n_hidden,),
        alpha=0.01,
        batch_size=int(np.clip(len(X) // _STEPS, 1, _BATCH)),
        max_iter=n_epochs,
        random_state=random_state,
    )
    with warnings.catch_warnings():
        # It learns for a set time; to converge would be to learn the noise.
        warnings.simplefilter("ignore", ConvergenceWarning)
        return make_pipeline(StandardScaler(), network).fit(X, kind)


def lobe_logits(network: Pipeline | None, views: Float) -> tuple[Float, Float]:
    """Logit of each lobe, (n_windows, n_lobes), and log-likelihood of where slots begin, (n_windows,).

    NaN without a network.
    """
    if network is None:
        return np.full(views.shape[:2], np.nan), np.full(len(views), np.nan)
    proba = network.predict_proba(views.reshape(-1, views.shape[-1]))
    sound, worn, between = (
        np.log(np.maximum(proba, _LEAST_LOBE)).reshape(*views.shape[:2], 3).transpose(2, 0, 1)
    )
    return worn - sound, np.logaddexp(sound, worn).sum(axis=1) - between.sum(axis=1)


def logits_anywhere(network: Pipeline | None, lines: Complex, n_lobes: int, points_per_lobe: int) -> Float:
    """Logits of the lobes with slots begun where they look most like slots."""
    places = np.arange(_BEGINNINGS) / (_BEGINNINGS * n_lobes)
    found = np.empty((len(lines), n_lobes))
    for k in range(0, len(lines), _BLOCK):
        block = lines[k : k + _BLOCK]
        begun = views_of_lobes(
            np.repeat(block, _BEGINNINGS, axis=0), np.tile(places, len(block)), n_lobes, points_per_lobe
        )
        logits, likelihood = lobe_logits(network, begun)
        best = likelihood.reshape(len(block), _BEGINNINGS).argmax(axis=1)
        found[k : k + _BLOCK] = logits.reshape(len(block), _BEGINNINGS, n_lobes)[np.arange(len(block)), best]
    return found


def begins_by_mesh(lines: Complex, n_lobes: int) -> Float:
    """Return where the first slot begins, as a share of the fold, by the phase of the mesh line."""
    phase = np.angle(lines[:, n_lobes - 1]) / (2 * np.pi)
    return np.asarray((_MESH_PHASE - phase) % 1.0 / n_lobes)


def platt(logits: Float, worn: Bool) -> Float:
    """Intercept and slope of the logistic regression of worn lobes on held-out logits (Platt)."""
    usable = np.isfinite(logits)
    if not usable.any() or worn[usable].min() == worn[usable].max():
        return np.array([0.0, 1.0])
    fitted = LogisticRegression(C=1e3).fit(logits[usable][:, np.newaxis], worn[usable])
    return np.array([fitted.intercept_[0], max(fitted.coef_[0, 0], 0.0)])
