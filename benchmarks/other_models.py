"""The gap's names and sizes for models that no packaged posterior knows; writes other_models.md.

    python -m benchmarks.other_models     # some two hours on two cores; --sets 14: an hour

For input torque, a gearbox with 11 lobes and a simulator of another machine, a posterior is learned as
``cyclofeat gap`` does it unasked. Sessions of rigs with none to six effects from the prior are then simulated
by the model itself, and the workflow names and sizes what each lacks. The packaged posterior is asked in the
same way. What is stored is not made again.
"""

from __future__ import annotations

import argparse
import dataclasses
import itertools
import json
import math
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import fmean, median
from typing import Any

import joblib
import numpy as np

from benchmarks._markdown import share, table
from benchmarks._spur_stage import SpurStage
from benchmarks._versions import made_with, stored_answers
from benchmarks.hidden_effects._answers import Answer, grouped
from benchmarks.hidden_effects._ask import result_of
from benchmarks.hidden_effects._effects import Condition
from benchmarks.hidden_effects._sets import Definition
from benchmarks.hidden_effects._table import covered_flags, size_errors
from benchmarks.hidden_effects._visible import N_RECORDINGS, SIGMA, distance
from cyclofeat._base.files import write_whole
from cyclofeat.gap import EffectPosterior, World
from cyclofeat.gap.confirm.confirm import confirm_effects
from cyclofeat.gap.confirm.sessions import limit_recordings, simulate_pairs
from cyclofeat.gap.posterior.of_model import posterior_of_world
from cyclofeat.gap.world.prepare import describe_world
from cyclofeat.gap.world.world import Session, draw_session
from cyclofeat.simulators import Clipping, Effect, Rig

PAGE = Path(__file__).with_suffix(".md")
MOST, SEED = 6, 20_261_129
RECORDINGS = {1: 8, 3: 12}  # by number of conditions


PACKAGED = "paper B's gearbox, output torque"
WORLDS = {
    "a spur gear's simulator": World(rig=Rig(name="spur", simulator=SpurStage()), sampling_rate=2000.0),
    "input torque": World(quantity="input_torque"),
    "11 lobes": World(rig=Rig(Rig().gearbox.replace(n_pins=12))),
    PACKAGED: World(),
}


def draw_set(world: World, number: int, *attempt: int) -> tuple[Session, float, tuple[Effect, ...]]:
    """Return a session without recordings, the factor on what differs anyway, and effects of random size."""
    random = np.random.default_rng([SEED, number, *attempt])
    session, tolerance = draw_session(world, RECORDINGS[3], random)
    n = RECORDINGS[len(np.unique(session.conditions, axis=0))]
    known = world.effects or ()
    chosen = sorted(random.choice(len(known), number % (MOST + 1), replace=False))
    effects = [known[k].draw_parameters(random) for k in chosen]
    highest = session.conditions[:n, 1].max()
    for k, effect in enumerate(effects):
        while isinstance(effect, Clipping) and effect.limit_nm < highest:  # constant recordings are refused
            effects[k] = effect = effect.draw_parameters(random)
    no_values = np.zeros((n, len(world.cells)))
    return dataclasses.replace(limit_recordings(session, n), values=no_values), tolerance, tuple(effects)


def significances(
    world: World, session: Session, tolerance: float, effects: Sequence[Effect]
) -> dict[str, float]:
    """Return how clearly an oracle detects each effect that knows all others and their sizes."""
    rigs = [(tuple(effects), tolerance)]
    rigs += [(tuple(one for one in effects if one is not left), tolerance) for left in effects]
    n = math.ceil(N_RECORDINGS / len(session.values))
    every = simulate_pairs(world, session, rigs, [n] * len(rigs), random_state=1)
    rows = [cells.reshape(n * len(session.values), -1) for cells in every]
    places = [*zip(map(tuple, session.conditions.tolist()), np.asarray(session.counts).tolist(), strict=True)]
    return {
        effect.effect_id: math.sqrt(len(session.values)) * distance(rows[0], without, places * n)
        for effect, without in zip(effects, rows[1:], strict=True)
    }


def answer_set(posterior: EffectPosterior, number: int) -> dict[str, Any]:
    """Return truth, significances and what the workflow says of a set, in types that JSON knows."""
    world = posterior.world
    for attempt in itertools.count():
        session, tolerance, effects = draw_set(world, number, *([attempt] if attempt else []))
        # The recordings are not of the random numbers that the workflow uses.
        (cells,) = simulate_pairs(world, session, [(effects, tolerance)], [1], random_state=SEED + number)
        if np.isfinite(cells).all():  # no rig has a low-pass above half the sampling rate
            break
    session = dataclasses.replace(session, values=cells[0])
    began = time.process_time()
    presence = posterior.presence(session)
    confirmed = confirm_effects(posterior, session, presence, random_state=0)
    seconds = time.process_time() - began
    said = dict(presence) | dict(confirmed.presence)
    visible = posterior.guess([session])[0].visible
    return {
        "conditions": np.unique(session.conditions, axis=0).tolist(),
        "truth": {
            one.effect_id: {key: float(getattr(one, key)) for key in one.vector_names()} for one in effects
        },
        "significances": significances(world, session, tolerance, effects),
        "seconds": seconds,
        "result": result_of(said, visible, confirmed.quantiles),
    }


