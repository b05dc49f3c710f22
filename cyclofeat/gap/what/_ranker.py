"""Ranking of the effects that could explain a disagreement, with their look-alikes."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cyclofeat._base.arguments import different_names
from cyclofeat._base.checks import whole
from cyclofeat.gap.comparison import Comparison
from cyclofeat.gap.summaries import signed_log
from cyclofeat.gap.what._learned import FOLDS, Learned, sharpened
from cyclofeat.gap.what._table import EffectTable, make_table
from cyclofeat.gap.where import LocatedGap
from cyclofeat.simulators import Effect, Rig, effect_library

Float = NDArray[np.float64]

_FEWEST_DRAWS = 3  # successful draws with which an effect can be learned
_REFINED = 20  # nearest pairs of draws, whose distance is computed with the decorrelated cells too


@dataclass(frozen=True)
class RankedEffect:
    """One row of a :class:`Ranking`: an effect and its probability before any fit.

    Attributes
    ----------
    effect_id : str
    summary : str
        Description in one line.
    probability : float
        Given that one effect of the library is missing.
    look_alikes : tuple of str
        Effects that such recordings cannot distinguish from it.
    next_measurement : str
        Measurement that would distinguish it from them.
    """

    effect_id: str
    summary: str
    probability: float
    look_alikes: tuple[str, ...]
    next_measurement: str


@dataclass(frozen=True)
class RankedPair:
    """Two effects with their probability.

    Attributes
    ----------
    effects : tuple of Effect
        With the parameters of the draws that come nearest.
    probability : float
        Among all pairs: a weight by distance, to choose the pairs that are fitted.
    """

    effects: tuple[Effect, ...]
    probability: float

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the effects."""
        return tuple(effect.effect_id for effect in self.effects)


@dataclass(frozen=True)
class Ranking:
    """Effects that could explain one disagreement.

    Attributes
    ----------
    rows : tuple of RankedEffect
        Most probable first.
    conformal_p : dict from str to float
        How typical the disagreement is of each effect of the library.
    unknown : bool
        Whether it is typical of no effect that was considered.
    """

    rows: tuple[RankedEffect, ...]
    conformal_p: dict[str, float]
    unknown: bool


