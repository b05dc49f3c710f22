"""Joint posterior of all missing effects on unseen rigs: ``python -m benchmarks.joint_posterior``.

Simulates a world into a folder (an interrupted run continues), fits the posterior to four fifths of its
machines, and scores it on the others. The score is written to ``benchmarks/joint_posterior.md``.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cyclofeat._base.progress import Progress
from cyclofeat.gap.posterior import EffectPosterior, PosteriorScore, score_posterior
from cyclofeat.gap.world import Rigs, World, load_rigs, prepare_world
from cyclofeat.simulators import known_effects

PAGE = Path(__file__).with_name("joint_posterior.md")
HELD_OUT = 5  # one machine of so many, the last ones
SHARES = (1 / 4, 1.0)  # of the other machines, for the learning curve
# Assumption: sizes above which an effect counts as visible; of a factor, of either sign of its logarithm.
VISIBLE = {
    "load_drift.rms_nm": 0.2, "sensor_drift.rms_nm": 0.2, "contact_stiffness_scale.factor": 1.25,
    "contact_damping_scale.factor": 1.3, "clearance.clearance": 2e-5, "pin_errors.rms": 7e-6,
    "gain.factor": 1.008, "offset.offset_nm": 0.12, "noise.rms_nm": 0.02, "hum.amplitude_nm": 0.02,
    "quantisation.lsb_nm": 8e-3, "clock_error.relative": 1e-3,
}  # fmt: skip
FACTORS = {name for name in VISIBLE if name.endswith(".factor")}
HIGHEST_CUTOFF_HZ = 1500.0  # of a visible low-pass


def visible(rigs: Rigs) -> NDArray[np.bool_]:
    """Return True for each rig whose effects are all larger than the smallest visible ones."""
    right = np.ones(len(rigs), dtype=bool)
    for k, name in enumerate(rigs.size_names):
        size = np.exp(rigs.sizes[:, k]) if rigs.logarithmic[k] else rigs.sizes[:, k]
        if name == "torque_meter_low_pass.cutoff_hz":
            right &= ~(size > HIGHEST_CUTOFF_HZ)
        elif name in FACTORS:
            right &= ~(np.abs(np.log(size)) < np.log(VISIBLE[name]))
        elif name in VISIBLE:
            right &= ~(np.abs(size) < VISIBLE[name])
    return right


def sessions(rigs: Rigs) -> Iterator[tuple[str, Rigs, dict[str, int | bool]]]:
    """Yield the kinds of sessions: name, rigs, and what is shown of them."""
    one = np.ptp(rigs.conditions[:, :, 0], axis=1) == 0
    seen = visible(rigs)
    single, several = np.flatnonzero(one), np.flatnonzero(~one)
    yield "all, 12 recordings", rigs, {}
    yield "all, 4 recordings", rigs, {"n_recordings": 4}
    yield "one condition, 8 recordings", rigs.of(single), {"n_recordings": 8}
    yield "the same, counts unknown", rigs.of(single), {"n_recordings": 8, "counts": False}
    yield "three conditions, 12 recordings", rigs.of(several), {}
    yield "visible sizes, one condition, 8 recordings", rigs.of(single[seen[single]]), {"n_recordings": 8}
    yield "visible sizes, three conditions, 12 recordings", rigs.of(several[seen[several]]), {}


def row(name: str, score: PosteriorScore) -> str:
    """Return one line of the table of sessions."""
    columns = [name, str(score.n_rigs), f"{score.precision:.2f} / {score.recall:.2f}"]
    columns.append(f"{score.between(0, 0):.2f}")
    for least, most in ((1, 2), (3, 6)):
        with_ties = score.between(least, most, ties=True)
        columns.append(f"{score.between(least, most):.2f} / {with_ties:.2f}")
    columns.append(f"{score.calibration_error:.3f}")
    columns.append(f"{np.mean(list(score.coverage.values())):.2f}")
    return f"| {' | '.join(columns)} |"


def fitted(rigs: Rigs, n_jobs: int) -> tuple[EffectPosterior, float]:
    """Return a posterior and the seconds that its fit took."""
    began = time.perf_counter()
    return EffectPosterior(n_jobs=n_jobs).fit(rigs), time.perf_counter() - began


def written(rigs: Rigs, n_jobs: int) -> str:
    """Return the page: fit, score, table."""
    machines = np.unique(rigs.machines)
    first_held = machines[-(machines.size // HELD_OUT)]
    held = rigs.of(rigs.machines >= first_held)
    known = machines[machines < first_held]
    heading = [
        "| session | rigs | precision / recall | 0 effects | 1 to 2 effects | 3 to 6 effects | "
        "calibration error | coverage of 90 % intervals |",
        "|---|---|---|---|---|---|---|---|",
    ]
    parts = []
    for share in SHARES:
        train = rigs.of(rigs.machines <= known[round(share * known.size) - 1])
        posterior, seconds = fitted(train, n_jobs)
        scores = {name: score_posterior(posterior, some, **shown) for name, some, shown in sessions(held)}
        title = (
            f"## Fitted to {len(train)} rigs of {np.unique(train.machines).size} machines, in {seconds:.0f} s"
        )
        parts += ["", title, "", *heading, *(row(name, score) for name, score in scores.items())]
    whole = scores["all, 12 recordings"]
    parts += ["", "## Effects and sizes, the last fit, all, 12 recordings", ""]
    parts += ["| effect | recall | precision | coverage of 90 % intervals |", "|---|---|---|---|"]
    for name, recall in whole.effect_recall.items():
        covered = [f"{key.partition('.')[2]} {value:.2f}" for key, value in whole.coverage.items()
                   if key.startswith(f"{name}.")]  # fmt: skip
        parts.append(f"| {name} | {recall:.2f} | {whole.effect_precision[name]:.2f} | {', '.join(covered)} |")
    return "\n".join(parts)


INTRODUCTION = """# Joint posterior of all missing effects

`python -m benchmarks.joint_posterior` draws rigs with none to six of {n} effects at once, fits
`cyclofeat.gap.posterior.EffectPosterior`, and scores it on machines that it has not seen. Columns with two
shares: all effects named exactly and no other; the same where look-alikes (gain, offset, set-point of the
load; drifts of load and sensor; errors of clock and speed) may stand for each other. Sizes follow the priors
of the library, so that many effects are too small to be seen; "visible sizes" keeps rigs whose effects are
all larger than the smallest sizes listed in the script. Rigs and recordings are simulated by the simulator
that the posterior learns from: no score is of measured recordings.

The effects are {names}.
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument(
        "--folder", type=Path, default=Path("build/joint_posterior"), help="folder of the world"
    )
    parser.add_argument("--machines", type=int, default=1000, help="machines to simulate; 0 takes the folder")
    parser.add_argument("--effects", nargs="+", help="names of the effects (default: all)")
    parser.add_argument("--n-jobs", type=int, default=2)
    parser.add_argument("--out", type=Path, default=PAGE)
    arguments = parser.parse_args()
    if arguments.machines:
        effects = arguments.effects and [known_effects()[name]() for name in arguments.effects]
        world, progress = World(effects=effects), Progress("shards")
        rigs = prepare_world(
            world, arguments.folder, arguments.machines, n_jobs=arguments.n_jobs, progress=progress
        )
    else:
        rigs = load_rigs(arguments.folder)
    text = (
        INTRODUCTION.format(n=len(rigs.names), names=", ".join(rigs.names))
        + written(rigs, arguments.n_jobs)
        + "\n"
    )
    arguments.out.write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
