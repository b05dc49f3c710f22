"""Small network that detects worn lobes, and where the slots of a fold begin."""

from __future__ import annotations

import warnings

import numpy as np
from sklearn.exceptions import ConvergenceWarning
from sklearn.linear_model import LogisticRegression
from sklearn.neural_network import MLPClassifier
from sklearn.pipeline import Pipeline, make_pipeline
from sklearn.preprocessing import StandardScaler

from cyclofeat.counting.estimators.lobe_sets import Bool
from cyclofeat.counting.evaluation.assembly_folds import Float, Int
from cyclofeat.signal import lobes
from cyclofeat.signal.windows import Complex

# Probabilities of lobes are limited to this distance from 0 and 1.
_LEAST_LOBE = 1e-4
# Number of places within a lobe at which the first slot may begin, if there is no tachometer.
_BEGINNINGS = 8
# Windows that are tried at all these places at once, to limit the memory.
_BLOCK = 256
# Phase of the mesh line, in turns, at the passage of a worn lobe on the assumed rigs. It defines where slots
# begin in training without a tachometer.
_MESH_PHASE = 0.5
# Batch size, and least number of batches in each epoch.
_BATCH, _STEPS = 200, 48
# Class of a view that begins between two lobes (sound is 0, worn 1), and how far between.
_BETWEEN = 2
_BESIDE = (0.25, 0.75)


def views_of_lobes(lines: Complex, begins: Float, n_lobes: int, points_per_lobe: int) -> Float:
    """Return the fold rotated to each lobe: (n_windows, n_lobes, n_lobes * points_per_lobe), of unit std."""
    folded = lobes.fold(lobes.shift(lines, begins), n_lobes, 16)
    points = folded.reshape(len(lines), n_lobes, points_per_lobe, -1).mean(axis=3)
    scale = points.std(axis=(1, 2), keepdims=True)
    points = np.divide(points, scale, out=np.zeros_like(points), where=scale > 0)
    turn = (np.arange(n_lobes) + np.arange(n_lobes)[:, np.newaxis]) % n_lobes
    return np.asarray(points[:, turn].reshape(len(lines), n_lobes, -1))


def training_views(
    lines: Complex, begins: Float, worn: Bool, points_per_lobe: int, random_state: int
) -> tuple[Float, Int]:
    """Return views for training, and their classes: sound lobe, worn lobe, between two lobes."""
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
        # A fixed number of epochs: at convergence the network would overfit.
        warnings.simplefilter("ignore", ConvergenceWarning)
        return make_pipeline(StandardScaler(), network).fit(X, kind)


def lobe_logits(network: Pipeline | None, views: Float) -> tuple[Float, Float]:
    """Return the logits of lobes, (n_windows, n_lobes), and log-likelihood of their beginning, (n_windows,).

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
    """Return the logits of the lobes for the most likely beginning of the slots."""
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
