"""Training of the network, with JAX and Optax (the extra ``prepare``)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cyclofeat._base.training import descent, dropout, libraries
from cyclofeat.gap.posterior import _network
from cyclofeat.gap.posterior._inputs import Inputs, Recordings, assembled
from cyclofeat.gap.posterior._reference import Reference
from cyclofeat.gap.world import FEWEST_RECORDINGS

Float = NDArray[np.float64]
Flags = NDArray[np.bool_]
Weights = dict[str, NDArray[np.float32]]

_BATCH = 256
# Learning rate and decay of weights (AdamW; Loshchilov and Hutter 2019). Few of the 1,600 inputs tell of an
# effect: without strong decay, those that do not tell fit single rigs.
_RATE, _DECAY = 2e-3, 3.0
_RATE_ON = 3e-4  # of a network that goes on from few rigs: with more it forgets
_DROPPED = 0.2  # share of the units of a hidden layer
_BLURRED = 0.2  # noise on the inputs of the session's layers, in their spreads
_OF_SIZES = 0.5  # weight of the sizes' loss beside that of presence
_STANDARDISING = 2000  # sessions from which the pools are standardised


@dataclass(frozen=True)
class Targets:
    """Targets of the network: presence and standardised sizes, NaN where absent."""

    present: Flags
    sizes: Float


def train(
    made: Recordings,
    targets: Targets,
    reference: Reference,
    *,
    epochs: int,
    learning_rate: float | None = None,
    random_state: int,
    start: Weights | None = None,
    progress: Callable[[int, int], object] | None = None,
) -> Weights:
    """Train one network on simulated rigs, each shown in every epoch as another random session.

    It begins with random weights, or with those of ``start``.
    """
    jax, jnp, _ = libraries()
    random = np.random.default_rng(random_state)
    weights = _first_weights(made, targets, reference, random) if start is None else dict(start)
    fixed = {name: jnp.asarray(weights.pop(name)) for name in _network.FIXED}
    n, n_effects = targets.present.shape
    present = targets.present.astype(np.float32)
    sizes, there = np.nan_to_num(targets.sizes).astype(np.float32), np.isfinite(targets.sizes)
    per_epoch = max(n // _BATCH, 1)
    rate = learning_rate or (_RATE if start is None else _RATE_ON)
    first_state, step = _steps(n_effects, epochs * per_epoch, rate)
    state, key = first_state(weights), jax.random.PRNGKey(random_state)
    for epoch in range(epochs):
        for rows in np.array_split(random.permutation(n), per_epoch):
            rows = rows[: n // per_epoch]  # batches of one size are compiled once
            key, dropping = jax.random.split(key)
            inputs = random_inputs(made.of(rows), reference, random)
            batch = (fixed, inputs.of_network, present[rows], sizes[rows], there[rows])
            weights, state = step(weights, state, batch, dropping)
        if progress is not None:
            progress(epoch + 1, epochs)
    return {name: np.asarray(values, dtype=np.float32) for name, values in (weights | fixed).items()}


# Compiled once for all networks of a posterior.
@lru_cache(maxsize=1)
def _steps(n_effects: int, n_steps: int, rate: float) -> tuple[Callable[..., Any], Callable[..., Any]]:
    """Return the optimiser's first state and one step of training, as functions."""
    jax, jnp, optax = libraries()

    def loss(weights: Any, batch: tuple[Any, ...], key: Any) -> Any:
        fixed, inputs, present, sizes, there = batch
        keys = iter(jax.random.split(key, 4))

        def blurred(pools: Any) -> Any:
            return pools + _BLURRED * jax.random.normal(next(keys), pools.shape)

        thinned = dropout(_DROPPED, keys)
        outputs = _network.answers(jnp, weights | fixed, **inputs, blurred=blurred, thinned=thinned)
        logits, mean, spread = _network.split(jnp, outputs, n_effects)
        of_presence = optax.sigmoid_binary_cross_entropy(logits, present).sum(1).mean()
        squares = 0.5 * ((sizes - mean) * jnp.exp(-spread)) ** 2
        return of_presence + _OF_SIZES * (there * (spread + squares)).sum(1).mean()

    return descent(loss, n_steps, rate, _DECAY)


def random_inputs(made: Recordings, reference: Reference, random: np.random.Generator) -> Inputs:
    """Show a random number of each rig's recordings, with counts and tachometer or without."""
    n, n_recordings = made.made.shape
    wanted = random.integers(min(FEWEST_RECORDINGS, n_recordings), n_recordings + 1, n)
    order = np.argsort(random.random(made.made.shape) + ~made.made, axis=1)
    shown = (np.argsort(order, axis=1) < wanted[:, None]) & made.made
    with_counts, tachometer = random.random((2, n)) < 0.5
    return assembled(made, shown, with_counts, tachometer, reference)


def _first_weights(
    made: Recordings, targets: Targets, reference: Reference, random: np.random.Generator
) -> Weights:
    """Random weights; the pools are standardised and presence begins at its share."""
    rows = random.choice(len(made.made), min(len(made.made), _STANDARDISING), replace=False)
    inputs = random_inputs(made.of(rows), reference, random)
    n_effects, n_sizes = targets.present.shape[1], targets.sizes.shape[1]
    weights = _network.initial_weights(
        inputs.recordings.shape[2], reference.uncorrelating_, inputs.whole.shape[1],
        n_effects + 2 * n_sizes, random,
    )  # fmt: skip
    found = np.asarray(_network.pools(np, weights, **inputs.of_network))
    weights["pool_centre"] = np.median(found, axis=0).astype(np.float32)
    weights["pool_spread"] = (found.std(axis=0) + 0.05).astype(np.float32)
    share = np.clip(targets.present.mean(axis=0), 1e-3, 1 - 1e-3)
    weights["answer_bias"][:n_effects] = np.log(share / (1 - share))
    return weights
