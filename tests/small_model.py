"""A model small enough to be trained in a moment, and recordings that it can count: bursts at worn lobes."""

from __future__ import annotations

import functools

import numpy as np

from cyclofeat import Recording
from cyclofeat.counting import LobeCounter, LobeModel
from cyclofeat.counting.estimators import _lobe_network, lobe_counter

RATE = 2000.0
SPEED = 500 / 60
SAMPLES = 3600  # of an output turn


def recording(lobes, seed=0, turns=1, slowing=0.0, height=1.0, n_lobes=15, **labels):
    """Whole output turns with a burst at each worn lobe, by a tachometer; slower at the end by a share."""
    random = np.random.default_rng(seed)
    samples = turns * SAMPLES * n_lobes // 15
    phi = 2 * np.pi * SPEED * np.arange(samples) / RATE * (1 - slowing * np.arange(samples) / samples / 2)
    cam = ((n_lobes + 1) * phi + np.pi) / (2 * np.pi)  # in lobes
    torque = 22 + random.normal(0, 0.05, phi.size)
    for lobe in lobes:
        torque += (
            height
            * random.uniform(0.8, 1.2)
            * np.exp(-((((cam - lobe + n_lobes / 2) % n_lobes - n_lobes / 2) / 0.15) ** 2))
        )
    known = {
        "angle": phi, "angle_is_absolute": True, "assembly": f"A{seed}", "source": "surrogate",
        "worn_lobes": lobes, "speed_rpm": 500, "n_lobes": n_lobes,
    }  # fmt: skip
    return Recording(torque, RATE, **(known | labels))


def unlike_training(seed=0):
    """What no row of worn lobes does: the torque jumps at every third lobe."""
    time = np.arange(SAMPLES) / RATE
    torque = 22 + np.sign(np.sin(2 * np.pi * SPEED * 16 / 15 * 5 * time + 0.1))
    torque += np.random.default_rng(seed).normal(0, 0.01, SAMPLES)
    return Recording(torque, RATE, speed_rpm=500, source="measured")


@functools.cache
def small_model(counts=(0, 1, 3), per_count=12):
    """A model of few trees that are not calibrated, but of all parts: counter, locator, training domain."""
    random = np.random.default_rng(5)
    recordings = [
        recording(tuple(int(lobe) for lobe in (random.integers(15) + np.arange(count)) % 15), seed=seed)
        for seed, count in enumerate(np.tile(counts, per_count))
    ]
    counter = LobeCounter(RATE, n_trees=30, n_splits=0, random_state=0)
    model = LobeModel(counter=counter, n_splits=0, random_state=0, description="bursts <i>by hand</i>")
    return model.fit(recordings)


@functools.cache
def shaft_model(counts=(0, 1, 3), per_count=8):
    """A default model of such recordings, with few trees."""
    return LobeModel(n_splits=2, n_trees=20, random_state=0).fit(labelled(counts, per_count))


def labelled(counts=(0, 1, 3), per_count=8, n_lobes=15, **labels):
    """Recordings of one assembly each, with rows of worn lobes."""
    return [
        recording(
            tuple((seed + lobe) % n_lobes for lobe in range(count)), seed=seed, n_lobes=n_lobes, **labels
        )
        for seed, count in enumerate(counts * per_count)
    ]


def first_of_each(recordings, n):
    """Mark the first n recordings of each count."""
    counts = [one.defect_count for one in recordings]
    return np.array([counts[:k].count(count) < n for k, count in enumerate(counts)])


def recordings_with_wear(n=24, counts=(0, 1, 3), seed=0, turns=(2,)):
    """Recordings of some output turns whose bursts are as high as the wear is deep: 1 Nm at 200 um."""
    random = np.random.default_rng(seed)
    made = []
    for k, count in enumerate(np.tile(counts, n)):
        depth = float(5 * 40 ** random.random())
        lobes = tuple(int(lobe) for lobe in (random.integers(15) + np.arange(count)) % 15)
        meta = {"wear_um": depth if count else 0.0}
        long = turns[k % len(turns)]
        made.append(recording(lobes, seed=1000 * seed + k, turns=long, height=depth / 200, meta=meta))
    return made


@functools.cache
def wear_model(counter="trees"):
    """A model that learned the depth of the wear."""
    return LobeModel(counter=counter, n_splits=0, n_trees=25, wear_um=(5, 200), random_state=0).fit(
        recordings_with_wear()
    )


def make_networks_small(patch):
    """Train narrow networks on few batches, which is enough for recordings as simple as these."""
    layers = functools.partial(_lobe_network.network_layers, widths=(128, 64))
    patch.setattr(_lobe_network, "network_layers", layers)
    train = functools.partial(_lobe_network.train_network, least_steps=150)
    patch.setattr(lobe_counter, "train_network", train)
