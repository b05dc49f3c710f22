"""Sound and worn discs of rigs that no model was trained on: refusals, and counts that are right.

    python -m benchmarks.sound_discs     # writes benchmarks/sound_discs.md

The recordings are made by the generator of :mod:`benchmarks.hidden_effects`, whose code is independent of the
simulator that made the training data. Each is of another machine with a brake and none, one or two further
effects that spoil nothing, at any speed and load that the packaged models count.
"""

from __future__ import annotations

import argparse
import math
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import joblib
import numpy as np

from benchmarks._markdown import share, table
from benchmarks._versions import kept_in
from benchmarks.hidden_effects._effects import Condition, nuisance_and_seed, record, run_machine
from benchmarks.hidden_effects._machine import SAMPLING_RATE
from benchmarks.hidden_effects._motor import drawn_servo, drive
from benchmarks.hidden_effects._sets import table as effect_sizes
from cyclofeat.counting import LobeCount
from cyclofeat.models import load_default_model
from cyclofeat.recordings import Recording
from cyclofeat.simulators import BrakeRotor, CycloidalGearbox

SPEEDS, LOADS = (100.0, 1500.0), (3.0, 40.0)  # of the packaged models
TURNS = 2.05  # of the output: two windows
SEED = 49_000
QUANTITIES = ("output_torque", "input_torque", "motor_current")
# Effects that are drawn, from weak to medium size. None spoils a count but the run-out of both wheels: it is
# two to five times that of the training, and looks like wear.
FURTHER, SPOILS = (
    "pin_errors", "run_out", "clearance", "contact_stiffness_scale", "contact_damping_scale", "load_drift",
    "load_scale", "speed_scale", "load_warm_up", "sensor_warm_up", "sensor_drift", "gain", "offset", "noise",
    "hum", "clock_error", "torque_meter_low_pass",
), "run_out"  # fmt: skip
# Machines from this number on have no assembly errors, but what a meter of torque adds.
PERFECT, METER = 100_000, ("hum", "offset", "sensor_drift", "torque_meter_low_pass")
WITHOUT_ERRORS = "without assembly errors"
Made = tuple[str, list[Recording]]


def drawn_sizes(effect: str, random: np.random.Generator) -> dict[str, float]:
    """Return the parameters of an effect, each between weak and medium; a brake's up to strong."""
    highest = "strong" if effect == "brake_rotor" else "medium"
    drawn = {}
    for row in effect_sizes("sizes.csv"):
        if row.effect == effect:
            low, high = row.values["weak"], row.values[highest]
            value = low * (high / low) ** random.random()
            if row.scale == "factor" and random.random() < 0.5:
                value = 1 / value
            drawn[row.parameter] = value * (random.choice((-1, 1)) if row.scale == "sign" else 1)
    return drawn


def made_recordings(number: int, count: int) -> Made:
    """Return the words for a machine's further effects, and its recordings of torques and current."""
    random = np.random.default_rng([SEED, number])
    speed, load = (low * (high / low) ** random.random() for low, high in (SPEEDS, LOADS))
    further = random.choice(FURTHER, number % 3, replace=False).tolist() if number < PERFECT else METER
    effects = [(name, drawn_sizes(name, random)) for name in ("brake_rotor", *further)]
    nuisance, seed = nuisance_and_seed([SEED, number, 1])
    if number >= PERFECT:
        nuisance = replace(nuisance, pins=0 * nuisance.pins)
    n_samples = math.ceil(TURNS * 15 * 60 / speed * SAMPLING_RATE)
    condition = Condition(speed, load)
    run = run_machine(count, condition, effects, seed, nuisance, n_samples)
    has_tachometer = bool(random.random() < 0.5)
    servo = drawn_servo(load, 2 * math.pi * speed / 60, random)
    brake = dict(effects)["brake_rotor"]
    gearbox = BrakeRotor(**brake).change_gearbox(CycloidalGearbox.steel(load_torque=load), random)
    current, turned = drive(servo, run.torque_in, run.angle, gearbox, SAMPLING_RATE, random)
    recorded = slice(run.begin, run.begin + n_samples)
    recordings = []
    for quantity in QUANTITIES:
        values, angle = current[recorded], turned
        if quantity != "motor_current":
            angle = run.angle
            values = record(
                run, effects, np.random.SeedSequence([SEED, number, 2]), n_samples,
                at_input=quantity == "input_torque",
            )  # fmt: skip
        recordings.append(Recording(
            values, SAMPLING_RATE, quantity=quantity, defect_count=count, speed_rpm=round(speed, 1),
            load_nm=load, angle=angle[recorded] if has_tachometer else None, source="surrogate",
        ))  # fmt: skip
    return WITHOUT_ERRORS if number >= PERFECT else " and ".join(further) or "none", recordings


def attempt(number: int, count: int) -> Made | None:
    """Return a machine's recordings; None where its simulation diverges."""
    try:
        return made_recordings(number, count)
    except RuntimeError:
        return None


class Answered(NamedTuple):
    """What the packaged models say of a machine."""

    effects: str  # in words
    count: int
    has_tachometer: bool
    answers: dict[str, LobeCount]  # by quantity


