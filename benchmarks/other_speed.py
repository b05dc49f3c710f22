"""Share of discs at another speed that a counter refuses by their torque alone.

    python -m benchmarks.other_speed     # five minutes on two cores; writes benchmarks/other_speed.md

A counter for 500 RPM receives simulated assemblies at several speeds, one output turn each, without a stated
speed or a tachometer.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from cyclofeat.counting import other_speed
from cyclofeat.datasets import make_rig_recordings
from cyclofeat.signal.lobes import SPEED_TOLERANCE
from cyclofeat.simulators import Noise, Rig

NOMINAL_RPM = 500.0
SPEEDS_RPM = (400.0, 450.0, 469.0, 485.0, 500.0, 515.0, 550.0, 600.0)
NOISES_NM = (0.05, 0.2, 1.0)
ASSEMBLIES = 10  # per count
SAMPLING_RATE, WINDOW_S = 25_600.0, 1.8


def shares(rig: Rig, rpm: float, n_jobs: int) -> list[tuple[float, float]]:
    """Return the shares of worn and of healthy discs that are refused, for each noise."""
    turning = rig.replace(gearbox=rig.gearbox.replace(input_speed=rpm * 2 * np.pi / 60))
    recordings = make_rig_recordings(
        ASSEMBLIES, rig=turning.with_effects(Noise(0.0)), duration=WINDOW_S, random_state=7, n_jobs=n_jobs
    )
    worn = np.array([recording.defect_count > 0 for recording in recordings])
    found = []
    for noise in NOISES_NM:
        random = np.random.default_rng(11)
        refused = np.array(
            [
                other_speed(
                    (recording.torque + noise * random.normal(size=recording.torque.size))[np.newaxis],
                    SAMPLING_RATE,
                    NOMINAL_RPM / 60,
                    SPEED_TOLERANCE,
                )
                is not None
                for recording in recordings
            ]
        )
        found.append((float(refused[worn].mean()), float(refused[~worn].mean())))
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--jobs", type=int, default=2)
    arguments = parser.parse_args()
    lines = [
        "# Discs at another speed",
        "",
        f"Made by `python -m benchmarks.other_speed`: {8 * ASSEMBLIES} **simulated** assemblies with 0 to 7",
        f"worn lobes at each speed, one window of {WINDOW_S:g} s each, given without a speed to a counter",
        f"for {NOMINAL_RPM:g} RPM. Share refused because the lobe lines fit another speed,",
        f"worn discs / healthy ones. At 469 RPM the lobe lines fall on those of an input shaft at "
        f"{NOMINAL_RPM:g} RPM.",
        "",
        "| rig, noise | " + " | ".join(f"{rpm:g} RPM" for rpm in SPEEDS_RPM) + " |",
        "|---|" + "---|" * len(SPEEDS_RPM),
    ]  # fmt: skip
    for rig in (Rig.r0(), Rig.r1(), Rig.r2()):
        found = [shares(rig, rpm, arguments.jobs) for rpm in SPEEDS_RPM]
        for k, noise in enumerate(NOISES_NM):
            cells = [f"{worn:.2f} / {healthy:.2f}" for worn, healthy in (of[k] for of in found)]
            lines.append(f"| {rig.name}, {noise:g} Nm | " + " | ".join(cells) + " |")
            print(lines[-1], flush=True)
    Path(__file__).with_suffix(".md").write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
