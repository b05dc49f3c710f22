"""Search for the effects that predict held-out discs."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cyclofeat.gap.published.rigs import (
    DenseRigs,
    PublishedSettings,
    Set,
    SimulatedRigs,
    interpolate_rigs,
    kind_of,
    simulated_ones,
)
from cyclofeat.gap.published.scores import crps, sign_flip_p, student_samples
from cyclofeat.simulators import known_effects
from cyclofeat.simulators.effects.library import look_alikes

Float = NDArray[np.float64]

_TOLERANCE = 0.5  # increase of the score, in spreads over the discs, that reduces the weight of a rig to 1/e
_SAMPLES = 400


@dataclass(frozen=True)
class Step:
    """One effect that was named.

    The score is the mean CRPS of discs left out, in spreads over the discs, without and with it; ``p`` the
    one-sided sign-flip p over the discs of that improvement, of this candidate alone. ``look_alikes`` do as
    well, as far as these discs can tell: first effects whose torque is the same to these statistics (a drift
    of sensor or load; an offset, gain or set-point). ``next_measurement`` would tell it from them.
    """

    effect: str
    score_before: float
    score_after: float
    p: float
    look_alikes: tuple[str, ...]
    next_measurement: str


@dataclass(frozen=True)
class Tried:
    """An effect that was scored.

    ``effect`` may be ``"nothing"``, or ``"constant"``: the mean of the other discs. The score is that of
    :class:`Step`, smaller is better; ``p`` the one-sided sign-flip p of the improvement over what is named
    already, NaN where none was asked for.
    """

    effect: str
    score: float
    p: float = float("nan")


class Search:
    """Scores of sets of effects on held-out discs, and a greedy search over the sets.

    ``measured`` is (n_discs, 4) as of :func:`to_statistics`; the unit of the scores, ``scales`` (4,), is the
    spread over the discs.
    """

    def __init__(
        self, rigs: SimulatedRigs, measured: Float, library: Set, settings: PublishedSettings
    ) -> None:
        self.rigs, self.measured, self.library, self.settings = rigs, measured, library, settings
        self.scales = measured.std(axis=0, ddof=1)
        if (self.scales <= 0).any():
            raise ValueError("statistics must differ between discs: their spread is the scale")
        self.random_state = rigs.random_state
        # Look-alikes have the same influence on these statistics: the search uses the last in the chain.
        self._same_torque = [
            [name for name in reversed(tuple(known_effects())) if name in group] for group in look_alikes()
        ]
        self._scores: dict[tuple[Set, tuple[int, ...]], Float] = {}
        self._fits: dict[Set, DenseRigs] = {}

    def name(self, discs: tuple[int, ...]) -> tuple[Set, tuple[Step, ...], tuple[str, ...]]:
        """Search greedily with backward deletion; return the effects, the steps, and the deleted effects."""
        named: Set = ()
        steps: list[Step] = []
        dropped: list[str] = []
        while len(named) < self.settings.max_effects:
            step = self._best_step(named, tuple(dropped), discs)
            if step is None:
                break
            steps.append(step)
            named = self._order_effects((*named, step.effect))
            for name in [other for other in named if other != step.effect]:
                less = tuple(other for other in named if other != name)
                if self._step_p(less, named, discs) > self.settings.alpha:
                    named = less
                    dropped.append(name)
        return named, tuple(step for step in steps if step.effect in named), tuple(dropped)

    def ranking(self, discs: tuple[int, ...]) -> tuple[Tried, ...]:
        """Single effects, ``"nothing"`` and ``"constant"``, best first."""
        scores = {name: self.score((name,), discs) for name in self.library}
        others = [self.measured[[other for other in discs if other != disc]] for disc in discs]
        by_mean = [
            self._score_disc(student_samples(rows, _SAMPLES), disc)
            for rows, disc in zip(others, discs, strict=True)
        ]
        scores |= {"nothing": self.score((), discs), "constant": np.array(by_mean)}
        rows = (Tried(name, float(values.mean())) for name, values in scores.items())
        return tuple(sorted(rows, key=lambda row: row.score))

    def rejected_effects(self, named: Set, discs: tuple[int, ...]) -> tuple[Tried, ...]:
        """Return the effects that were not added, best first."""
        if len(named) >= self.settings.max_effects:
            return ()
        rows = []
        for name in self._candidate_effects(named):
            more = self._order_effects((*named, name))
            rows.append(Tried(name, float(self.score(more, discs).mean()), self._step_p(named, more, discs)))
        return tuple(sorted(rows, key=lambda row: row.score))

    def score(self, key: Set, discs: tuple[int, ...]) -> Float:
        """CRPS over spread of each disc, predicted from the others, shape (n_discs,)."""
        if (key, discs) not in self._scores:
            scores = []
            for disc in discs:
                others = tuple(other for other in discs if other != disc)
                scores.append(self._score_disc(self.sample(key, others, disc)[0], disc))
            self._scores[key, discs] = np.array(scores)
        return self._scores[key, discs]

    def weighted_rigs(self, key: Set) -> DenseRigs:
        """Return the interpolated rigs, with their weights by each disc."""
        if key not in self._fits:
            dense = interpolate_rigs(self.rigs.table(key), self.rigs.bounds(key), self.random_state)
            samples = dense.middle[:, :, np.newaxis] + dense.noise[:, np.newaxis]
            loss = crps(np.moveaxis(samples, 2, -1), self.measured) / self.scales
            self._fits[key] = dataclasses.replace(dense, log_weight=-loss.mean(axis=-1) / _TOLERANCE)
        return self._fits[key]

    def weights(self, key: Set, discs: Sequence[int]) -> Float:
        """Return the weights of the rigs by some of the discs; their sum is 1."""
        total = self.weighted_rigs(key).log_weight[:, list(discs)].sum(axis=1)
        weights = np.exp(total - total.max())
        return np.asarray(weights / weights.sum())

    def sample(self, key: Set, discs: Sequence[int], disc: int) -> tuple[Float, NDArray[np.intp]]:
        """Predictions of one disc by the rigs weighted with others, (n, 4), and the rig of each."""
        dense = self.weighted_rigs(key)
        random = np.random.default_rng([self.random_state, disc])
        # Systematic sampling: the number of samples of a rig is its weight times n, rounded.
        at = (np.arange(_SAMPLES) + random.random()) / _SAMPLES
        rigs = np.searchsorted(np.cumsum(self.weights(key, discs)), at).clip(max=len(dense.middle) - 1)
        error = dense.noise[rigs, random.integers(dense.noise.shape[1], size=_SAMPLES)]
        return dense.middle[rigs, disc] + error, rigs

    def _best_step(self, named: Set, dropped: Set, discs: tuple[int, ...]) -> Step | None:
        """Return the effect that improves the scores most, or None if none does significantly."""
        alpha, before = self.settings.alpha, self.score(named, discs)
        scores = {
            name: self.score(self._order_effects((*named, name)), discs)
            for name in self._candidate_effects(named)
            if name not in dropped
        }
        if not scores:
            return None
        order = sorted(scores, key=lambda name: float(scores[name].mean()))
        best = order[0]
        if sign_flip_p(before - scores[best], "greater") > alpha or scores[best].mean() >= before.mean():
            return None
        alike = [
            name
            for name in order[1:]
            if sign_flip_p(before - scores[name], "greater") <= alpha
            and sign_flip_p(scores[name] - scores[best]) > alpha
        ]
        chosen = next((group[0] for group in self._same_torque if best in group and group[0] in alike), best)
        # They are physically equivalent here, even if few rigs of one of them were simulated.
        same = [
            name for group in self._same_torque if chosen in group for name in group if name in self.library
        ]
        return Step(
            effect=chosen,
            score_before=float(before.mean()),
            score_after=float(scores[chosen].mean()),
            p=sign_flip_p(before - scores[chosen], "greater"),
            look_alikes=tuple(dict.fromkeys(n for n in (best, *same, *alike) if n != chosen)),
            next_measurement=kind_of(chosen).separated_by,
        )

    def _step_p(self, less: Set, more: Set, discs: tuple[int, ...]) -> float:
        """Return the one-sided p of the hypothesis that the larger set does not predict better."""
        return sign_flip_p(self.score(less, discs) - self.score(more, discs), "greater")

    def _candidate_effects(self, named: Set) -> list[str]:
        """Return the effects that may be added: one of each group, and one that changes the gearbox's motion.

        Each set of those needs simulations of its own; effects of the meter are applied to stored records.
        """
        return [
            name
            for name in self.library
            if name not in named
            and not (simulated_ones((name,)) and simulated_ones(named))
            and not any(name in group and set(group) & set(named) for group in self._same_torque)
        ]

    def _order_effects(self, names: Iterable[str]) -> Set:
        chosen = set(names)
        return tuple(name for name in self.library if name in chosen)

    def _score_disc(self, sample: Float, disc: int) -> float:
        return float(np.mean(crps(sample.T, self.measured[disc]) / self.scales))
