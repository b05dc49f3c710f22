"""Training of networks with JAX and Optax (the extra ``prepare``)."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray


def import_jax() -> tuple[Any, Any, Any]:
    """Return ``jax``, ``jax.numpy`` and ``optax``, or raise ImportError with what to install."""
    try:
        import jax
        import jax.numpy as jnp
        import optax
    except ImportError as error:
        raise ImportError("training a network needs JAX and Optax: pip install jax optax") from error
    return jax, jnp, optax


def first_weights(
    layers: Mapping[str, tuple[int, int, float]], random: np.random.Generator
) -> dict[str, NDArray[np.float32]]:
    """Draw weights of dense layers, with biases of zero (He et al. 2015).

    ``layers``: name to number of inputs, of outputs, and variance of weights times number of inputs.
    """
    weights = {}
    for name, (n_in, n_out, power) in layers.items():
        drawn = random.normal(0, np.sqrt(power / n_in), (n_in, n_out))
        weights[name] = drawn.astype(np.float32)
        weights[f"{name}_bias"] = np.zeros(n_out, dtype=np.float32)
    return weights


def make_dropout(share: float, keys: Iterator[Any]) -> Callable[[Any], Any]:
    """Return dropout of this share of a layer's units (Srivastava et al. 2014); each call takes one key.

    The same units of a sample (first axis) are dropped at all places (axes between the first and the last).
    """
    jax, _, _ = import_jax()

    def drop_units(layer: Any) -> Any:
        n_samples, *places, n_units = layer.shape
        kept = jax.random.bernoulli(next(keys), 1 - share, (n_samples, *(1 for _ in places), n_units))
        return layer * kept / (1 - share)

    return drop_units


def make_descent(
    loss: Callable[[Any, Any, Any], Any], n_steps: int, rate: float, decay: float
) -> tuple[Callable[..., Any], Callable[..., Any]]:
    """Return the optimiser's first state and one step of training, as functions.

    AdamW (Loshchilov and Hutter 2019) with one cycle of the learning rate over ``n_steps`` steps, at most
    ``rate``; biases do not decay. ``loss`` is of weights (a dictionary of arrays), a batch and a random key.
    """
    jax, _, optax = import_jax()

    def select_decaying(weights: Any) -> dict[str, bool]:
        return {name: not name.endswith("_bias") for name in weights}

    schedule = optax.cosine_onecycle_schedule(n_steps, rate)
    optimiser = optax.chain(
        optax.clip_by_global_norm(1.0), optax.adamw(schedule, weight_decay=decay, mask=select_decaying)
    )

    @jax.jit
    def train_step(weights: Any, state: Any, batch: Any, key: Any) -> Any:
        change, state = optimiser.update(jax.grad(loss)(weights, batch, key), state, weights)
        return optax.apply_updates(weights, change), state

    return optimiser.init, train_step
