"""The network: from recordings in any number and order to presence and size of each effect.

Each recording passes a small network; mean and maximum over the recordings, together with mean, spread and
extremes of their deviations themselves, pass a second one (a Deep Set; Zaheer et al. 2017, "Deep Sets",
NIPS). It is written for any array library: JAX trains it and numpy answers.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cyclofeat._base.training import first_weights

Array = Any  # of numpy or JAX
Weights = Mapping[str, Array]

_RECORDING, _SESSION = (192, 192), 512  # widths
_FAR = 1e3
_LIMIT = 8.0  # of standardised pools
_SPREADS = (-5.0, 2.0)  # limits of the logarithm of a size's standard deviation
FIXED = ("uncorrelating", "pool_centre", "pool_spread")  # weights that are not trained


def initial_weights(
    n_columns: int, uncorrelating: NDArray[Any], n_whole: int, n_outputs: int, random: np.random.Generator
) -> dict[str, NDArray[np.float32]]:
    """Draw weights; those that are not trained leave pools as they are."""
    first, second = _RECORDING
    n_pools = 7 * len(uncorrelating) + n_whole
    weights: dict[str, NDArray[np.float32]] = {
        "uncorrelating": uncorrelating.astype(np.float32),
        "pool_centre": np.zeros(n_pools, dtype=np.float32),
        "pool_spread": np.ones(n_pools, dtype=np.float32),
    }
    layers = {
        "recording_1": (n_columns, first, 2.0), "recording_2": (first, second, 2.0),
        "session_1": (n_pools + 2 * second, _SESSION, 2.0), "session_2": (_SESSION, _SESSION, 0.5),
        "session_3": (_SESSION, _SESSION, 0.5), "answer": (_SESSION, n_outputs, 0.1),
    }  # fmt: skip
    return weights | first_weights(layers, random)


def with_outputs(weights: Weights, columns: NDArray[np.intp], random: np.random.Generator) -> dict[str, Any]:
    """Return weights whose outputs are some of those that there are; -1 stands for a new one."""
    layer, bias = weights["answer"], weights["answer_bias"]
    new = random.normal(0, layer.std(), (len(layer), columns.size)).astype(np.float32)
    return dict(weights) | {
        "answer": np.where(columns < 0, new, layer[:, columns]),
        "answer_bias": np.where(columns < 0, np.float32(0), bias[columns]),
    }


def pools(xp: Any, weights: Weights, recordings: Array, shown: Array, many: Array, whole: Array) -> Array:
    """Mean (on both scales, and uncorrelated), spread and extremes of deviations, and difference by count."""
    n_cells = weights["uncorrelating"].shape[0]
    deviations, inside = recordings[..., :n_cells], shown[..., None]
    n = shown.sum(1)[:, None]
    mean = deviations.sum(1) / n
    on_other_scale = recordings[..., n_cells : 2 * n_cells].sum(1) / n
    spread = xp.sqrt(((deviations - mean[:, None]) ** 2 * inside).sum(1) / n + 1e-6)
    lowest = xp.where(inside > 0, deviations, _FAR).min(1) - mean
    highest = xp.where(inside > 0, deviations, -_FAR).max(1) - mean
    n_many = many.sum(1)[:, None]
    n_few = n - n_many
    of_many = (deviations * many[..., None]).sum(1)
    of_few = deviations.sum(1) - of_many
    difference = of_many / xp.maximum(n_many, 1) - of_few / xp.maximum(n_few, 1)
    difference = xp.where((n_many > 0) & (n_few > 0), difference, 0.0)
    parts = [
        mean,
        on_other_scale,
        xp.arcsinh(mean @ weights["uncorrelating"]),
        spread,
        lowest,
        highest,
        difference,
        whole,
    ]
    standardised = (xp.concatenate(parts, 1) - weights["pool_centre"]) / weights["pool_spread"]
    return xp.clip(standardised, -_LIMIT, _LIMIT)


def answers(
    xp: Any,
    weights: Weights,
    recordings: Array,
    shown: Array,
    many: Array,
    whole: Array,
    blurred: Callable[[Array], Array] = lambda pools: pools,
    thinned: Callable[[Array], Array] = lambda layer: layer,
) -> Array:
    """Return the outputs of sessions, shape (n_sessions, n_outputs).

    While the network is trained, ``blurred`` adds noise to the session's pools (Bishop 1995), and ``thinned``
    drops units (Srivastava et al. 2014).
    """

    def layer(name: str, x: Array) -> Array:
        return xp.maximum(x @ weights[name] + weights[f"{name}_bias"], 0)

    inside = shown[..., None]
    coded = layer("recording_2", layer("recording_1", recordings)) * inside
    mean = coded.sum(1) / shown.sum(1)[:, None]
    of_session = [pools(xp, weights, recordings, shown, many, whole), mean, coded.max(1)]
    x = thinned(layer("session_1", blurred(xp.concatenate(of_session, 1))))
    x = thinned(layer("session_2", x) + x)
    x = layer("session_3", x) + x
    return x @ weights["answer"] + weights["answer_bias"]


def split(xp: Any, outputs: Array, n_effects: int) -> tuple[Array, Array, Array]:
    """Return logits of presence, and mean and logarithm of the standard deviation of each size."""
    n_sizes = (outputs.shape[1] - n_effects) // 2
    logits, mean, spread = (
        outputs[:, :n_effects], outputs[:, n_effects : n_effects + n_sizes], outputs[:, n_effects + n_sizes :]
    )  # fmt: skip
    return logits, mean, xp.clip(spread, *_SPREADS)
