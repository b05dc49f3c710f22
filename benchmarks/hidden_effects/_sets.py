"""Sets of recordings, whose conditions and hidden effects follow from a seed and the committed tables."""

from __future__ import annotations

import csv
import hashlib
import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.hidden_effects._effects import Condition, on_signal

HERE = Path(__file__).parent
SEED = 20_261_123
FORMAT = "cyclofeat hidden effects 2"
KINDS = ("null", "single", "several", "outside")
STRENGTHS = ("weak", "medium", "strong")
FIT, HOLD = "fit", "hold"
STANDARD = Condition(500.0, 22.0, 1)

# 400 nulls, a quarter of them decoys.
_DECOYS = ("",) * 300 + ("edges",) * 50 + ("speed", "load", "both", "assembly", "disc") * 10
_SINGLES_OF_EACH = 4  # of an effect in one strength
_MORE_SINGLES = 16
_SEVERAL_OF_EACH = 60  # of each number of effects
_OUTSIDE_ALONE, _OUTSIDE_BESIDE = 60, 40
_SPEEDS, _LOADS = (350.0, 700.0), (10.0, 30.0)
_LEAST_RATIO = 2.0  # of the largest to the smallest load of three conditions
_REVERSED = 1 / 3

Parts = tuple[tuple[str, str, dict[str, float]], ...]


@dataclass(frozen=True)
class Row:
    """One parameter of one effect: its values in three strengths, and how a set varies them.

    ``scale`` is ``"linear"``, ``"sign"`` (the value with a random sign), ``"factor"`` (a pure factor whose
    neutral value is 1: the value or its inverse) or ``"load"`` (the value times the largest load).
    """

    effect: str
    parameter: str
    unit: str
    scale: str
    values: dict[str, float]


@dataclass(frozen=True)
class Planned:
    """One recording of a set: its part (``"fit"`` or ``"hold"``), number, condition and worn lobes."""

    part: str
    number: int
    condition: Condition
    count: int


@dataclass(frozen=True)
class Definition:
    """One set: conditions that are fitted, the one that is only held out, and effects.

    ``effects`` holds names, strengths (``"drawn"`` between weak and strong in sets of several) and
    parameters. Sets of one ``machine`` share its runs: they have the same effects in the machine.
    """

    name: str
    kind: str
    number: int
    machine: int
    conditions: tuple[Condition, ...]
    between: Condition | None
    effects: Parts
    decoy: str

    @property
    def hidden(self) -> tuple[tuple[str, dict[str, float]], ...]:
        """Effects and their parameters, as the generator takes them."""
        return tuple((effect, theta) for effect, _, theta in self.effects)

    @property
    def recordings(self) -> tuple[Planned, ...]:
        """The recordings: 8 at one condition or 12 at three, and as many held out (none of a null)."""
        if len(self.conditions) == 1:
            (one,) = self.conditions
            fit = [(one, count) for count in (0, 2, 4, 6) * 2]
            hold = [(one, count) for count in (0, 2, 4, 6, 1, 3, 5, 7)]
        else:
            fit = [(one, count) for one in self.conditions for count in (0, 2, 4, 6)]
            hold = list(zip(self.conditions * 2, (0, 2, 4, 6, 0, 4), strict=True))
            assert self.between is not None
            hold += [(self.between, count) for count in (0, 2, 4, 6, 1, 5)]
        parts = {FIT: fit} if self.kind == "null" else {FIT: fit, HOLD: hold}
        return tuple(Planned(part, i, *one) for part, every in parts.items() for i, one in enumerate(every))


@cache
def rows_of(name: str) -> tuple[dict[str, str], ...]:
    """The rows of a committed table, as text."""
    with (HERE / name).open(encoding="utf-8", newline="") as file:
        return tuple(csv.DictReader(file))