def read_answer(stored: Mapping[str, Any]) -> Answer:
    """Return a stored answer beside its truth."""
    truth = stored["truth"]
    kind = {0: "null", 1: "single"}.get(len(truth), "several")
    conditions = tuple(Condition(*at) for at in stored["conditions"])
    effects = tuple((name, "drawn", sizes) for name, sizes in truth.items())
    seen = frozenset(name for name, sigma in stored["significances"].items() if not sigma < SIGMA)
    return Answer(Definition("", kind, 0, 0, conditions, None, effects, ""), seen, stored["result"])


def posterior_of(world: World, folder: Path, jobs: int) -> tuple[EffectPosterior, float]:
    """Return the posterior that the workflow takes for a world, and the minutes that it took to learn."""
    name = folder / f"minutes-{joblib.hash(describe_world(world))}.json"  # learned anew if this changes
    began = time.monotonic()
    posterior_of_world(world, cache=folder, n_jobs=jobs, progress=print)
    if not name.exists():
        minutes = (time.monotonic() - began) / 60
        write_whole(name, lambda stream: stream.write(json.dumps(minutes).encode()))
    # As stored: that is what its stored answers are known by.
    return posterior_of_world(world, cache=folder), json.loads(name.read_text(encoding="utf-8"))


def answers_of(posterior: EffectPosterior, folder: Path, n_sets: int, jobs: int) -> list[dict[str, Any]]:
    """Return what the workflow says of sets of a posterior's world; stored answers are read."""
    learned = joblib.hash(vars(posterior))
    made = folder / made_with(seed=SEED, world=posterior.world.to_dict(), posterior=learned)
    numbers = [str(number) for number in range(n_sets)]
    return [*stored_answers(made, numbers, lambda number: answer_set(posterior, int(number)), jobs).values()]


def row(name: str, minutes: float, stored: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return a row of the table."""
    every = [read_answer(one) for one in stored]
    named = [group in grouped(one.true) for one in every for group in one.named_groups]
    seen = [group in one.named_groups for one in every for group in grouped(one.seen)]
    right = [one.right for one in every if one.seen]
    several = [one for one in every if one.truth.kind == "several"]
    single = size_errors([one for one in every if one.truth.kind == "single"])
    holds = covered_flags(every)
    return [
        name, "packaged" if name == PACKAGED else f"{minutes:.0f}", str(len(every)),
        share(sum(named), len(named)), share(sum(seen), len(seen)), share(sum(right), len(right)),
        f"{fmean(len(one.perhaps_seen()) for one in several):.1f}",
        f"{100 * median(single):.1f} %" if single else "", f"{100 * median(size_errors(every)):.1f} %",
        share(sum(holds), len(holds)), f"{median(one['seconds'] for one in stored):.0f}",
    ]  # fmt: skip


HEAD = (
    "model", "learned in, minutes", "sets", "precision, by groups", "recall of visible effects, by groups",
    "whole visible set right, ties allowed", "undecided per set of 2 to 6, perhaps visible",
    "median error of sizes, 1 effect", "of all", "90 % intervals that hold", "s of a core per set",
)  # fmt: skip

TEXT = """# Models that no packaged posterior knows

Made by `python -m benchmarks.other_models --sets {}`. All recordings are **simulated, by the model itself**
with the effects added: unlike in [gap.md](gap.md), nothing but these effects differs. Sets have none to six
effects, in turn, of sizes drawn from the prior, at one condition (8 recordings) or three (12), at 350 to
700 RPM and 10 to 30 Nm, in either direction. Each has its own pin errors and the like, none to 1.5 times what
the world states. "Visible" are effects that an oracle detects at 3 sigma which knows all others and their
sizes. The first three posteriors are those that `cyclofeat gap` learns unasked, from 3,840 simulated rigs;
those of the gearbox go on from the packaged networks. Minutes are by the clock on two cores, shared with
other work. Goal: precision and recall within 0.08 of the packaged case, learned in at most ten minutes.

"""


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--out", type=Path, default=Path("build/other_models"), help="folder of the results")
    parser.add_argument("--sets", type=int, default=60, help="of each model (60)")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--page", type=Path, default=PAGE)
    given = parser.parse_args()
    rows = []
    for name, world in WORLDS.items():
        print(name, flush=True)
        posterior, minutes = posterior_of(world, given.out, given.jobs)
        rows.append(row(name, minutes, answers_of(posterior, given.out, given.sets, given.jobs)))
    text = TEXT.format(given.sets) + table(HEAD, rows)
    given.page.write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    # Import by name, so that worker processes can unpickle their arguments.
    from benchmarks import other_models

    other_models.main()
