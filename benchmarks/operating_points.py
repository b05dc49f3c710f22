"""Counts at any speed and load, of torque and motor current, by one model each.

    python -m benchmarks.operating_points     # writes benchmarks/operating_points.md

The packaged models count one window of one output turn of simulated assemblies of rig R2, speed and load
log-uniform, that they have not seen. A single speed and load has models of its own.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from fractions import Fraction
from itertools import compress
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import resample_poly

from benchmarks._markdown import line, share, table
from benchmarks._timing import processor_seconds
from cyclofeat.counting import LobeCount, LobeModel
from cyclofeat.datasets import make_rig_recordings, rig_preset
from cyclofeat.models import load_default_model
from cyclofeat.recordings import Recording
from cyclofeat.simulators import Noise, Solver

SPEEDS, LOADS = (100.0, 1500.0), (3.0, 40.0)
TURNS = 1.05
# Sampling rate of motor currents: drives log at some kHz.
CURRENT_HZ = 8000.0
# Seeds; the packaged models have 0.
JUDGED, TRAINED, SPECIAL = 23, 22, 3
# Assemblies of each count that teach both kinds of wear; share and depth of the worn ones with radial wear.
BOTH, RADIAL_SHARE, RADIAL_UM = 108, 1 / 3, (60.0, 200.0)
# Recordings whose count is timed, and how often.
TIMED, REPEATS = 6, 30
Answers = Sequence[LobeCount | None]


class Data:
    """Recordings of one quantity, three quarters to train on and a quarter to count."""

    def __init__(self, recordings: Sequence[Recording], n_counts: int = 8) -> None:
        last = len(recordings) // n_counts * 3 // 4 * n_counts
        self.training, self.judged = list(recordings[:last]), list(recordings[last:])


def simulated(
    n: int, quantity: str, n_jobs: int, seed: int, rig: str = "R2", turns: float = TURNS, **at: object
) -> list[Recording]:
    """Return one recording of each of n assemblies of each count."""
    # Effects of the torque meter are divided by the reduction at the input: 0.015 Nm there.
    noise = {"output_torque": Noise(0.2), "input_torque": Noise(0.225), "motor_current": Noise(0.0)}[quantity]
    where = {"speed_rpm": SPEEDS, "load_nm": LOADS} | at
    return make_rig_recordings(
        n, rig=rig_preset(rig).with_effects(noise), output_turns=turns, random_state=seed, n_jobs=n_jobs,
        sampling_rate=CURRENT_HZ if quantity == "motor_current" else 25_600.0, with_angle=True,
        kernel="auto", solver=Solver(integrator="adams_bashforth"), quantity=quantity, **where,  # type: ignore[arg-type]
    )  # fmt: skip


def with_radial_wear(depth_um: float, n: int, n_jobs: int, **at: object) -> list[Recording]:
    """Return recordings of worn discs with radial wear in place of the chord, n of each count from 1 to 7."""
    worn = {"wear_um": depth_um, "defect_counts": range(1, 8)}
    return simulated(n, "output_torque", n_jobs, JUDGED, **worn, **at)  # type: ignore[arg-type]


def trained(recordings: Sequence[Recording]) -> LobeModel:
    return LobeModel(n_splits=0, random_state=0).fit(recordings)


def blind(recording: Recording, random: np.random.Generator) -> Recording:
    """Return a recording without its tachometer; the stated speed is up to 2 % beside the true one."""
    true = 60 * float(recording.mean_input_speed())  # type: ignore[arg-type]
    return recording.replace(
        angle=None, angle_is_absolute=False, speed_rpm=true * (1 + random.uniform(-0.02, 0.02))
    )


def wandering(recording: Recording, random: np.random.Generator) -> Recording:
    """Return a recording without its tachometer whose speed wanders by 5 % within 60 to 150 turns."""
    rate, n = recording.sampling_rate, recording.n_samples
    turn = 1 / float(recording.mean_input_speed())  # type: ignore[arg-type]
    period, phase = random.uniform(60, 150) * turn, random.uniform(0, 2 * np.pi)
    time_s = np.arange(n) / rate
    course = time_s + 0.05 * period / (2 * np.pi) * (
        np.cos(phase) - np.cos(2 * np.pi * time_s / period + phase)
    )
    course = course[course <= time_s[-1]]
    torque = CubicSpline(time_s, recording.torque)(course)
    return recording.replace(torque=torque, angle=None, angle_is_absolute=False, speed_rpm=60 / turn)


def logged(recording: Recording, rate: float) -> Recording:
    """Return a recording as a logger of a lower rate makes it: filtered and thinned."""
    assert recording.angle is not None
    step = Fraction(rate / recording.sampling_rate).limit_denominator(1000)
    torque = resample_poly(recording.torque, step.numerator, step.denominator, padtype="line")
    at = np.arange(torque.size) / float(step)
    torque, at = torque[at <= recording.n_samples - 1], at[at <= recording.n_samples - 1]
    angle = np.interp(at, np.arange(recording.n_samples), recording.angle)
    return recording.replace(torque=torque, angle=angle, sampling_rate=rate)


def slow_logger(recording: Recording, random: np.random.Generator) -> Recording:
    """Return a recording at 1 kHz, which holds few lobe lines at a high speed."""
    return logged(recording, 1000.0)


def at_multiple(factor: float) -> Callable[[Recording, np.random.Generator], Recording]:
    """Return what states a speed ``factor`` times the true one, without a tachometer."""

    def stated(recording: Recording, random: np.random.Generator) -> Recording:
        one = blind(recording, random)
        return one.replace(speed_rpm=factor * one.speed_rpm)

    return stated


def counted(
    model: LobeModel, recordings: Sequence[Recording], change: Callable | None = None
) -> list[LobeCount | None]:
    """Count recordings, changed beforehand; None where a recording is an error, such as too short."""
    random = np.random.default_rng(5)
    answers: list[LobeCount | None] = []
    for recording in recordings:
        try:
            answers.append(model.count(recording if change is None else change(recording, random)))
        except ValueError:
            answers.append(None)
    return answers


def row(what: str, goal: float | str, recordings: Sequence[Recording], answers: Answers) -> list[str]:
    """Return a row of the table: shares right among the counted ones and of all, refused and wrong.

    A number as the goal is the least share of all that is to be right.
    """
    truth = [recording.defect_count for recording in recordings]
    pairs = [(a, t) for a, t in zip(answers, truth, strict=True) if a is not None and not a.refused]
    right = sum(a.defect_count == t for a, t in pairs)
    sure = sum(a.defect_count != t and a.probability[a.defect_count] > 0.9 for a, t in pairs)
    every = sum(a is not None and a.defect_count == t for a, t in zip(answers, truth, strict=True))
    n = len(truth)
    of_counted = f"{right / len(pairs):.3f}" if pairs else "-"
    missed = isinstance(goal, float) and every / n < goal
    return [
        what, goal if isinstance(goal, str) else f">= {goal:g}", share(every, n) + " **missed**" * missed,
        f"{1 - len(pairs) / n:.3f}", of_counted, f"{sure / n:.3f}", str(n),
    ]  # fmt: skip


def count_ms(model: LobeModel, recordings: Sequence[Recording]) -> float:
    """Return the processor time of one count in ms: of each recording the least, and of these the median."""
    least = [
        min(processor_seconds(lambda one=one: model.count(one)) for _ in range(REPEATS)) for one in recordings
    ]
    return 1000 * float(np.median(least))


def rows(n_judged: int, n_jobs: int) -> tuple[list[list[str]], list[float]]:
    """Return the rows of the table, and the ms of a count with and without a tachometer."""
    made = []

    def add(what: str, goal: float | str, recordings: Sequence[Recording], answers: Answers) -> None:
        made.append(row(what, goal, recordings, answers))
        print(line(made[-1]), end="", flush=True)

    model = load_default_model("output_torque")
    judged = simulated(n_judged, "output_torque", n_jobs, JUDGED)
    seeing = counted(model, judged)
    add("output torque, 0.2 Nm, tachometer", 0.97, judged, seeing)
    for name, low, high in (("100 to 250", 100, 250), ("250 to 600", 250, 600), ("600 to 1,500", 600, 1500)):
        within = [low <= float(one.speed_rpm or 0) < high for one in judged]
        add(f"- of these, {name} RPM", "stated", [*compress(judged, within)], [*compress(seeing, within)])
    sound = [one.defect_count == 0 for one in judged]
    add("- of these, sound discs", "stated", [*compress(judged, sound)], [*compress(seeing, sound)])
    add("the same logged at 1 kHz, tachometer", "stated", judged, counted(model, judged, slow_logger))
    add("the same without a tachometer, steady speed", 0.95, judged, counted(model, judged, blind))
    add("- speed wandering by 5 %", 0.93, judged, counted(model, judged, wandering))
    for factor, words in ((2.0, "half"), (3.0, "a third of"), (4.0, "a quarter of"), (0.5, "twice")):
        add(
            f"- turning at {words} the stated speed (all must be refused)", "refused", judged,
            counted(model, judged, at_multiple(factor)),
        )  # fmt: skip
    for quantity, words, goal in (
        ("input_torque", "input torque, 0.015 Nm (1 %), tachometer", 0.98),
        ("motor_current", "motor current with all its effects, encoder", 0.95),
    ):
        others, of_quantity = simulated(n_judged, quantity, n_jobs, JUDGED), load_default_model(quantity)
        add(words, goal, others, counted(of_quantity, others))
        add("- logged at 1 kHz", "stated", others, counted(of_quantity, others, slow_logger))
        add("- without it, steady speed", 0.95, others, counted(of_quantity, others, blind))
        add("- speed wandering by 5 %", 0.93, others, counted(of_quantity, others, wandering))
    for depth in (20.0, 50.0, 100.0, 200.0):
        early = with_radial_wear(depth, n_judged // 4, n_jobs)
        add(
            f"output torque, radial wear of {depth:g} um, never trained",
            "stated",
            early,
            counted(model, early),
        )
    at: dict[str, float] = {"speed_rpm": 500.0, "load_nm": 22.0}
    for rig in ("R1", "R2"):
        special = Data(simulated(96, "output_torque", n_jobs, SPECIAL, rig=rig, **at))
        alone = trained(special.training)
        add(f"{rig} at 500 RPM, 22 Nm: a model for these alone", "stated",
            special.judged, counted(alone, special.judged))  # fmt: skip
        add("- the packaged model, of R2 at all speeds and loads", "not below by more than 0.01",
            special.judged, counted(model, special.judged))  # fmt: skip
        both = trained(simulated(
            BOTH, "output_torque", n_jobs, TRAINED, rig=rig, wear_um=RADIAL_UM, radial_share=RADIAL_SHARE,
            **at,
        ))  # fmt: skip
        add("- a model of both kinds of wear", "stated", special.judged, counted(both, special.judged))
        for depth in (50.0, 100.0, 200.0):
            early = with_radial_wear(depth, n_judged // 4, n_jobs, rig=rig, **at)
            for words, one in (("of the chord alone", alone), ("of both kinds", both)):
                add(f"- radial wear of {depth:g} um, the model {words}", "stated", early, counted(one, early))
    times = [count_ms(model, special.judged[:TIMED]), count_ms(model, [
        blind(one, np.random.default_rng(5)) for one in special.judged[:TIMED]
    ])]  # fmt: skip
    return made, times


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--judged", type=int, default=96, help="assemblies of each count (default 96)")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--out", type=Path, default=Path("benchmarks/operating_points.md"))
    arguments = parser.parse_args()
    head = ["work", "goal", "right, of all", "refused", "right, of those counted", "wrong and sure", "n"]
    made, times = rows(arguments.judged, arguments.jobs)
    text = f"""# Counts at any speed and load

