"""Cases, whose hidden effects follow from a seed and the committed tables."""

from __future__ import annotations

import csv
import hashlib
import itertools
import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.hidden_effects._machine import SAMPLING_RATE
from benchmarks.hidden_effects._rig import N_SAMPLES, nuisance_and_seed, record

HERE = Path(__file__).parent
SEED = 20_260_831
FORMAT = "cyclofeat hidden effects 1"
KINDS = ("null", "single", "pair", "outside")
STRENGTHS = ("weak", "medium", "strong")
FIT_COUNTS = (0, 2, 4, 6, 0, 2, 4, 6)
HOLD_COUNTS = (0, 2, 4, 6, 1, 3, 5, 7)

# 400 nulls, a quarter of them decoys.
N_PLAIN_NULLS = 300
DECOYS = ("edges",) * 50 + ("speed", "load", "both", "assembly", "disc") * 10
# Eight singles of each effect; two more make 170.
_OF_EFFECT = ("weak", "weak", "weak", "medium", "medium", "medium", "strong", "strong")
_MORE = (("brake_rotor", "strong"), ("load_drift", "strong"))
N_PAIRS = 40
_OF_PAIR = (("medium", "medium"), ("weak", "strong"), ("medium", "medium"), ("strong", "medium"))
# At one speed and a prescribed load these effects hardly change the measured torque, so they are not used in
# pairs.
_NOT_IN_PAIRS = ("sleeve_friction", "bearing_friction", "clock_error")
N_OUTSIDE = 30
# The subset: every effect once, these six twice; seven pairs; these six from outside.
_TWICE = (
    "brake_rotor", "load_drift", "torque_meter_low_pass", "contact_damping_scale", "noise", "clearance",
)  # fmt: skip
_SUBSET_PAIRS = 7
_SUBSET_OUTSIDE = (
    "stick_slip_brake", "coupling_rattle", "clipping", "thermal_decay", "automatic_gain",
    "second_torsional_mode",
)  # fmt: skip


@dataclass(frozen=True)
class Row:
    """One parameter of one effect: its values in three strengths, and how a case varies them.

    ``scale`` is ``"linear"`` (the value times a factor), ``"sign"`` (the same with a random sign) or
    ``"factor"`` (a pure factor whose neutral value is 1: its logarithm is multiplied, with a random sign).
    The factor is log-uniform between 0.8 and 1.25, for each parameter of each case.
    """

    effect: str
    place: int
    parameter: str
    unit: str
    scale: str
    values: dict[str, float]


@dataclass(frozen=True)
class Case:
    """Recordings of one case, without the truth.

    ``X_fit`` (8, n_samples) and ``X_hold`` (8 or 0, n_samples) hold torque in Nm at 25.6 kHz, ``y_fit`` and
    ``y_hold`` the counts of worn lobes.
    """

    name: str
    X_fit: NDArray[np.float32]
    y_fit: NDArray[np.int64]
    X_hold: NDArray[np.float32]
    y_hold: NDArray[np.int64]
    sampling_rate: float = SAMPLING_RATE
    input_speed_hz: float = 500 / 60


@dataclass(frozen=True)
class _Definition:
    name: str
    kind: str
    number: int
    strengths: tuple[str, ...]
    effects: tuple[tuple[str, dict[str, float]], ...]
    decoy: str
    in_subset: bool


@cache
def rows_of(name: str) -> tuple[dict[str, str], ...]:
    """The rows of a committed table, as text."""
    with (HERE / name).open(encoding="utf-8", newline="") as file:
        return tuple(csv.DictReader(file))


@cache
def table(name: str) -> tuple[Row, ...]:
    """The rows of ``strengths.csv`` (the library's effects) or ``outside.csv``."""
    return tuple(
        Row(
            effect=row["effect"],
            place=int(row["place"]),
            parameter=row["parameter"],
            unit=row["unit"],
            scale=row["scale"],
            values={strength: float(row[strength]) for strength in STRENGTHS},
        )
        for row in rows_of(name)
    )