@dataclass(frozen=True)
class EffectRanker:
    """Ranker of effects by what they do to the summaries, made by :func:`learn_effects`.

    Attributes
    ----------
    comparison : Comparison
    table : EffectTable
    in_model : tuple of str
        Effects of the default library that the model already has and cannot have twice. They are not
        considered.
    unavailable : tuple of str
        Other effects of the default library that this model cannot have, or not at this sampling rate.
    alpha : float
        Level of the refusal, and of the gate: an effect is learned from the sets in which it would be found.
    """

    comparison: Comparison
    table: EffectTable = field(repr=False)
    in_model: tuple[str, ...]
    unavailable: tuple[str, ...]
    alpha: float
    _learned: dict[int, Learned] = field(default_factory=dict, repr=False, compare=False)

    @property
    def names(self) -> tuple[str, ...]:
        """Effects that are considered."""
        return self.table.names

    def learned(self, n_recordings: int) -> Learned:
        """Return the classifier for comparisons of ``n_recordings`` recordings, trained at the first call."""
        if n_recordings not in self._learned:
            state, n_jobs = self.comparison.random_state, self.comparison.n_jobs
            self._learned[n_recordings] = Learned(self.table, n_recordings, self.alpha, state, n_jobs)
        return self._learned[n_recordings]

    def rank(self, located: LocatedGap, without: Sequence[str] = ()) -> Ranking:
        """Rank the effects that could explain a disagreement.

        Parameters
        ----------
        located : LocatedGap
            Under the same conditions.
        without : sequence of str
            Effects that are not considered: those that the model already has.

        Returns
        -------
        Ranking

        Raises
        ------
        ValueError
            If ``located`` is of other conditions, or ``without`` leaves no effect.
        """
        n, deviation = located.measured.n_recordings, self._deviation(located)
        learned = self.learned(n)
        features = learned.scale.features(*deviation, n)[np.newaxis]
        votes = sharpened(learned.forest.predict_proba(features), learned.temperature)[0]
        considered = np.array([name not in without for name in self.names])
        if not considered.any():
            raise ValueError(f"without must leave an effect to name, got all of {', '.join(self.names)}")
        votes = np.where(considered, votes, 0.0) / votes[considered].sum()
        p = learned.typical.conformal_p(features)[0]
        kinds = effect_library()
        rows = tuple(
            RankedEffect(
                effect_id=self.names[k],
                summary=kinds[self.names[k]].summary(),
                probability=float(votes[k]),
                look_alikes=learned.look_alikes(self.names[k]),
                next_measurement=kinds[self.names[k]].separated_by,
            )
            for k in np.argsort(-votes, kind="stable")
            if considered[k]
        )
        conformal_p = dict(zip(self.names, p.tolist(), strict=True))
        return Ranking(rows, conformal_p, bool(p[considered].max() <= self.alpha))

    def nearest(self, name: str, located: LocatedGap, n_nearest: int = 1) -> list[Effect]:
        """Return the draws of an effect that change the summaries most like a disagreement, nearest first."""
        n = located.measured.n_recordings
        scale = self.learned(n).scale
        wanted, _ = self._deviation(located)
        vectors, shifts = self._draws(name)
        distance = np.linalg.norm(scale.of_means(shifts, n) - scale.of_means(wanted, n), axis=1)
        kind = effect_library()[name]()
        return [kind.from_vector(vector) for vector in vectors[np.argsort(distance)[:n_nearest]]]

    def nearest_pairs(self, located: LocatedGap) -> list[RankedPair]:
        """Return all pairs of effects, each with the two draws that together come nearest to a disagreement.

        Two changes of one cell are added; levels that both draws raise are added as powers.
        """
        n = located.measured.n_recordings
        scale = self.learned(n).scale
        wanted, _ = self._deviation(located)
        target = scale.of_means(wanted, n)
        in_db = np.array([cell.unit == "dB" for cell in located.cells])[self._in_table(located)]
        in_errors = (scale.spread / np.sqrt(n)).astype(np.float32)
        coarse_target = target[: in_db.size].astype(np.float32)
        # Single precision: this loop takes most of the time.
        draws = {}
        for name in self.names:
            vectors, shifts = self._draws(name)
            if len(vectors):
                draws[name] = (vectors, shifts.astype(np.float32))
        kinds = effect_library()
        nearest = []
        for names in itertools.combinations(draws, 2):
            (vectors_a, a), (vectors_b, b) = (draws[name] for name in names)
            together = _together(a, b, in_db).reshape(-1, in_db.size)
            coarse = np.linalg.norm(signed_log(together / in_errors) - coarse_target, axis=1)
            near = np.argsort(coarse)[:_REFINED]
            distance = np.linalg.norm(scale.of_means(together[near], n) - target, axis=1)
            i, k = divmod(int(near[distance.argmin()]), len(b))
            best = zip(names, (vectors_a[i], vectors_b[k]), strict=True)
            effects = tuple(kinds[name]().from_vector(vector) for name, vector in best)
            nearest.append((float(distance.min()), effects))
        nearest.sort(key=lambda one: one[0])
        odds = np.exp([nearest[0][0] - distance for distance, _ in nearest])
        odds = odds / odds.sum()
        return [RankedPair(effects, float(share)) for (_, effects), share in zip(nearest, odds, strict=True)]

    def _deviation(self, located: LocatedGap) -> tuple[Float, Float]:
        """Deviation of the measured means from the simulated ones, and the variances over recordings."""
        columns = self._in_table(located)
        measured, simulated = (values[:, columns] for values in located.centred_sets())
        return measured.mean(axis=0) - simulated.mean(axis=0), measured.var(axis=0, ddof=1)

    def _draws(self, name: str) -> tuple[Float, Float]:
        """Parameters and mean changes of an effect's draws, without those whose simulation failed."""
        simulated = self.table.simulated(name)
        return self.table.vectors[name][simulated], self.table.shifts(name)[simulated]

    def _in_table(self, located: LocatedGap) -> NDArray[np.bool_]:
        """Cells that the table has: all but those of the tachometer."""
        columns = np.array(["tachometer" not in cell.name for cell in located.cells])
        n_cells = self.table.null.shape[1]
        if located.comparison.conditions != self.comparison.conditions or columns.sum() != n_cells:
            raise ValueError(
                f"located must be of the ranker's {self.comparison.conditions} and its {n_cells} cells, got "
                f"{located.comparison.conditions} and {columns.sum()}"
            )
        return columns