Made by
`python -m benchmarks.operating_points --judged {arguments.judged}`.
Simulated assemblies of rig R2, speeds of {SPEEDS[0]:g} to
{SPEEDS[1]:g} RPM and loads of {LOADS[0]:g} to {LOADS[1]:g} Nm (log-uniform), counts of 0 to 7, chance 0.125;
the drift of the load shrinks with loads below 22 Nm. The packaged models (`make default-models`) count one
window of one output turn of assemblies that they have not seen. "Right, of all" takes the count of
refused recordings too (95 % interval by Wilson); "wrong and sure" is the share of all that is wrong, not
refused, and has a probability above 0.9. Worn lobes have the papers' chord where nothing else is said; rows
of radial wear hold worn discs only. A model of both kinds of wear learned {BOTH} assemblies of each count at
this speed and load, a share of {RADIAL_SHARE:.2f} of the worn ones with radial wear of {RADIAL_UM[0]:g} to
{RADIAL_UM[1]:g} um.

One window of output torque at 25.6 kHz, 500 RPM and 22 Nm takes {times[0]:.1f} ms of processor time
from the recording in memory to refusal and count (goal 10 ms), and {times[1]:.1f} ms without a tachometer:
of {TIMED} recordings the median, of each the least of {REPEATS}.

"""
    arguments.out.write_text(text + table(head, made), encoding="utf-8")


if __name__ == "__main__":
    main()