def answers_of(number: int, count: int, folder: Path) -> Answered | None:
    """Return the packaged models' answers for a machine; None where its simulation diverged."""
    made = kept_in(folder)(attempt)(number, count)
    if made is None:
        return None
    words, recordings = made
    models = {one.quantity: load_default_model(one.quantity) for one in recordings}
    answers = {one.quantity: models[one.quantity].count(one) for one in recordings}
    return Answered(words, count, recordings[0].angle is not None, answers)


def rows_of(answered: Sequence[Answered], quantity: str) -> list[list[str]]:
    """Return the rows of the table for a quantity."""
    perfect = [one for one in answered if one.effects == WITHOUT_ERRORS]
    harmless = [one for one in answered if SPOILS not in one.effects and one.effects != WITHOUT_ERRORS]
    sound = [one for one in harmless if one.count == 0]
    groups = [
        ("sound, no further effect", [one for one in sound if one.effects == "none"]),
        (
            "sound, one further effect",
            [one for one in sound if one.effects != "none" and " and " not in one.effects],
        ),
        ("sound, two further effects", [one for one in sound if " and " in one.effects]),
        ("sound, all of these", sound),
        ("- with a tachometer", [one for one in sound if one.has_tachometer]),
        ("- without", [one for one in sound if not one.has_tachometer]),
        (
            "sound, run-out of 10 to 25 um",
            [one for one in answered if SPOILS in one.effects and one.count == 0],
        ),
        ("worn, all", [one for one in harmless if one.count > 0]),
        (f"{WITHOUT_ERRORS}, sound", [one for one in perfect if one.count == 0]),
        ("- with a tachometer", [one for one in perfect if one.count == 0 and one.has_tachometer]),
        ("- without", [one for one in perfect if one.count == 0 and not one.has_tachometer]),
        (f"{WITHOUT_ERRORS}, worn", [one for one in perfect if one.count > 0]),
    ]
    name = quantity.replace("_", " ")
    return [
        row(f"{name}, {words}", [(one.count, one.answers[quantity]) for one in some])
        for words, some in groups
        if some
    ]


def row(words: str, pairs: Sequence[tuple[int, LobeCount]]) -> list[str]:
    """Return a row of the table: shares refused, right of all, and wrong without being refused."""
    n = len(pairs)
    refused = sum(answer.refused for _, answer in pairs)
    right = sum(answer.defect_count == count for count, answer in pairs)
    wrong = sum(answer.defect_count != count and not answer.refused for count, answer in pairs)
    return [words, str(n), share(refused, n), share(right, n), f"{wrong / n:.3f}"]


def merged(reasons: Counter[str]) -> Counter[str]:
    """Return how often each reason was given, whatever its numbers."""
    alike: Counter[str] = Counter()
    for reason, n in reasons.items():
        alike[re.sub(r"\d[\d.,]*", "...", reason)] += n
    return alike


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sound", type=int, default=400, help="machines with a sound disc (default 400)")
    parser.add_argument("--worn", type=int, default=196, help="machines with 1 to 7 worn lobes (default 196)")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--folder", type=Path, default=Path("build/sound_discs"), help="what is made is kept")
    parser.add_argument("--out", type=Path, default=Path("benchmarks/sound_discs.md"))
    arguments = parser.parse_args()
    counts = dict(enumerate([0] * arguments.sound + [1 + k % 7 for k in range(arguments.worn)]))
    # Of those without assembly errors half as many.
    of_perfect = [0] * (arguments.sound // 2) + [1 + k % 7 for k in range(arguments.worn // 2)]
    counts |= dict(enumerate(of_perfect, start=PERFECT))
    found = joblib.Parallel(n_jobs=arguments.jobs)(
        joblib.delayed(answers_of)(number, count, arguments.folder) for number, count in counts.items()
    )
    answered = [one for one in found if one is not None]
    rows, reasons = [], []
    for quantity in QUANTITIES:
        rows += rows_of(answered, quantity)
        every = [one.answers[quantity] for one in answered]
        refused = Counter(one.reason.split(":")[0] for one in every if one.refused)
        reasons += [
            [quantity.replace("_", " "), reason, str(n)] for reason, n in merged(refused).most_common()
        ]
    text = f"""# Sound and worn discs of independent rigs

Made by `python -m benchmarks.sound_discs --sound {arguments.sound} --worn {arguments.worn}`. The generator of
the [hidden effects](hidden_effects/README.md) makes the recordings with code of its own. Each recording is of
another machine at {SPEEDS[0]:g} to {SPEEDS[1]:,.0f} RPM and {LOADS[0]:g} to {LOADS[1]:g} Nm (log-uniform).
Its pins are displaced by 5 um rms, and it has a brake and none, one or two of {len(FURTHER)} further effects
of weak to medium size. A run-out of both wheels, two to five times that of the training, looks like wear and
has a row of its own. Machines without assembly errors have a brake and a torque meter with hum, an offset,
drift and a low-pass. A recording holds {TURNS:g} output turns; half have a tachometer. The motor
current is that of a servo motor with control of its speed, also by an independent implementation
(`hidden_effects/_motor.py`); it has no effects of the torque meter. The packaged models count all.
All recordings are simulated. The goal is that at most 3 % of sound discs are refused.
{len(found) - len(answered)} of {len(found)} machines diverged.

"""
    text += table(["recordings", "n", "refused", "right, of all", "wrong, not refused"], rows)
    text += "\nReasons of the refusals:\n\n" + table(["quantity", "reason", "recordings"], reasons)
    arguments.out.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
