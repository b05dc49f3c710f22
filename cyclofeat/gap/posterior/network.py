"""The network: from recordings in any number and order to presence and size of each effect.

Each recording passes a small network; mean and maximum over the recordings, together with mean, spread and
extremes of their deviations themselves, pass a second one (a Deep Set; Zaheer et al. 2017, "Deep Sets",
NIPS). It is written for any array library: JAX trains it and numpy answers.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cyclofeat._base.training import first_weights, import_jax, make_descent, make_dropout
from cyclofeat.gap.posterior.inputs import Inputs, Recordings, Reference, assemble_inputs
from cyclofeat.gap.world.prepare import FEWEST_RECORDINGS

Array = Any  # of numpy or JAX
Weights = Mapping[str, Array]

_RECORDING, _SESSION = (192, 192), 512  # widths
_FAR = 1e3
_LIMIT = 8.0  # of standardised pools
_SPREADS = (-5.0, 2.0)  # limits of the logarithm of a size's standard deviation
FIXED = ("uncorrelating", "pool_centre", "pool_spread")  # weights that are not trained


def select_outputs(
    weights: Weights, columns: NDArray[np.intp], random: np.random.Generator
) -> dict[str, Any]:
    """Return weights with the output ``columns`` selected; -1 adds a new output."""
    layer, bias = weights["answer"], weights["answer_bias"]
    new = random.normal(0, layer.std(), (len(layer), columns.size)).astype(np.float32)
    return dict(weights) | {
        "answer": np.where(columns < 0, new, layer[:, columns]),
        "answer_bias": np.where(columns < 0, np.float32(0), bias[columns]),
    }


def pool_recordings(
    xp: Any, weights: Weights, recordings: Array, shown: Array, many: Array, whole: Array
) -> Array:
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
    uncorrelated = xp.arcsinh(mean @ weights["uncorrelating"])
    parts = [mean, on_other_scale, uncorrelated, spread, lowest, highest, difference, whole]
    standardised = (xp.concatenate(parts, 1) - weights["pool_centre"]) / weights["pool_spread"]
    return xp.clip(standardised, -_LIMIT, _LIMIT)


def network_outputs(
    xp: Any,
    weights: Weights,
    inputs: Mapping[str, Array],
    blurred: Callable[[Array], Array] = lambda pools: pools,
    thinned: Callable[[Array], Array] = lambda layer: layer,
) -> Array:
    """Return the outputs of sessions, shape (n_sessions, n_outputs).

    While the network is trained, ``blurred`` adds noise to the session's pools (Bishop 1995), and ``thinned``
    drops units (Srivastava et al. 2014).
    """

    def layer(name: str, x: Array) -> Array:
        return xp.maximum(x @ weights[name] + weights[f"{name}_bias"], 0)

    shown = inputs["shown"]
    coded = layer("recording_2", layer("recording_1", inputs["recordings"])) * shown[..., None]
    mean = coded.sum(1) / shown.sum(1)[:, None]
    of_session = [pool_recordings(xp, weights, **inputs), mean, coded.max(1)]
    x = thinned(layer("session_1", blurred(xp.concatenate(of_session, 1))))
    x = thinned(layer("session_2", x) + x)
    x = layer("session_3", x) + x
    return x @ weights["answer"] + weights["answer_bias"]


def split_outputs(xp: Any, outputs: Array, n_effects: int) -> tuple[Array, Array, Array]:
    """Return logits of presence, and mean and logarithm of the standard deviation of each size."""
    n_sizes = (outputs.shape[1] - n_effects) // 2
    logits, mean, spread = (
        outputs[:, :n_effects], outputs[:, n_effects : n_effects + n_sizes], outputs[:, n_effects + n_sizes :]
    )  # fmt: skip
    return logits, mean, xp.clip(spread, *_SPREADS)


Float = NDArray[np.float64]
Flags = NDArray[np.bool_]
NetworkWeights = dict[str, NDArray[np.float32]]

_BATCH = 256
# Learning rate and decay of weights (AdamW; Loshchilov and Hutter 2019). Few of the 1,600 inputs tell of an
# effect: without strong decay, those that do not tell fit single rigs.
_RATE, _DECAY = 2e-3, 3.0
_RATE_ON = 3e-4  # of a network that goes on from few rigs: with more it forgets
_DROPPED = 0.2  # share of the units of a hidden layer
_BLURRED = 0.2  # noise on the inputs of the session's layers, in their spreads
_OF_SIZES = 0.5  # weight of the sizes' loss beside that of presence
_STANDARDISING = 2000  # sessions from which the pools are standardised


class Targets(NamedTuple):
    """Targets of the network: presence and standardised sizes, NaN where absent."""

    present: Flags
    sizes: Float


def train_network(
    padded: Recordings,
    targets: Targets,
    reference: Reference,
    *,
    epochs: int,
    random_state: int,
    start: NetworkWeights | None = None,
    progress: Callable[[int, int], object] | None = None,
) -> NetworkWeights:
    """Train a network, from ``start`` if given, on rigs shown in every epoch as other random sessions."""
    jax, jnp, _ = import_jax()
    random = np.random.default_rng(random_state)
    weights = _first_weights(padded, targets, reference, random) if start is None else dict(start)
    fixed = {name: jnp.asarray(weights.pop(name)) for name in FIXED}
    n, n_effects = targets.present.shape
    present = targets.present.astype(np.float32)
    sizes, has_size = np.nan_to_num(targets.sizes).astype(np.float32), np.isfinite(targets.sizes)
    per_epoch = max(n // _BATCH, 1)
    rate = _RATE if start is None else _RATE_ON
    first_state, step = _compiled_steps(n_effects, epochs * per_epoch, rate)
    state, key = first_state(weights), jax.random.PRNGKey(random_state)
    for epoch in range(epochs):
        for rows in np.array_split(random.permutation(n), per_epoch):
            rows = rows[: n // per_epoch]  # batches of one size are compiled once
            key, dropping = jax.random.split(key)
            inputs, _ = random_inputs(padded.of(rows), reference, random)
            batch = (fixed, inputs, present[rows], sizes[rows], has_size[rows])
            weights, state = step(weights, state, batch, dropping)
        if progress is not None:
            progress(epoch + 1, epochs)
    return {name: np.asarray(values, dtype=np.float32) for name, values in (weights | fixed).items()}


# Compiled once for all networks of a posterior.
@lru_cache(maxsize=1)
def _compiled_steps(
    n_effects: int, n_steps: int, rate: float
) -> tuple[Callable[..., Any], Callable[..., Any]]:
    """Return the optimiser's first state and one step of training, as functions."""
    jax, jnp, optax = import_jax()

    def loss(weights: Any, batch: tuple[Any, ...], key: Any) -> Any:
        fixed, inputs, present, sizes, has_size = batch
        keys = iter(jax.random.split(key, 4))

        def add_noise(pools: Any) -> Any:
            return pools + _BLURRED * jax.random.normal(next(keys), pools.shape)

        thinned = make_dropout(_DROPPED, keys)
        outputs = network_outputs(jnp, weights | fixed, inputs, add_noise, thinned)
        logits, mean, spread = split_outputs(jnp, outputs, n_effects)
        of_presence = optax.sigmoid_binary_cross_entropy(logits, present).sum(1).mean()
        squares = 0.5 * ((sizes - mean) * jnp.exp(-spread)) ** 2
        return of_presence + _OF_SIZES * (has_size * (spread + squares)).sum(1).mean()

    return make_descent(loss, n_steps, rate, _DECAY)


