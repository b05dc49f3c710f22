"""Counters trained on corrected models: what the correction, and its uncertainty, gain in counts.

    python -m benchmarks.drawn_rigs     # some 10 minutes on two cores; writes benchmarks/drawn_rigs.md

Four recordings of a rig with hidden effects correct the default gearbox. Counters of worn lobes, trained on
the model, on its most probable correction, on rigs drawn from the posterior, and on the true rig, count other
recordings of the true rig. Rigs where the model costs no counts are passed over.
"""

from __future__ import annotations

import argparse
import itertools
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from joblib import Parallel, delayed

from benchmarks._markdown import line, table
from cyclofeat.counting import make_lobe_counter
from cyclofeat.datasets import make_rig_recordings
from cyclofeat.gap import Comparison, EffectPosterior, load_posterior
from cyclofeat.gap.comparison import corrected_rig
from cyclofeat.gap.confirm.confirm import confirm_effects, draw_effects
from cyclofeat.gap.measured import MeasuredRig
from cyclofeat.gap.simulations import Bank
from cyclofeat.gap.world.world import NOISE_AND_DRIFT
from cyclofeat.simulators import Effect, Rig

COUNTS, TRAINED, JUDGED = range(8), 16, 128  # recordings of each count, and of all
FITTED = (0, 2, 5, 7)  # counts of the recordings that correct the model
N_EFFECTS, N_VARIANTS, N_TREES = 4, 200, 300
LEAST_COST = 0.1  # of counts, that the model loses against the true rig
NAMES = ("the model", "most probable rig", "drawn rigs", "true rig")


def right(comparison: Comparison, judged: Bank, model: object) -> float:
    """Return the share of the judged windows that a counter trained on the model counts rightly."""
    of_model = comparison.replace(rig=model, random_state=comparison.random_state + 2)
    bank = of_model.bank(TRAINED * len(COUNTS), COUNTS)
    counter = make_lobe_counter(
        comparison.sampling_rate, input_speed_hz=comparison.kinematics.input_speed_hz,
        n_lobes=comparison.n_lobes, n_trees=N_TREES, random_state=0,
    )  # fmt: skip
    return float(counter.fit(bank.X, bank.counts).score(judged.X, judged.counts))


def hidden(posterior: EffectPosterior, seed: int) -> tuple[Effect, ...]:
    """Return random effects of random size."""
    random, known = np.random.default_rng(seed), posterior.world.effects or ()
    chosen = sorted(random.choice(len(known), N_EFFECTS, replace=False))
    return tuple(known[k].draw_parameters(random) for k in chosen)


def corrected(
    posterior: EffectPosterior, comparison: Comparison, truth: Rig, seed: int
) -> tuple[Rig, Rig, list[str]]:
    """Return the model's most probable correction, drawn ones, and the effects named."""
    world = posterior.world
    recordings = make_rig_recordings(
        1, FITTED, rig=comparison.replace(rig=truth).population.rig, duration=1.9, random_state=seed,
        sampling_rate=world.sampling_rate, kernel="auto",
    )  # fmt: skip
    session = MeasuredRig.of(recordings, world.rig, world.sampling_rate).session()
    confirmed = confirm_effects(posterior, session, posterior.presence(session), random_state=0)
    variants = draw_effects(posterior, session, confirmed, N_VARIANTS, random_state=0)
    named = [effect.effect_id for effect in confirmed.effects]
    return corrected_rig(comparison, confirmed.effects), corrected_rig(comparison, variants=variants), named


def case(posterior: EffectPosterior, seed: int) -> tuple[list[str], list[float]]:
    """Return the true and the named effects, and the share of each counter; no share if nothing is lost."""
    world, effects = posterior.world, hidden(posterior, seed)
    comparison = Comparison(sampling_rate=world.sampling_rate, rig=world.rig)
    truth = world.rig.with_added(*NOISE_AND_DRIFT, *effects)
    judged = comparison.replace(rig=truth).bank(JUDGED, COUNTS, random_state=1000 + seed)
    names = [", ".join(one.effect_id for one in effects)]
    before, best = (right(comparison, judged, model) for model in (comparison.rig, truth))
    if best - before < LEAST_COST:
        return names, []
    most_probable, drawn, named = corrected(posterior, comparison, truth, seed)
    after = [right(comparison, judged, model) for model in (most_probable, drawn)]
    return [*names, ", ".join(named) or "none"], [before, *after, best]


def cases(n: int, n_jobs: int) -> Iterator[tuple[int, list[str], list[float]]]:
    """Return the seed, names and shares of rigs where the model costs counts, until there are n."""
    posterior, found = load_posterior(), 0
    for first in itertools.count(0, 2 * n_jobs):
        seeds = range(first, first + 2 * n_jobs)
        for seed, (names, shares) in zip(
            seeds, Parallel(n_jobs)(delayed(case)(posterior, seed) for seed in seeds), strict=True
        ):
            if shares:
                found += 1
                yield seed, names, shares
            if found == n:
                return


def gained(shares: np.ndarray, which: int) -> list[str]:
    """Return median, quartiles and the mean's share of the true rig's gain."""
    before, after, best = shares[:, 0], shares[:, which], shares[:, 3]
    low, middle, high = np.quantile((after - before) / (best - before), (0.25, 0.5, 0.75))
    of_mean = (after.mean() - before.mean()) / (best.mean() - before.mean())
    return [NAMES[which], f"{middle:.2f}", f"{low:.2f} to {high:.2f}", f"{of_mean:.2f}"]


def page(every: Sequence[Sequence[float]], names: Sequence[Sequence[str]], n_drawn: int, wanted: int) -> str:
    """Return the page of the cases so far."""
    found = np.array(every)
    made = [
        [*words, *(f"{share:.2f}" for share in shares)] for words, shares in zip(names, every, strict=True)
    ]
    made.append(["mean", "", *(f"{share:.3f}" for share in found.mean(axis=0))])
    shares = table(
        ["trained on", "median", "quartiles", "of the means"], [gained(found, 1), gained(found, 2)]
    )
    return f"""# Counters trained on corrected models

Made by `python -m benchmarks.drawn_rigs --rigs {wanted}`. All recordings are **simulated**. Share of
{JUDGED} recordings of each true rig, with 0 to 7 worn lobes, that a counter trained on
{TRAINED * len(COUNTS)} recordings counts right; standard error up to {0.5 / JUDGED**0.5:.3f}.
Of {n_drawn} rigs with {N_EFFECTS} random effects, these are the {len(every)} where the model costs at least
{LEAST_COST:g} of the counts. The posterior has learned from {load_posterior().n_rigs_:,} rigs.

Share of the true rig's gain (goal: a median of 0.9):

{shares}
{table(["hidden effects", "named", *NAMES], made)}"""


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--rigs", type=int, default=12, help="where the model costs counts (default 12)")
    parser.add_argument("--jobs", type=int, default=2)
    given = parser.parse_args()
    every, words = [], []
    for seed, names, shares in cases(given.rigs, given.jobs):
        every.append(shares)
        words.append(names)
        print(line([*names, *(f"{share:.2f}" for share in shares)]), end="", flush=True)
        text = page(every, words, seed + 1, given.rigs)
        Path(__file__).with_suffix(".md").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
