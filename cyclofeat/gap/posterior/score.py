"""Score of a posterior on simulated rigs that it has not seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from cyclofeat.gap.posterior.answers import NAMED
from cyclofeat.gap.posterior.effect_posterior import EffectPosterior
from cyclofeat.gap.world.rigs import Rigs
from cyclofeat.simulators.effects.library import look_alikes

Float = NDArray[np.float64]
Flags = NDArray[np.bool_]

_BINS = 15


@dataclass(frozen=True)
class PosteriorScore:
    """Shares of right answers of a posterior."""

    n_rigs: int
    # Of the effects named with a probability above one half. One that was not learned is never named.
    precision: float
    recall: float
    # Share of the rigs whose effects are named exactly; with ties, one may be named for another of its group.
    sets_right: float
    sets_right_with_ties: float
    # Mean distance of probabilities, in 15 bins, from the shares of the rigs that have the effect; of effects
    # that the posterior has learned.
    calibration_error: float
    coverage: dict[str, float] = field(repr=False)  # share of true sizes in the 90 % interval, by parameter
    effect_recall: dict[str, float] = field(repr=False)  # by effect; NaN where it is absent
    # Probability of each effect in each rig, (n_rigs, n_effects); NaN where it is not learned.
    probabilities: Float = field(repr=False, compare=False)


def score_posterior(
    posterior: EffectPosterior, rigs: Rigs, *, counts: bool = True, tachometer: bool = False
) -> PosteriorScore:
    """Score a posterior on simulated rigs of machines that it was not fitted to.

    ``counts`` and ``tachometer`` state whether they are known.
    """
    sessions = [rigs.session(k, counts=counts, tachometer=tachometer) for k in range(len(rigs))]
    probabilities = posterior.predict_proba(sessions)
    learned = np.isfinite(probabilities)
    present, named = rigs.present, learned & (probabilities > NAMED)
    tied = np.all(_join_groups(named, rigs.names) == _join_groups(present, rigs.names), axis=1)
    right = named & present
    logarithmic, quantiles = np.array(rigs.logarithmic), posterior.predict_quantiles(sessions)
    true = np.where(logarithmic, np.exp(np.where(logarithmic, rigs.sizes, 0.0)), rigs.sizes)
    inside = (quantiles[:, :, 0] <= true) & (true <= quantiles[:, :, -1])
    having = np.isfinite(rigs.sizes)
    coverage = {
        name: float(inside[having[:, k], k].mean())
        for k, name in enumerate(rigs.size_names)
        if np.isfinite(quantiles[:, k]).all() and having[:, k].any()
    }
    return PosteriorScore(
        n_rigs=len(rigs),
        precision=_ratio_or_nan(right.sum(), named.sum()),
        recall=_ratio_or_nan(right.sum(), present.sum()),
        sets_right=float(np.all(named == present, axis=1).mean()),
        sets_right_with_ties=float(tied.mean()),
        calibration_error=calibration_error(probabilities[learned], present[learned]),
        coverage=coverage,
        effect_recall={
            name: _ratio_or_nan(few, many)
            for name, few, many in zip(rigs.names, right.sum(axis=0), present.sum(axis=0), strict=True)
        },
        probabilities=probabilities,
    )


def calibration_error(probabilities: Float, present: Flags) -> float:
    """Return the mean distance of probabilities from shares, over bins weighted by their number of cases."""
    bins = np.minimum((probabilities * _BINS).astype(int), _BINS - 1)
    excess = np.bincount(bins, probabilities - present, minlength=_BINS)
    return float(np.abs(excess).sum() / probabilities.size)


def _join_groups(flags: Flags, names: Sequence[str]) -> Flags:
    """Return one column for each group of ties, and one for each effect without a group."""
    of_group = {name: f"group {k}" for k, group in enumerate(look_alikes()) for name in group}
    labels = np.array([of_group.get(name, name) for name in names])
    return np.column_stack([flags[:, labels == label].any(axis=1) for label in np.unique(labels)])


def _ratio_or_nan(part: float, whole_of_it: float) -> float:
    return float(part / whole_of_it) if whole_of_it else float("nan")