@cache
def table(name: str) -> tuple[Row, ...]:
    """The rows of ``sizes.csv`` (the library's effects) or ``beyond.csv`` (others)."""
    return tuple(
        Row(
            effect=row["effect"],
            parameter=row["parameter"],
            unit=row["unit"],
            scale=row["scale"],
            values={strength: float(row[strength]) for strength in STRENGTHS},
        )
        for row in rows_of(name)
    )


def effect_names(name: str) -> list[str]:
    """Names of the effects in a table, in its order."""
    return list(dict.fromkeys(row.effect for row in table(name)))


@cache
def tie_groups() -> tuple[frozenset[str], ...]:
    """Groups of effects of ``ties.csv`` that may stand for each other."""
    return tuple(frozenset(row["effects"].split()) for row in rows_of("ties.csv"))


def _theta(effect: str, strength: str, load: float, random: np.random.Generator) -> dict[str, float]:
    """Draw an effect's parameters: near a strength, or anywhere between weak and strong (``"drawn"``)."""
    found = {}
    for row in (*table("sizes.csv"), *table("beyond.csv")):
        if row.effect == effect:
            low, high = _ends(row, strength)
            value = low * (high / low) ** random.random()
            sign = float(random.choice((-1.0, 1.0)))
            if row.scale == "load":
                value *= load
            elif row.scale != "linear":
                value *= sign
            value = math.exp(value) if row.scale == "factor" else value
            # Rounded as in the truth, so that the number does not change when it is read again.
            found[row.parameter] = float(f"{value:.5g}")
    return found


def _ends(row: Row, strength: str) -> tuple[float, float]:
    """Range of a parameter, or of its logarithm if it is a factor."""
    factor = row.scale == "factor"
    sizes = {key: math.log(value) if factor else value for key, value in row.values.items()}
    if strength == "drawn":
        return sizes["weak"], sizes["strong"]
    spread = 1.0 if row.scale == "load" else 1.25
    return sizes[strength] / spread, sizes[strength] * spread