@cache
def tie_groups() -> tuple[frozenset[str], ...]:
    """Groups of effects of ``ties.csv`` that these recordings cannot separate."""
    return tuple(frozenset(row["effects"].split()) for row in rows_of("ties.csv"))


def effect_names(rows: Iterable[Row]) -> list[str]:
    """Names of the effects in a table, in its order."""
    return list(dict.fromkeys(row.effect for row in rows))


def places() -> dict[str, int]:
    """Place in the chain of every effect of both tables."""
    return {row.effect: row.place for row in (*table("strengths.csv"), *table("outside.csv"))}


def _theta(effect: str, strength: str, random: np.random.Generator) -> dict[str, float]:
    found = {}
    for row in (*table("strengths.csv"), *table("outside.csv")):
        if row.effect != effect:
            continue
        factor = float(np.exp(random.uniform(np.log(0.8), np.log(1.25))))
        sign = 1.0 if random.random() < 0.5 else -1.0
        value = row.values[strength]
        value = value ** (sign * factor) if row.scale == "factor" else value * factor
        if row.scale == "sign":
            value *= sign
        if row.parameter == "pulses_per_turn":
            value = row.values[strength]  # the number of teeth is an integer
        # Rounded as in the truth, so that the number does not change when it is read again.
        found[row.parameter] = float(f"{value:.6g}")
    return found


