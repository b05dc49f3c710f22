"""The next measurement: what a person at the bench can do to decide most of what is undecided."""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from cyclofeat.gap.result import NextMeasurement
from cyclofeat.gap.world.world import Session, World
from cyclofeat.simulators import Hum

_LOAD_RATIO, _SPEED_RATIO = 1.5, 1.2  # between recordings, from which another load or speed tells something
_FARTHEST_LOAD = 2.0  # ratio that separates a gain from an offset well
_LONGER = "longer records, of several output turns"
_LEAST = 0.1  # weight that a measurement must decide


def rank_measurements(
    undecided: Mapping[str, float], session: Session, world: World
) -> tuple[NextMeasurement, ...]:
    """Rank measurements by what they would decide, the most useful first, but for those already made.

    A measurement decides about an effect whose class names it (``separated_by``), and half as well about one
    that looks like such an effect; longer records half as well about effects about which nothing else does.
    ``undecided`` holds a weight for each effect, such as the bits that are unknown of it.

    Examples
    --------
    >>> world = World()
    >>> session = Session(np.zeros((2, len(world.cells))), np.array([[500.0, 22.0, 1.0]] * 2))
    >>> [str(row) for row in rank_measurements({"gain": 0.9, "offset": 0.8}, session, world)][:1]
    ['recordings at 11 Nm, to decide about gain, offset']
    """
    effects = {effect.effect_id: effect for effect in world.effects or () if effect.effect_id in undecided}
    decided = {
        what: {name for name, effect in effects.items() if re.search(words, effect.separated_by)}
        for what, words in _bench_offers(session, world).items()
    }
    others = effects.keys() - set[str]().union(*decided.values())
    ranked: list[tuple[float, NextMeasurement]] = []
    for what, direct in decided.items():
        shown = {effects[name].shows_as for name in direct} - {""}
        less = {name for name, effect in effects.items() if effect.shows_as in shown} - direct
        less |= others if what == _LONGER else set()
        weights = {name: undecided[name] / (1 if name in direct else 2) for name in direct | less}
        if sum(weights.values()) > _LEAST:
            names = sorted(weights, key=lambda name: (-weights[name], name))
            ranked.append((sum(weights.values()), NextMeasurement(what, tuple(names))))
    return tuple(row for _, row in sorted(ranked, key=lambda pair: -pair[0]))


def _bench_offers(session: Session, world: World) -> dict[str, str]:
    """Return measurements, the preferred ones first, and the words of ``separated_by`` that mean them."""
    speeds, loads, directions = session.conditions.T
    offers = {}
    # Of the multiples of 10 RPM, the one at which mains hum is farthest from whole orders of the input shaft.
    possible = np.arange(np.ceil(world.speeds_rpm[0] / 10), world.speeds_rpm[1] / 10) * 10
    possible = possible[[_ratio(speed, speeds) >= _SPEED_RATIO for speed in possible.tolist()]]
    if speeds.max() < _SPEED_RATIO * speeds.min() and possible.size:
        orders = 60 * Hum().frequency_hz / possible
        best = possible[np.argmax(np.abs(orders - np.round(orders)).round(3))]
        offers[f"recordings at {best:.0f} RPM"] = "another speed|(two|several) speeds|step of speed"
    low, high = world.loads_nm
    ends = min(high, loads.max() * _FARTHEST_LOAD), max(low, loads.min() / _FARTHEST_LOAD)
    farthest = max(ends, key=lambda load: _ratio(load, loads))
    if loads.max() < _LOAD_RATIO * loads.min() and _ratio(farthest, loads) >= _LOAD_RATIO:
        words = "(another|two) loads?|set-point" + ("|lower load" if farthest < loads.min() else "")
        offers[f"recordings at {farthest:.3g} Nm"] = words
    if np.all(directions == directions[0]):
        offers["recordings in reverse"] = "direction"
    if session.speeds_rpm is None:
        offers["recordings with a tachometer"] = "tachometer"
    return offers | {"a record with the motor off": "motor off|at rest|without load", _LONGER: "output turn"}


def _ratio(value: float, others: NDArray[np.float64]) -> float:
    """Return the ratio, of at least 1, of a value to the nearest of the others."""
    return float(np.exp(np.abs(np.log(value / others)).min()))