def learn_effects(
    comparison: Comparison,
    *,
    library: Sequence[str] | None = None,
    n_draws: int = 60,
    n_simulations: int = 4,
    n_null: int = 160,
    alpha: float = 0.05,
) -> EffectRanker:
    """Simulate each effect of the library many times, and learn what it does to the summaries.

    Parameters
    ----------
    comparison : Comparison
    library : sequence of str, optional
        Effects of :func:`cyclofeat.simulators.effect_library` that are considered. Default: all that the
        model can have.
    n_draws : int, default=60
        Sets of parameters per effect, drawn from their priors.
    n_simulations : int, default=4
        Recordings of each set.
    n_null : int, default=160
        Recordings without any effect.
    alpha : float, default=0.05
        Level of the refusal (:attr:`Ranking.unknown`).

    Returns
    -------
    EffectRanker

    Raises
    ------
    ValueError
        If the library names an unknown effect, or one that the model cannot have.

    Notes
    -----
    The deviation of a set of n recordings is the mean change that the effect causes in the same recordings,
    plus the mean of n random residuals; so one table serves any number of recordings. The features are
    deviations of means (plain and decorrelated) and of spreads, over their standard errors, on a logarithmic
    scale with sign. A Gaussian per effect on the leading components gives a conformal p. If the p of every
    effect is at most alpha, the missing effect is taken to be outside the library. The probabilities are
    conditional on the library; two look-alikes share them, so that each may stay below one half.

    Examples
    --------
    >>> comparison = Comparison(sampling_rate=25_600)
    >>> learn_effects(comparison, library=["hum", "offset"], n_draws=5, n_null=16).names
    ('hum', 'offset')
    """
    whole("n_draws", n_draws, FOLDS)
    whole("n_simulations", n_simulations, 2)
    whole("n_null", n_null, 16)
    names = _names(comparison.rig, library)
    in_model = _in_model(comparison.rig) if library is None else ()
    table = make_table(comparison, names, n_draws=n_draws, n_recordings=n_simulations, n_null=n_null)
    made = [name for name in names if table.simulated(name).size >= _FEWEST_DRAWS]
    unavailable = tuple(name for name in names if name not in made)
    if not made or (unavailable and library is not None):
        raise ValueError(
            f"library must hold effects that this model and rate can have, got {', '.join(unavailable)}"
        )
    return EffectRanker(comparison, table.of(made), in_model, unavailable, alpha)


def _names(rig: Rig, library: Sequence[str] | None) -> list[str]:
    if library is not None:
        return list(different_names(library, effect_library(), "library"))
    return [name for name in effect_library() if name not in _in_model(rig)]


def _in_model(rig: Rig) -> tuple[str, ...]:
    """Effects of the rig that it cannot have twice."""
    return ("brake_rotor",) if rig.has_brake else ()


def _together(first: NDArray[Any], second: NDArray[Any], in_db: NDArray[np.bool_]) -> NDArray[Any]:
    """Change of the cells by two effects together, from the changes by each: (n_first, n_second, n_cells)."""
    a, b = first[:, None], second[None]
    power = 10 ** (a / 10) + 10 ** (b / 10) - 1
    as_powers = in_db & (a > 0) & (b > 0)
    return np.where(as_powers, 10 * np.log10(np.maximum(power, 1)), a + b)
