"""Missing effects of a simulator: what recordings left out of the fit need, one addition at a time."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy import stats
from scipy.special import expit

from cyclofeat._base.displays import data_frame
from cyclofeat._base.quantities import number_of, probability_text
from cyclofeat.gap.posterior.answers import ABSENT, NAMED, PRESENT, State, state_of

from .problem import Array, Rig, Session
from .sizes import RESOLUTION, Fit, descend, fit_sizes, make_rig

if TYPE_CHECKING:
    import pandas as pd

Names = frozenset[str]
LARGEST_SET = 6


class Size(NamedTuple):
    """Size of a parameter, with its 90 % interval and unit."""

    value: float
    low: float
    high: float
    unit: str


@dataclass(frozen=True)
class Explanation:
    """Answer of the engine.

    `order`: effects in the order of addition, a removal with a minus; `probabilities`: that an effect is
    missing; `ties`: pairs of which one is missing (0.95), though neither is on its own; `rig`: the named
    effects with sizes; `sizes`: with intervals; `remainder`: root mean square of the deviations of each
    quantity in floors, without and with the effects, (2, n_blocks).
    """

    order: tuple[str, ...]
    probabilities: Mapping[str, float]
    ties: Sequence[Names]
    rig: Rig
    sizes: Mapping[str, Mapping[str, Size]]
    remainder: Array

    def state(self, effect: str) -> State:
        """Return the word for an effect's probability."""
        return state_of(self.probabilities[effect])

    def to_frame(self) -> pd.DataFrame:
        """Return probability, state and sizes of each effect, the most probable first; needs pandas."""
        rows = [
            {"effect": name, "probability": p, "state": self.state(name), "size": self.describe_sizes(name)}
            for name, p in sorted(self.probabilities.items(), key=lambda row: -row[1])
        ]
        return data_frame(rows)

    def __str__(self) -> str:
        texts = {
            name: f"{self.state(name)} ({probability_text(p)})" for name, p in self.probabilities.items()
        }
        lines = [f"{name}: {text}; {self.describe_sizes(name)}".rstrip("; ") for name, text in texts.items()]
        shown = [line for name, line in zip(texts, lines, strict=True) if self.probabilities[name] > ABSENT]
        hidden = len(lines) - len(shown)
        return "\n".join([*shown, *([f"{number_of(hidden, 'other effect')} not missing"] if hidden else [])])

    def describe_sizes(self, effect: str) -> str:
        """Return the sizes of an effect with their intervals in words; nothing for one that is not named."""
        return "; ".join(
            f"{key.replace('_', ' ')} {x.value:.3g} ({x.low:.3g} to {x.high:.3g}) {x.unit}".strip()
            for key, x in self.sizes.get(effect, {}).items()
        )


