"""A result beside the truth of its set, by groups of effects that may stand for each other."""

from __future__ import annotations

import json
import math
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from benchmarks.hidden_effects._sets import Definition, definitions, tie_groups
from benchmarks.hidden_effects._visible import SIGMA, visible
from cyclofeat.gap.posterior.answers import UNSEEN

FORMAT = "cyclofeat gap 2"
PRESENT, ABSENT, UNRESOLVED = "present", "absent", "unresolved"
_LIKELY, _SURE, _SURELY_NOT = 0.5, 0.95, 0.05


def group_of(effect: str) -> str:
    """Name of an effect's group: its members', or the effect's own."""
    return next((" or ".join(sorted(group)) for group in tie_groups() if effect in group), effect)


def grouped(effects: Iterable[str]) -> set[str]:
    return {group_of(effect) for effect in effects}


@dataclass(frozen=True)
class Answer:
    """A result with the truth beside it; ``seen`` are the effects that the oracle sees."""

    truth: Definition
    seen: frozenset[str]
    result: Mapping[str, Any] = field(repr=False)

    @property
    def true(self) -> set[str]:
        """The hidden effects."""
        return {name for name, _ in self.truth.hidden}

    @property
    def sizes(self) -> Mapping[str, Mapping[str, float]]:
        """The hidden effects' parameters."""
        return dict(self.truth.hidden)

    @property
    def inside(self) -> bool:
        """Whether the library has all hidden effects."""
        return self.truth.kind != "outside"

    @property
    def n_effects(self) -> int:
        return len(self.truth.effects)

    @property
    def n_conditions(self) -> int:
        return len(self.truth.conditions)

    @property
    def verdict(self) -> str | None:
        return self.result.get("verdict")

    @property
    def unknown(self) -> bool | None:
        return (self.result.get("remainder") or {}).get("unexplained")

    @cached_property
    def effects(self) -> dict[str, Mapping[str, Any]]:
        """What the result says of each effect."""
        return {one["id"]: one for one in self.result["effects"] if one["probability"] is not None}

    @cached_property
    def named(self) -> set[str]:
        """Effects with a probability of at least one half."""
        return {name for name, one in self.effects.items() if one["probability"] >= _LIKELY}

    @cached_property
    def named_groups(self) -> set[str]:
        """Groups whose members' probabilities add up to one half: of look-alikes each may have less."""
        together: dict[str, float] = {}
        for name, one in self.effects.items():
            together[group_of(name)] = together.get(group_of(name), 0.0) + one["probability"]
        return {group for group, p in together.items() if p >= _LIKELY}

    def claims(self) -> dict[str, str]:
        """Answer for each group: present if one of it is, absent if all are."""
        found: dict[str, set[str]] = {}
        for name, one in self.effects.items():
            p = one["probability"]
            said = PRESENT if p >= _SURE else ABSENT if p <= _SURELY_NOT else UNRESOLVED
            found.setdefault(group_of(name), set()).add(said)
        return {
            group: PRESENT if PRESENT in said else ABSENT if said == {ABSENT} else UNRESOLVED
            for group, said in found.items()
        }

    def perhaps_seen(self) -> set[str]:
        """Unresolved groups of which an effect may be there and large enough to be seen."""
        large = {
            group_of(name) for name, one in self.effects.items()
            if one["probability"] > _SURELY_NOT and not _number(one.get("visible")) <= UNSEEN
        }  # fmt: skip
        return {group for group, said in self.claims().items() if said == UNRESOLVED} & large

    @property
    def wrong_claim(self) -> bool:
        """Whether an absent group is said to be present, or one that the oracle sees to be absent."""
        true, seen = grouped(self.true), grouped(self.seen)
        return any(
            (said == PRESENT and group not in true) or (said == ABSENT and group in seen)
            for group, said in self.claims().items()
        )

    @property
    def right(self) -> bool:
        """Whether all groups that the oracle sees are named and no absent one is."""
        return grouped(self.seen) <= self.named_groups <= grouped(self.true)

    @property
    def exact(self) -> bool:
        """The same without ties."""
        return self.seen <= self.named <= self.true

    def told_apart(self, *sides: Collection[str]) -> bool | None:
        """Whether of these sides the true ones are named, None if the oracle sees none of their effects.

        A side is one effect, or look-alikes whose probabilities are added.
        """

        def probability(side: Collection[str]) -> float:
            return sum(self.effects[name]["probability"] for name in side if name in self.effects)

        named = [probability(side) >= _LIKELY for side in sides]
        true, seen = ([bool(of & set(side)) for side in sides] for of in (self.true, self.seen))
        if not any(seen):
            return None
        return all(a <= b <= c for a, b, c in zip(seen, named, true, strict=True))


def _number(value: float | None) -> float:
    return math.nan if value is None else value


def read_answers(folder: Path) -> list[Answer]:
    """Read one ``<set>.json`` per set; those without a file are left out."""
    found = []
    for name in definitions():
        path = folder / f"{name}.json"
        if path.exists():
            result = json.loads(path.read_text(encoding="utf-8"))
            if result.get("format") != FORMAT:
                raise ValueError(f'{path}: format must be "{FORMAT}", got {result.get("format")!r}')
            found.append(result | {"set": name})
    if not found:
        raise ValueError(f"{folder}: holds no <set>.json")
    return answers({result["set"]: result for result in found})


def answers(results: Mapping[str, Mapping[str, Any]]) -> list[Answer]:
    """Results by set, with the truth. An effect whose significance is not known counts as seen."""
    sigmas = visible()
    found = []
    for name, result in results.items():
        truth = definitions()[name]
        seen = frozenset(
            effect for effect, _ in truth.hidden if not sigmas.get(name, {}).get(effect, SIGMA) < SIGMA
        )
        found.append(Answer(truth, seen, result))
    return found
