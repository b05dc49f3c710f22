"""Counters trained on corrected models, with and without their uncertainty.

    python -m benchmarks.drawn_rigs     # some minutes on two cores; writes benchmarks/drawn_rigs.md

Four recordings of a rig with hidden effects correct the default gearbox. Counters of worn lobes, trained on
the model, on its most probable correction, on rigs drawn from the posterior, and on the true rig, count other
recordings of the true rig.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from benchmarks._markdown import line, table
from cyclofeat.datasets import make_rig_recordings
from cyclofeat.gap import Comparison, MeasuredRig, downstream_gain
from cyclofeat.gap.confirm import confirm, draw_effects
from cyclofeat.gap.posterior import EffectPosterior, load_posterior, named_effects
from cyclofeat.gap.world import FLOOR
from cyclofeat.simulators import Effect, Rig

COUNTS, TRAINED, JUDGED = range(8), 16, 64  # recordings of each count, and of all
FITTED = (0, 2, 5, 7)  # counts of the recordings that correct the model
N_EFFECTS, N_VARIANTS = 4, 200
SEEDS = (0, 2, 3, 4, 5)  # with 1 the torque is clipped far below the load
NAMES = ("the model", "most probable rig", "drawn rigs", "true rig")


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
        sampling_rate=world.sampling_rate, kernel="auto", n_jobs=comparison.n_jobs,
    )  # fmt: skip
    session = MeasuredRig.of(recordings, world.rig, world.sampling_rate).session()
    named = named_effects(posterior.presence(session))
    confirmed = confirm(posterior, session, named, n_jobs=comparison.n_jobs)
    variants = draw_effects(posterior, session, confirmed, N_VARIANTS)
    return comparison.corrected_rig(confirmed.effects), comparison.corrected_rig(variants=variants), named


def accuracies(posterior: EffectPosterior, seed: int, n_jobs: int) -> tuple[str, list[float]]:
    """Return the true and the named effects, and the accuracy of each counter."""
    world, effects = posterior.world, hidden(posterior, seed)
    comparison = Comparison(sampling_rate=world.sampling_rate, rig=world.rig, n_jobs=n_jobs)
    truth = world.rig.with_added(*FLOOR, *effects)
    best, drawn, named = corrected(posterior, comparison, truth, seed)
    judged = comparison.replace(rig=truth).bank(JUDGED, COUNTS, random_state=1000 + seed)
    measured = comparison.measured(judged.X, y=judged.counts)
    by_best = downstream_gain(comparison, best, measured, oracle=truth, n_per_class=TRAINED).accuracy
    by_drawn = downstream_gain(comparison, drawn, measured, n_per_class=TRAINED).accuracy
    names = [", ".join(one.effect_id for one in effects), ", ".join(named) or "none"]
    return names, [by_best["before"], by_best["after"], by_drawn["after"], by_best["oracle"]]


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--rigs", type=int, default=2)
    parser.add_argument("--jobs", type=int, default=2)
    given = parser.parse_args()
    posterior, found = load_posterior(), []
    lines = [
        "# Counters trained on corrected models",
        "",
        f"Made by `python -m benchmarks.drawn_rigs --rigs {given.rigs}`. All recordings are **simulated**.",
        f"Share of {JUDGED} recordings of each true rig, with 0 to 7 worn lobes, that a counter trained",
        f"on {TRAINED * len(COUNTS)} recordings counts right; standard error up to {0.5 / JUDGED**0.5:.3f}.",
        f"The posterior has learned from {posterior.n_rigs_:,} rigs.",
    ]
    made = []
    for seed in SEEDS[: given.rigs]:
        names, shares = accuracies(posterior, seed, given.jobs)
        found.append(shares)
        made.append([*names, *(f"{share:.2f}" for share in shares)])
        print(line(made[-1]), end="", flush=True)
    made.append(["mean", "", *(f"{share:.3f}" for share in np.mean(found, axis=0))])
    print(line(made[-1]), end="")
    text = "\n".join(lines) + "\n\n" + table(["hidden effects", "named", *NAMES], made)
    Path(__file__).with_suffix(".md").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
