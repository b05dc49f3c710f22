"""Counts at low sampling rates, by models that were trained at them.

    python -m benchmarks.sampling_rates     # writes benchmarks/sampling_rates.md

Simulated assemblies of rig R2 at one speed and 22 Nm, whole assemblies held out as in
``benchmarks.operating_points``; the same recordings at every rate, by a logger with an anti-alias filter.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from benchmarks._markdown import line, share, table
from benchmarks.operating_points import Answers, Data, blind, counted, logged, trained
from cyclofeat.datasets import make_rig_recordings, rig_preset
from cyclofeat.recordings import Recording
from cyclofeat.simulators import Noise, Solver

SIMULATED_HZ = 25_600.0
RATES_HZ = (25_600.0, 10_000.0, 4000.0, 2000.0, 1000.0)
SPEEDS_RPM = (500.0, 1500.0)
LOAD_NM = 22.0
# Noise of each sample, whatever the rate.
QUANTITIES = {"output_torque": ("output torque, 0.2 Nm", 0.2), "motor_current": ("motor current", 0.0)}


def simulated(n: int, quantity: str, speed_rpm: float, n_jobs: int) -> list[Recording]:
    """Simulate assemblies at one speed and load, without noise."""
    return make_rig_recordings(
        n, rig=rig_preset("R2").with_effects(Noise(0.0)), speed_rpm=speed_rpm, load_nm=LOAD_NM,
        output_turns=1.05, random_state=3, n_jobs=n_jobs, sampling_rate=SIMULATED_HZ, with_angle=True,
        kernel="auto", solver=Solver(integrator="adams_bashforth"), quantity=quantity,
    )  # fmt: skip


def noisy(recordings: Sequence[Recording], noise: float) -> list[Recording]:
    """Return the recordings with white noise of their loggers."""
    random = np.random.default_rng(7)
    return [one.replace(torque=one.torque + random.normal(0, noise, one.n_samples)) for one in recordings]


def right(recordings: Sequence[Recording], answers: Answers) -> str:
    """Return the share counted right, refused ones too, with its 95 % interval, and the share refused."""
    pairs = list(zip(recordings, answers, strict=True))
    n_right = sum(a is not None and a.defect_count == r.defect_count for r, a in pairs)
    refused = sum(a is None or a.refused for _, a in pairs) / len(pairs)
    return f"{share(n_right, len(pairs))}, {refused:.3f}"


def rows(n: int, n_jobs: int) -> Iterator[list[str]]:
    """Yield the rows of the table, the highest rate of each quantity and speed first."""
    for quantity, (words, noise) in QUANTITIES.items():
        for speed in SPEEDS_RPM:
            recordings = simulated(n, quantity, speed, n_jobs)
            rich: list[Recording] = []
            for rate in RATES_HZ:
                data = Data(noisy([logged(one, rate) for one in recordings], noise))
                rich = rich or data.judged
                model = trained(data.training)
                yield [
                    words, f"{speed:,.0f}", f"{rate / 1000:g}", str(model.samples_per_turn_),
                    str(model.counter_.lobe_map_.n_lines),
                    right(data.judged, counted(model, data.judged)),
                    right(data.judged, counted(model, data.judged, blind)),
                    right(rich, counted(model, rich)),
                ]  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--assemblies", type=int, default=32, help="per count (default 32)")
    parser.add_argument("--jobs", type=int, default=2)
    arguments = parser.parse_args()
    head = [
        "quantity", "RPM", "kHz", "samples per turn", "lobe lines", "right, refused: tachometer",
        "no tachometer", f"recordings at {RATES_HZ[0] / 1000:g} kHz",
    ]  # fmt: skip
    made: list[list[str]] = []
    for cells in rows(arguments.assemblies, arguments.jobs):
        made.append(cells)
        print(line(cells), end="", flush=True)
    text = f"""# Counts at low sampling rates

Made by `python -m benchmarks.sampling_rates --assemblies {arguments.assemblies}`.
Simulated assemblies of rig R2 at {LOAD_NM:g} Nm, counts of 0 to 7, chance 0.125, recorded at
{SIMULATED_HZ:g} Hz and by slower loggers with an anti-alias filter. One model for each row, trained on three
quarters of the assemblies at that rate; one window of one output turn of each of the others. The noise of
0.2 Nm is that of each sample, so that a low rate has fewer samples to average it. "Right" is the share of all
recordings whose count is right, refused ones too (95 % interval by Wilson), then the share refused: with a
tachometer; without one, at a stated speed up to 2 % beside the true one; and by the same model with the
recordings of the highest rate.

"""
    Path(__file__).with_suffix(".md").write_text(text + table(head, made), encoding="utf-8")


if __name__ == "__main__":
    main()
