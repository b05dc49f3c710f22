"""Is this lobe worn? A small network on the fold seen from each lobe, and where the fold begins."""

from __future__ import annotations

import warnings

import numpy as np
from scipy.special import logit
from sklearn.exceptions import ConvergenceWarning
from sklearn.linear_model import LogisticRegression
from sklearn.neural_network import MLPClassifier
from sklearn.pipeline import Pipeline, make_pipeline
from sklearn.preprocessing import StandardScaler

from cyclofeat import lobes
from cyclofeat.counting._folds import Float
from cyclofeat.counting._lobe_sets import Bool

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
# Logits beyond this make an answer no more decided.
_DECIDED = 6.0


def views_of_lobes(lines: lobes.Complex, begins: Float, n_lobes: int, points_per_lobe: int) -> Float:
    """The fold seen from each lobe: (n_windows, n_lobes, n_lobes * points_per_lobe), of unit std."""
    folded = lobes.fold(lobes.shift(lines, begins), n_lobes, 16)
    points = folded.reshape(len(lines), n_lobes, points_per_lobe, -1).mean(axis=3)
    scale = points.std(axis=(1, 2), keepdims=True)
    points = np.divide(points, scale, out=np.zeros_like(points), where=scale > 0)
    turn = (np.arange(n_lobes) + np.arange(n_lobes)[:, np.newaxis]) % n_lobes
    return np.asarray(points[:, turn].reshape(len(lines), n_lobes, -1))


def train_network(views: Float, worn: Bool, n_hidden: int, n_epochs: int, seed: int) -> Pipeline | None:
    """Network that tells a worn lobe from a sound one; None where there is one kind only."""
    X, target = views.reshape(-1, views.shape[-1]), worn.ravel()
    if target.min() == target.max():
        return None
    network = MLPClassifier(
        (n_hidden,),
        alpha=0.01,
        batch_size=int(np.clip(len(X) // _STEPS, 1, _BATCH)),
        max_iter=n_epochs,
        random_state=seed,
    )
    with warnings.catch_warnings():
        # It learns for a set time; to converge would be to learn the noise.
        warnings.simplefilter("ignore", ConvergenceWarning)
        return make_pipeline(StandardScaler(), network).fit(X, target)


def lobe_logits(network: Pipeline | None, views: Float) -> Float:
    """Logit of each lobe, shape (n_windows, n_lobes); NaN without a network."""
    if network is None:
        return np.full(views.shape[:2], np.nan)
    proba = network.predict_proba(views.reshape(-1, views.shape[-1]))[:, 1].reshape(views.shape[:2])
    return np.asarray(logit(np.clip(proba, _LEAST_LOBE, 1 - _LEAST_LOBE)))


def most_decided(network: Pipeline | None, lines: lobes.Complex, n_lobes: int, points_per_lobe: int) -> Float:
    """Logits of the lobes with slots begun where they are most decided."""
    places = np.arange(_BEGINNINGS) / (_BEGINNINGS * n_lobes)
    decided = np.empty((len(lines), n_lobes))
    for k in range(0, len(lines), _BLOCK):
        block = lines[k : k + _BLOCK]
        begun = views_of_lobes(
            np.repeat(block, _BEGINNINGS, axis=0), np.tile(places, len(block)), n_lobes, points_per_lobe
        )
        logits = lobe_logits(network, begun).reshape(len(block), _BEGINNINGS, n_lobes)
        chosen = np.abs(np.clip(logits, -_DECIDED, _DECIDED)).sum(axis=2).argmax(axis=1)
        decided[k : k + _BLOCK] = logits[np.arange(len(block)), chosen]
    return decided


def begins_by_mesh(lines: lobes.Complex, n_lobes: int) -> Float:
    """Where the first slot begins in the window, as a share of the fold, by the mesh line's phase."""
    phase = np.angle(lines[:, n_lobes - 1]) / (2 * np.pi)
    return np.asarray((_MESH_PHASE - phase) % 1.0 / n_lobes)


def platt(logits: Float, worn: Bool) -> Float:
    """Intercept and slope of the logistic regression of worn lobes on held-out logits (Platt)."""
    usable = np.isfinite(logits)
    if not usable.any() or worn[usable].min() == worn[usable].max():
        return np.array([0.0, 1.0])
    fitted = LogisticRegression(C=1e3).fit(logits[usable][:, np.newaxis], worn[usable])
    return np.array([fitted.intercept_[0], max(fitted.coef_[0, 0], 0.0)])