class _Search:
    """Sets of effects of a session, each fitted once and scored once on recordings left out."""

    def __init__(self, session: Session) -> None:
        self.session, self.effects = session, session.problem.effects
        self.optional = tuple(name for name, effect in self.effects.items() if not effect.always)
        self.fits: dict[Names, Fit] = {}
        self.left_out: dict[Names, list[tuple[float, Array]]] = {}

    def possible(self, present: Names) -> bool:
        """Return whether effects stand beside what they refine, without what they exclude, and are few."""
        effects = [self.effects[name] for name in present]
        return len(present) <= LARGEST_SET and all(
            (not effect.refines or present & {*effect.refines}) and not present & {*effect.excludes}
            for effect in effects
        )

    def without(self, present: Names, effect: str) -> Names:
        """Return a set without an effect, and without what refined it alone."""
        smaller = present - {effect}
        while not self.possible(smaller):
            smaller = frozenset(
                name for name in smaller if self.possible(smaller & {name, *self.effects[name].refines})
            )
        return smaller

    def fit(self, present: Names) -> Fit:
        """Fit a set, starting from the best two sets that differ from it by one effect."""
        if present not in self.fits:
            near = [fit for other, fit in self.fits.items() if len(other ^ present) == 1]
            names = [name for name, effect in self.effects.items() if effect.always or name in present]
            self.fits[present] = fit_sizes(self.session, names, sorted(near, key=lambda fit: fit.loss)[:2])
        return self.fits[present]

    def predict(self, present: Names) -> list[tuple[float, Array]]:
        """Return, for each recording, its loss by a fit to the others, and that fit's sizes."""
        if present not in self.left_out:
            fit, self.left_out[present] = self.fit(present), []
            for k in range(len(self.session.measured)):
                x = descend(self.session.without(k), fit.axes, fit.x).x
                losses = self.session.losses(self.session.deviations([make_rig(fit.axes, x)])[0])
                self.left_out[present].append((losses[k], x))
        return self.left_out[present]

    def probability(self, first: Names, second: Names) -> float:
        """Return the probability of one set against another.

        The odds are those of Student's t of the gains over recordings left out, times the prior odds, one to
        the number of effects for each effect. A larger set that fits no better needs no fits to the others.
        """
        more, less = self.fit(first), self.fit(second)
        if first > second and less.loss - more.loss < RESOLUTION:
            gains = less.losses - more.losses
        else:
            gains = np.array(
                [b - a for (a, _), (b, _) in zip(self.predict(first), self.predict(second), strict=True)]
            )
        t = gains.mean() / max(gains.std(ddof=1) / math.sqrt(len(gains)), RESOLUTION)
        odds = stats.t.logcdf(t, len(gains) - 1) - stats.t.logsf(t, len(gains) - 1)
        return float(expit(odds - (len(first) - len(second)) * math.log(len(self.optional))))

    def missing(self, present: Names, effects: Names) -> float:
        """Return the probability that some of the effects are missing.

        The named set is compared with the most probable of the fitted sets beside it (one effect less, more
        or replaced) that has some of them where it has none, or none where it has some.
        """
        has = bool(present & effects)
        beside = {self.without(present, name) for name in present & effects}
        beside |= {
            names for names in self.fits if abs(len(names) - len(present)) < 2 and len(names ^ present) < 3
        }
        other = max((self.probability(n, present) for n in beside if bool(n & effects) != has), default=0.0)
        return 1 - other if has else other

    def additions(self, present: Names) -> list[Names]:
        """Return the probable sets with one effect more, the best fitting first."""
        larger = filter(self.possible, (present | {name} for name in self.optional if name not in present))
        return sorted(
            (names for names in larger if self.probability(names, present) >= NAMED),
            key=lambda names: self.fit(names).loss,
        )

    def improve(self, present: Names, rivals: Sequence[str]) -> Names:
        """Return the set with effects replaced by better rivals, and without those that it does not need."""
        for name, rival in itertools.product(sorted(present), rivals):
            other = self.without(present, name) | {rival}
            if len(other) == len(present) and self.possible(other) and self.probability(other, present) > 0.5:
                present = other
        for name in sorted(present):
            smaller = self.without(present, name)
            if smaller < present and self.probability(present, smaller) < 0.5:
                present = smaller
        return present

    def sizes(self, present: Names) -> dict[str, dict[str, Size]]:
        """Return sizes with 90 % intervals, by the jackknife over recordings."""
        fit, others = self.fit(present), np.array([x for _, x in self.predict(present)])
        n = len(others)
        half = stats.t.ppf(0.95, n - 1) * np.sqrt((n - 1) / n * ((others - others.mean(0)) ** 2).sum(0))
        table: dict[str, dict[str, Size]] = {}
        for axis, x, h in zip(fit.axes, fit.x, half, strict=True):
            value, low, high = (axis.value(y) for y in np.clip([x, x - h, x + h], 0, 1))
            table.setdefault(axis.effect, {})[axis.name] = Size(value, low, high, axis.parameter.unit)
        return table


def explain(session: Session) -> Explanation:
    """Find which effects a simulator lacks, how large they are, and what stays unexplained.

    Recordings, at least three, are the independent units: an effect is named if recordings left out of the
    fit are predicted better with it, by Student's t of their gains. How many cells they have does not matter.
    """
    if len(session.measured) < 3:
        raise ValueError(f"session must have at least 3 recordings, got {len(session.measured)}")
    search = _Search(session)
    present: Names = frozenset()
    order: list[str] = []
    rivals: list[str] = []
    visited: set[Names] = set()
    while present not in visited:
        visited.add(present)
        probable = search.additions(present)
        rivals += [name for names in probable for name in names - present]
        larger = next(iter(probable), present)
        better = search.improve(larger, rivals)
        for before, after in ((present, larger), (larger, better)):
            order += [*sorted(after - before), *(f"-{name}" for name in sorted(before - after))]
        present = better
    probabilities = {name: search.missing(present, frozenset({name})) for name in search.optional}
    undecided = [name for name, p in probabilities.items() if ABSENT <= p < PRESENT]
    pairs = map(frozenset, itertools.combinations(undecided, 2))
    rigs = [make_rig(fit.axes, fit.x) for fit in (search.fit(frozenset()), search.fit(present))]
    return Explanation(
        order=tuple(order),
        probabilities=probabilities,
        ties=[pair for pair in pairs if not pair <= present and search.missing(present, pair) >= PRESENT],
        rig=rigs[1],
        sizes=search.sizes(present),
        remainder=np.sqrt(session.mean_squares(session.deviations(rigs))[0].mean(1)),
    )