def _pairs() -> list[tuple[str, str]]:
    """Pairs of effects of different places that are not tied, in a fixed random order."""
    names = [name for name in effect_names(table("strengths.csv")) if name not in _NOT_IN_PAIRS]
    place = places()
    possible = [
        pair
        for pair in itertools.combinations(names, 2)
        if place[pair[0]] != place[pair[1]] and not any(set(pair) <= group for group in tie_groups())
    ]
    order = np.random.default_rng([SEED, 99]).permutation(len(possible))
    used: dict[str, int] = dict.fromkeys(names, 0)
    chosen: list[tuple[str, str]] = []
    # Limit the number of pairs per effect.
    most = -(-2 * N_PAIRS // len(names)) + 1
    for k in order:
        if len(chosen) < N_PAIRS and max(used[name] for name in possible[k]) < most:
            chosen.append(possible[k])
            for name in possible[k]:
                used[name] += 1
    return chosen


@cache
def definitions() -> dict[str, _Definition]:
    """All cases by name, in the order of the names, which is not related to the content."""
    plans: list[tuple[str, tuple[tuple[str, str], ...], str, bool]] = []
    for decoy in ("",) * N_PLAIN_NULLS + DECOYS:
        plans.append(("null", (), decoy, False))
    effects = effect_names(table("strengths.csv"))
    singles = [(effect, strength) for effect in effects for strength in _OF_EFFECT] + list(_MORE)
    wanted = {(effect, STRENGTHS[k % 3]) for k, effect in enumerate(effects)}
    wanted |= {(effect, STRENGTHS[(effects.index(effect) + 1) % 3]) for effect in _TWICE}
    for one in singles:
        plans.append(("single", (one,), "", one in wanted))
        wanted.discard(one)
    for k, pair in enumerate(_pairs()):
        both = tuple(zip(pair, _OF_PAIR[k % len(_OF_PAIR)], strict=True))
        plans.append(("pair", both, "", k < _SUBSET_PAIRS))
    others = effect_names(table("outside.csv"))
    shown = set(_SUBSET_OUTSIDE)
    for k in range(N_OUTSIDE):
        other, strength = others[k % len(others)], STRENGTHS[(k // len(others) + 1) % 3]
        plans.append(("outside", ((other, strength),), "", other in shown))
        shown.discard(other)
    found = {}
    for number, (kind, parts, decoy, in_subset) in enumerate(plans):
        random = np.random.default_rng([SEED, number, 2])
        name = "case_" + hashlib.sha256(f"{SEED} {number}".encode()).hexdigest()[:8]
        found[name] = _Definition(
            name=name,
            kind=kind,
            number=number,
            strengths=tuple(strength for _, strength in parts),
            effects=tuple((effect, _theta(effect, strength, random)) for effect, strength in parts),
            decoy=decoy,
            in_subset=in_subset,
        )
    if len(found) != len(plans):
        raise RuntimeError("two cases have one name")
    return dict(sorted(found.items()))


def case_names(kind: str | Sequence[str] | None = None, subset: int | None = None) -> list[str]:
    """Names of the cases.

    Parameters
    ----------
    kind : str or sequence of str, optional
        ``"null"``, ``"single"``, ``"pair"``, ``"outside"``, or several. Default: all.
    subset : 40, optional
        The stratified subset for the whole workflow: 27 singles over all effects and strengths, 7 pairs,
        6 from outside the library. It has no nulls.
    """
    kinds = KINDS if kind is None else (kind,) if isinstance(kind, str) else tuple(kind)
    for one in kinds:
        if one not in KINDS:
            raise ValueError(f"kind must be one of {KINDS}, got {one!r}")
    if subset not in (None, 40):
        raise ValueError(f"subset must be 40, or None for all cases, got {subset!r}")
    return [
        name
        for name, case in definitions().items()
        if case.kind in kinds and (subset is None or case.in_subset)
    ]


def make_case(name: str) -> Case:
    """Simulate the recordings of one case; the same name gives the same recordings.

    Parameters
    ----------
    name : str
        One of :func:`case_names`.
    """
    if name not in definitions():
        raise ValueError(f"name must be one of case_names(), got {name!r}")
    case = definitions()[name]
    hold = HOLD_COUNTS if case.kind != "null" else ()
    return Case(
        name=name,
        X_fit=make_recordings(name, 0, FIT_COUNTS),
        y_fit=np.array(FIT_COUNTS),
        X_hold=make_recordings(name, 1, hold),
        y_hold=np.array(hold, dtype=np.int64),
    )


def make_recordings(name: str, part: int, counts: Sequence[int]) -> NDArray[np.float32]:
    """Recordings of a case with these counts; another part of its random numbers gives others."""
    case = definitions()[name]
    common = np.random.default_rng([SEED, case.number, 3]).random(4).tolist()
    found = np.empty((len(counts), N_SAMPLES), dtype=np.float32)
    for i, count in enumerate(counts):
        nuisance, seed = nuisance_and_seed([SEED, case.number, part, i], decoy=case.decoy, common=common)
        found[i] = record(count, case.effects, seed, nuisance)
    return found


def truth_text() -> str:
    """Return the content of ``truth.json``: one line per case."""
    place = places()
    lines = []
    for name, case in definitions().items():
        said: dict[str, Any] = {
            "kind": case.kind,
            "effects": [
                {"id": effect, "place": place[effect], "strength": strength, "theta": theta}
                for (effect, theta), strength in zip(case.effects, case.strengths, strict=True)
            ],
            "decoy": case.decoy,
            "subset": case.in_subset,
        }
        lines.append(f"    {json.dumps(name)}: {json.dumps(said)}")
    head = f'  "format": {json.dumps(FORMAT)},\n  "seed": {SEED},\n  "cases": {{\n'
    return "{\n" + head + ",\n".join(lines) + "\n  }\n}\n"


def truth() -> dict[str, dict[str, Any]]:
    """The committed truth by case."""
    found: dict[str, dict[str, Any]] = json.loads((HERE / "truth.json").read_text(encoding="utf-8"))["cases"]
    return found


def write_truth() -> None:
    """Write ``truth.json`` and ``truth.sha256`` after a change of tables or definitions."""
    text = truth_text()
    (HERE / "truth.json").write_text(text, encoding="utf-8")
    digest = hashlib.sha256(text.encode()).hexdigest()
    (HERE / "truth.sha256").write_text(f"{digest}  truth.json\n", encoding="utf-8")