def random_inputs(padded: Recordings, reference: Reference, random: np.random.Generator) -> Inputs:
    """Show a random number of each rig's recordings, with counts and tachometer or without."""
    n, n_recordings = padded.is_real.shape
    wanted = random.integers(min(FEWEST_RECORDINGS, n_recordings), n_recordings + 1, n)
    order = np.argsort(random.random(padded.is_real.shape) + ~padded.is_real, axis=1)
    shown = (np.argsort(order, axis=1) < wanted[:, None]) & padded.is_real
    with_counts, tachometer = random.random((2, n)) < 0.5
    return assemble_inputs(padded, shown, with_counts, tachometer, reference)


def _first_weights(
    padded: Recordings, targets: Targets, reference: Reference, random: np.random.Generator
) -> NetworkWeights:
    """Random weights; the pools are standardised and presence begins at its share."""
    rows = random.choice(len(padded.is_real), min(len(padded.is_real), _STANDARDISING), replace=False)
    inputs, _ = random_inputs(padded.of(rows), reference, random)
    n_effects, n_outputs = targets.present.shape[1], targets.present.shape[1] + 2 * targets.sizes.shape[1]
    first, second = _RECORDING
    n_pools = 7 * len(reference.uncorrelating_) + inputs["whole"].shape[1]
    layers = {
        "recording_1": (inputs["recordings"].shape[2], first, 2.0), "recording_2": (first, second, 2.0),
        "session_1": (n_pools + 2 * second, _SESSION, 2.0), "session_2": (_SESSION, _SESSION, 0.5),
        "session_3": (_SESSION, _SESSION, 0.5), "answer": (_SESSION, n_outputs, 0.1),
    }  # fmt: skip
    weights: NetworkWeights = {
        "uncorrelating": reference.uncorrelating_.astype(np.float32),
        "pool_centre": np.zeros(n_pools, dtype=np.float32),
        "pool_spread": np.ones(n_pools, dtype=np.float32),
    } | first_weights(layers, random)
    pools = np.asarray(pool_recordings(np, weights, **inputs))
    weights["pool_centre"] = np.median(pools, axis=0).astype(np.float32)
    weights["pool_spread"] = (pools.std(axis=0) + 0.05).astype(np.float32)
    share = np.clip(targets.present.mean(axis=0), 1e-3, 1 - 1e-3)
    weights["answer_bias"][:n_effects] = np.log(share / (1 - share))
    return weights
