"""Comparison of a corrected simulator with alternatives on recordings held out."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np

from cyclofeat.gap._measured import Condition
from cyclofeat.gap._settings import GapSettings, Windows, checked
from cyclofeat.gap.comparison import Comparison
from cyclofeat.gap.proof._alternatives import BASELINES, Simulated
from cyclofeat.gap.proof._distance import Sample, describe
from cyclofeat.gap.proof._scores import AFTER, BEFORE, Proof, score_alternatives
from cyclofeat.gap.summaries import per_recording
from cyclofeat.simulators import CycloidalGearbox, Rig

Simulator = Rig | CycloidalGearbox


def prove(
    comparison: Comparison,
    corrected: Simulator,
    measured: Windows,
    held_out: Windows,
    *,
    settings: GapSettings | None = None,
    others: Mapping[str, Simulator] | None = None,
) -> Proof:
    """Compare a corrected simulator with alternatives on recordings held out.

    Parameters
    ----------
    comparison : Comparison
        With the simulator as it was.
    corrected : Rig or CycloidalGearbox
        The simulator with what was found missing.
    measured : Windows
        Recordings that the alternatives are fitted to.
    held_out : Windows
        Recordings not used so far; the length of their windows may be another.
    settings : GapSettings, optional
        ``baselines`` and ``n_report`` are used. Every alternative has the same random numbers, and at least 4
        simulated recordings of each count.
    others : mapping from str to simulator, optional
        Further alternatives by name: ``"placebo"`` for a fitted wrong effect, ``"oracle"`` for the truth.

    Raises
    ------
    ValueError
        If ``baselines`` names an unknown one, windows are too short, a recording has two counts, ``y``,
        ``groups`` or ``angle`` do not belong to ``X``, or counts are known of one set only.

    Notes
    -----
    Each recording is described by numbers in five families: log-spectrum (slow part, third octaves, floor),
    orders (speed, lines of lobes and of the shaft), synchronous averages, amplitudes (mean, level,
    Wasserstein distance of the standardised torque) and features. In each family

    D_f^2 = sum_k w_k (a_0k^2 + a_1k^2) / s_k^2

    over cells k. a_0 and a_1 are the constant and the linear part, over the counts, of the difference between
    measured recordings and the simulated mean of their count. w_k gives all parts of a family equal weight.
    s_k is the spread of measured recordings of one count. D is the mean over families, and

    GRR = 1 - (D_after - D_floor) / (D_before - D_floor),

    where D_floor is the distance between two halves of the measured recordings, scaled to the numbers of
    recordings compared (``cyclofeat/gap/proof/_distance.py`` has the formula, also for counts with one
    recording each). The ratio is undefined if D_before - D_floor is less than two standard errors, or with
    fewer than 4 recordings. Errors and intervals come from random half-samples of the recordings of each
    count (of each condition, for counts with fewer than 3 recordings), the same for all alternatives.

    In tests with artificial summaries of 4 to 24 recordings, intervals of nominally 90 % contained the ratio
    in 77 to 97 % of the cases. Of cases without a gap, 0 to 4 % got a ratio; with simulated recordings 3 to
    8 %, and 20 % with 6 recordings of two counts and a bank of 5 each.

    Examples
    --------
    >>> from cyclofeat.simulators import BrakeRotor, Hum, Noise
    >>> rig = Rig(effects=[BrakeRotor(0.02, 1e4, 0.02), Noise(0.05)], name="R1")
    >>> truth = rig.with_added(Hum(1.0))
    >>> comparison = Comparison(sampling_rate=6400.0, rig=rig)
    >>> measured, held_out = (
    ...     Windows(bank.X, bank.counts)
    ...     for bank in (comparison.replace(rig=truth).bank(6, [0, 3], random_state=s) for s in (7, 8))
    ... )
    >>> settings = GapSettings(baselines=("nothing", "equaliser"), n_report=12)
    >>> prove(comparison, truth, measured, held_out, settings=settings).result.grr > 0.7
    True
    """
    settings = GapSettings() if settings is None else settings
    unknown = [name for name in settings.baselines if name not in BASELINES]
    if unknown:
        raise ValueError(f"baselines must be of {', '.join(BASELINES)}, got {unknown[0]!r}")
    if (measured.y is None) != (held_out.y is None):
        known = "held_out" if measured.y is None else "measured"
        raise ValueError(f"y must be given for both measured and held_out or for neither, got it for {known}")
    comparison, fit = checked(comparison, measured)
    n = settings.n_report
    alternatives: dict[str, Simulated] = {AFTER: Simulated(n, corrected)}
    for name in (BEFORE, *(name for name in settings.baselines if name != BEFORE)):
        alternatives[name] = BASELINES[name](n).fit(comparison, fit)
    alternatives |= {name: Simulated(n, simulator) for name, simulator in (others or {}).items()}

    state = comparison.random_state
    # Other random numbers than in the fit: an alternative must not profit from single simulations.
    comparison, data = checked(comparison.replace(random_state=state + 1), held_out)
    values, parts = describe(data.windows, data.conditions, data.speeds)
    wanted = None if data.counts is None else np.unique(data.counts).tolist()
    simulated: dict[str, Sample] = {}
    for name, alternative in alternatives.items():
        bank = alternative.records(comparison, wanted)
        missing = [] if wanted is None else sorted(set(wanted) - set(bank.counts.tolist()))
        if missing:
            raise ValueError(
                f"n_report must be larger: all simulations of {name!r} with {missing[0]} worn lobes failed"
            )
        speeds = None if data.speeds is None else bank.speeds
        counts = 0 * bank.counts if data.counts is None else bank.counts
        simulated[name] = Sample(describe(bank.X, data.conditions, speeds)[0], counts)
    rows = Sample(per_recording(values, data.of_window), data.counts_or_zeros)
    seen = None if fit.counts is None else np.isin(rows.counts, fit.counts)
    proof = score_alternatives(rows, simulated, parts, seen, random_state=state)
    return dataclasses.replace(proof, condition=Condition.of(comparison))