def _conditions(machine: int, random: np.random.Generator) -> tuple[tuple[Condition, ...], Condition | None]:
    """Kinematics of a machine: of three in a row one has three, one the standard one, one another."""
    kind = np.random.default_rng([SEED, machine // 3, 3]).permutation(3)[machine % 3]
    if kind == 0:
        return (STANDARD,), None

    def rounded(speed: float, load: float, direction: int) -> Condition:
        return Condition(round(speed, 1), round(load, 2), direction)

    ways = np.where(random.random(3) < _REVERSED, -1, 1).tolist()
    if kind == 1:
        return (rounded(random.uniform(*_SPEEDS), random.uniform(*_LOADS), ways[0]),), None
    edges = np.linspace(*_SPEEDS, 4)
    speeds = random.permutation(random.uniform(edges[:-1], edges[1:])).tolist()
    loads = random.uniform(*_LOADS, 3)
    while loads.max() < _LEAST_RATIO * loads.min():
        loads = random.uniform(*_LOADS, 3)
    every = tuple(rounded(*one) for one in zip(speeds, loads.tolist(), ways, strict=True))
    middle = [(max(values) + min(values)) / 2 for values in (speeds, loads.tolist())]
    return every, rounded(middle[0], middle[1], ways[0])


# A plan: kind, decoy, effects with their strengths, and how many sets back is the one with the same machine.
_Plan = tuple[str, str, tuple[tuple[str, str], ...], int]


def _singles() -> Iterator[_Plan]:
    inside = effect_names("sizes.csv")
    for signal in (False, True):
        names = [name for name in inside if on_signal(name) == signal]
        every = [
            (name, strength) for _ in range(_SINGLES_OF_EACH) for strength in STRENGTHS for name in names
        ]
        every += [] if signal else [(name, "medium") for name in names[:_MORE_SINGLES]]
        for k, one in enumerate(every):
            # Four in a row are different effects on the signal: one machine serves them.
            yield "single", "", (one,), k % 4 if signal else 0


def _several(random: np.random.Generator) -> Iterator[_Plan]:
    """Random sets of each number of effects; two in turn share a machine and differ on the signal."""
    names = effect_names("sizes.csv")
    signal = [name for name in names if on_signal(name)]
    for n in range(2, 7):
        for _ in range(_SEVERAL_OF_EACH // 2):
            first = random.choice(names, n, replace=False).tolist()
            kept = [name for name in first if name not in signal]
            second, back = kept + random.choice(signal, n - len(kept), replace=False).tolist(), 1
            if set(second) == set(first):
                second, back = random.choice(names, n, replace=False).tolist(), 0
            for chosen, shared in ((first, 0), (second, back)):
                yield (
                    "several",
                    "",
                    tuple((name, "drawn") for name in sorted(chosen, key=names.index)),
                    shared,
                )


def _outside(random: np.random.Generator) -> Iterator[_Plan]:
    """One effect that the library does not have, in some sets beside one that it has."""
    beyond, inside = effect_names("beyond.csv"), effect_names("sizes.csv")
    for k in range(_OUTSIDE_ALONE + _OUTSIDE_BESIDE):
        parts = [(beyond[k % len(beyond)], STRENGTHS[k // len(beyond) % 3])]
        beside = str(random.choice([name for name in inside if name != "brake_rotor"]))
        parts += [(beside, "medium")] if k >= _OUTSIDE_ALONE else []
        yield "outside", "", tuple(parts), 0


@cache
def definitions() -> dict[str, Definition]:
    """All sets by name, in the order of the names, which is not related to the content."""
    random = np.random.default_rng([SEED, 99])
    plans: list[_Plan] = [("null", decoy, (), 0) for decoy in _DECOYS]
    plans += [*_singles(), *_several(random), *_outside(random)]
    found = {}
    for number, (kind, decoy, parts, back) in enumerate(plans):
        machine = number - back
        conditions, between = _conditions(machine, np.random.default_rng([SEED, machine, 1]))
        load = max(one.load_nm for one in conditions)
        name = "set_" + hashlib.sha256(f"{SEED} {number}".encode()).hexdigest()[:8]
        found[name] = Definition(
            name=name,
            kind=kind,
            number=number,
            machine=machine,
            conditions=conditions,
            between=between,
            # Of the machine's seed, and the effect's name: a shared machine has equal effects.
            effects=tuple(
                (effect, strength, _theta(effect, strength, load, _random(machine, effect)))
                for effect, strength in parts
            ),
            decoy=decoy,
        )
    if len(found) != len(plans):
        raise RuntimeError("two sets have one name")
    return dict(sorted(found.items()))


def _random(machine: int, effect: str) -> np.random.Generator:
    return np.random.default_rng([SEED, machine, 2, *effect.encode()])


def set_names(kinds: Sequence[str] = KINDS) -> list[str]:
    """Names of the sets of some kinds."""
    for kind in kinds:
        if kind not in KINDS:
            raise ValueError(f"kinds must be of {KINDS}, got {kind!r}")
    return [name for name, one in definitions().items() if one.kind in kinds]


def truth_text() -> str:
    """Return the content of ``truth.json``: one line per set."""

    def at(one: Condition) -> list[float]:
        return [one.speed_rpm, one.load_nm, one.direction]

    lines = []
    for name, one in definitions().items():
        said: dict[str, Any] = {
            "kind": one.kind,
            "machine": one.machine,
            "conditions": [at(condition) for condition in one.conditions],
            "between": one.between and at(one.between),
            "decoy": one.decoy,
            "effects": {effect: theta for effect, _, theta in one.effects},
            "strengths": [strength for _, strength, _ in one.effects],
        }
        lines.append(
            f"{json.dumps(name)}: {json.dumps({key: value for key, value in said.items() if value})}"
        )
    head = f'"format": {json.dumps(FORMAT)}, "seed": {SEED}, "sets": {{\n'
    return "{" + head + ",\n".join(lines) + "\n}}\n"
