"""Network of a :class:`LobeCounter`: the probability of a row of worn lobes that begins at a given place.

It is written for any array library: JAX trains it and numpy predicts.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cyclofeat._base.training import first_weights, import_jax, make_descent, make_dropout
from cyclofeat.signal.windows import Complex, Float, Int

Array = Any  # of numpy or JAX
Weights = Mapping[str, Array]

# Widths of the hidden layers, and share of their units that is dropped in training.
_HIDDEN, _DROPPED = (512, 128), 0.1
_BATCH, _RATE, _DECAY = 128, 2e-3, 0.02
# Windows in a batch where there are fewer than four times as many as in the usual one.
_SMALL_BATCH = 32
# Default number of epochs, and least number of batches.
_EPOCHS, _LEAST_STEPS = 40, 600
# Places within each lobe at which a row may begin, as a window without a tachometer begins anywhere; how far
# from the true one, in lobes, a beginning is right in training.
PLACES, _NEAR = 4, 0.5
# Standard deviations of a variant: gain in dB and phase in rad of each smooth term over the lobe lines.
# Number of terms.
_GAIN_DB, _PHASE, _N_TERMS = 2.0, 0.2, 4
# Share of the variants that are disturbed. Ranges, log-uniform: root mean square of the disturbance over that
# of the lines, and twice the damping ratio of its resonance. Most turns of the fold by which impacts slip.
_DISTURBED, _DISTURBANCE, _DAMPING, _SLIPPED = 0.2, (0.05, 2.0), (0.05, 1.0), 0.08
# Lower lobe lines hold the brake's drift.
_LOWEST_LINE = 3
# Instead of minus infinity, whose gradient is not a number.
_NEVER = -30.0


@lru_cache(maxsize=8)
def place_turns(n_lobes: int, n_lines: int, n_places: int) -> NDArray[np.complex64]:
    """Return the factors that turn the used lobe lines to each place, shape (n_lobes * n_places, n_used)."""
    at = np.arange(n_lobes * n_places) / (n_lobes * n_places)
    numbers = np.arange(min(_LOWEST_LINE, n_lines), n_lines + 1)
    turns = np.asarray(np.exp(2j * np.pi * np.outer(at, numbers)), dtype=np.complex64)
    turns.flags.writeable = False  # shared by all callers
    return turns


def log_odds(
    xp: Any,
    weights: Weights,
    lines: Array,
    turns: Array,
    drop: Callable[[Array], Array] = lambda layer: layer,
) -> tuple[Array, Array]:
    """Return logarithms of the probabilities of rows and of a sound disc, up to a constant of each window.

    ``xp`` is numpy or jax.numpy, ``lines`` are lobe lines, shape (n_windows, n_lines), ``turns`` are from
    :func:`place_turns`; ``drop`` drops units of a layer in training (Srivastava et al. 2014). The first
    result, shape (n_windows, n_places, n_lengths), is for a row of each length that begins at each place.
    """
    used = lines[:, lines.shape[1] - turns.shape[1] :]
    power = (used.real**2 + used.imag**2).sum(1)
    scale = xp.sqrt(2 * turns.shape[1] / xp.where(power > 0, power, 1))
    views = (used * scale[:, None])[:, None] * turns
    x = xp.concatenate([views.real, views.imag], axis=2)
    for name in ("hidden_1", "hidden_2"):
        x = drop(xp.maximum(x @ weights[name] + weights[f"{name}_bias"], 0))
    rows = x @ weights["row"] + weights["row_bias"]
    return rows, (x.mean(1) @ weights["sound"] + weights["sound_bias"])[:, 0]


def network_layers(
    n_inputs: int, n_lengths: int, widths: tuple[int, int] = _HIDDEN
) -> dict[str, tuple[int, int, float]]:
    """Return the layers for :func:`first_weights`."""
    first, second = widths
    return {
        "hidden_1": (n_inputs, first, 2.0), "hidden_2": (first, second, 2.0), "row": (second, n_lengths, 0.3),
        "sound": (second, 1, 0.0),
    }  # fmt: skip


def train_network(
    lines: Complex, length: Int, begins: Float, *, n_lobes: int, n_lengths: int, n_epochs: int | None,
    random_state: int, least_steps: int = _LEAST_STEPS,
) -> dict[str, NDArray[np.float16]]:  # fmt: skip
    """Train a network.

    The loss is the logarithm of the probability of the true length with a beginning at most half a lobe from
    the true one. In each epoch a window is another variant of itself: turned at random, with a gain and phase
    that change smoothly over the lobe lines, as behind another rotor and torque meter; a fifth get noise, or
    impacts of a neighbouring machine at the lobe rate, which look like a worn lobe.

    For each window, ``length`` is the number of the length of the row, from 0 on, or -1 for a sound disc, and
    ``begins`` where the row begins, in turns of the fold. Weights in half precision err far less than the
    network, and files are half as large.
    """
    jax, _, _ = import_jax()
    n, n_lines = lines.shape
    random = np.random.default_rng(random_state)
    places = place_turns(n_lobes, n_lines, PLACES)
    weights: Any = first_weights(network_layers(2 * places.shape[1], n_lengths), random)
    # Rows and a sound disc begin equally probable.
    weights["row_bias"] -= np.float32(np.log(len(places)))
    known = lines.astype(np.complex64), length.astype(np.int32), begins.astype(np.float32)
    batch = _BATCH if n >= 4 * _BATCH else _SMALL_BATCH
    per_epoch = max(n // batch, 1)
    if n_epochs is None:
        n_epochs = max(_EPOCHS, least_steps // per_epoch)
    first_state, step = _optimiser(n_lines, n_lobes, n_epochs * per_epoch)
    state, key = first_state(weights), jax.random.PRNGKey(random_state)
    for _ in range(n_epochs):
        # Batches of one size are compiled once; windows that are left over wait for the next epoch.
        order = np.resize(random.permutation(n), max(n, batch))[: per_epoch * batch]
        for rows in order.reshape(per_epoch, batch):
            key, drawn = jax.random.split(key)
            weights, state = step(weights, state, tuple(values[rows] for values in known), drawn)
    return {name: np.asarray(values, dtype=np.float16) for name, values in weights.items()}


# Compiled once for all folds.
@lru_cache(maxsize=4)
def _optimiser(n_lines: int, n_lobes: int, n_steps: int) -> tuple[Callable[..., Any], Callable[..., Any]]:
    """Return the optimiser's first state and one step of training, as functions."""
    jax, jnp, _ = import_jax()
    turns = place_turns(n_lobes, n_lines, PLACES)
    at = np.arange(len(turns)) / len(turns)
    numbers = np.arange(1, n_lines + 1)
    term = np.arange(1, _N_TERMS + 1)[:, np.newaxis]
    smooth = np.cos(np.pi * term * numbers / n_lines) / term

    def vary(lines: Any, turned: Any, keys: Iterator[Any]) -> Any:
        n = len(lines)
        gain = _GAIN_DB / 20 * np.log(10) * jax.random.normal(next(keys), (n, _N_TERMS)) @ smooth
        phase = jax.random.normal(next(keys), (n, 1))
        phase += jax.random.normal(next(keys), (n, _N_TERMS)) @ smooth
        return lines * jnp.exp(gain + 1j * (_PHASE * phase + 2 * np.pi * turned * numbers))

    def disturbance(lines: Any, keys: Iterator[Any]) -> Any:
        """Return impacts at the lobe rate, or noise, both about a resonance; zero for most windows."""
        n = len(lines)

        def between(low: float, high: float) -> Any:
            return jnp.exp(jax.random.uniform(next(keys), (n, 1), minval=np.log(low), maxval=np.log(high)))

        resonance = between(_LOWEST_LINE, 2 * n_lines)
        rings = resonance**2 / (resonance**2 - numbers**2 + 1j * numbers * resonance * between(*_DAMPING))
        begins = jax.random.uniform(next(keys), (n, 1))
        slipped = _SLIPPED * jax.random.uniform(next(keys), (n, 1)) * numbers
        impacts = jnp.exp(-2j * np.pi * begins * numbers) * jnp.sinc(slipped)
        noise = jax.random.normal(next(keys), lines.shape, dtype=lines.dtype)
        added = rings * jnp.where(jax.random.bernoulli(next(keys), 0.5, (n, 1)), impacts, noise)
        is_disturbed = jax.random.bernoulli(next(keys), _DISTURBED, (n, 1))
        return is_disturbed * between(*_DISTURBANCE) * added * rms(lines) / rms(added)

    def rms(lines: Any) -> Any:
        return jnp.sqrt((jnp.abs(lines[:, _LOWEST_LINE - 1 :]) ** 2).mean(1, keepdims=True))

    def loss(weights: Any, batch: Any, key: Any) -> Any:
        lines, length, begins = batch
        keys = iter(jax.random.split(key, 14))
        turned = jax.random.uniform(next(keys), (len(lines), 1))
        seen = vary(lines, turned, keys)
        seen += disturbance(seen, keys)
        rows, sound = log_odds(jnp, weights, seen, turns, make_dropout(_DROPPED, keys))
        beside = jnp.abs((at - begins[:, None] + turned + 0.5) % 1 - 0.5) * n_lobes
        of_length = jnp.take_along_axis(rows, jnp.maximum(length, 0)[:, None, None], axis=2)[:, :, 0]
        right = jax.nn.logsumexp(of_length + jnp.where(beside <= _NEAR, 0.0, _NEVER), axis=1)
        every = jnp.concatenate([sound[:, None], rows.reshape(len(lines), -1)], axis=1)
        return (jax.nn.logsumexp(every, axis=1) - jnp.where(length < 0, sound, right)).mean()

    return make_descent(loss, n_steps, _RATE, _DECAY)
