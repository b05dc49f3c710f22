"""Probability of detection: exact counts against depth of wear, noise and output turns, rig R1."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sklearn.model_selection import StratifiedGroupKFold, cross_val_predict

from benchmarks._markdown import wilson
from benchmarks.counting._data import N_COUNTS, N_LOBES, RATES, SOLVER
from cyclofeat.counting import make_lobe_counter
from cyclofeat.counting.calibration.pooling import combine_proba
from cyclofeat.datasets import rig_preset
from cyclofeat.simulators.sampling import draw_worn_lobes, recording_seed, sample_runs

Float = NDArray[np.float64]

DEPTHS = (0.1, 0.2, 0.35, 0.5, 0.7, 1.0)
NOISES = (0.2, 0.5, 1.0, 2.0, 4.0, 8.0)
TURNS = (1, 2, 4)
_RATE, _TURN_S = RATES["output_torque"], 1.8
_SEED = 10


def detection(n_per_count: int) -> dict[str, Any]:
    """Return the rows of the plan's table and the points of the curves.

    One counter for each noise serves all depths, because the depth of the wear is unknown in use.
    """
    clean = np.stack([_torque(depth, n_per_count) for depth in DEPTHS])
    counts = np.arange(clean.shape[1]) % N_COUNTS
    rows: list[list[Any]] = []
    points: list[list[float]] = []
    for noise in NOISES:
        proba = _held_out(clean, counts, noise)
        for depth, of_depth in zip(DEPTHS, proba, strict=True):
            for turns in TURNS:
                # Blocks of consecutive windows: each is one recording.
                block = np.arange(of_depth.shape[0] * max(TURNS)) // turns
                together = combine_proba(of_depth.reshape(-1, N_COUNTS), block, 0.0)
                recordings = together.reshape(len(counts), -1, N_COUNTS)
                # An assembly that gave several recordings counts by their share.
                right = (recordings.argmax(axis=2) == counts[:, np.newaxis]).mean(axis=1)
                low, high = wilson(round(right.sum()), right.size)
                points.append([noise, turns, depth, right.mean(), low, high])
                for n in range(N_COUNTS - 1):
                    pair = (counts == n) | (counts == n + 1)
                    more = recordings[pair, :, n + 1] > recordings[pair, :, n]
                    told = (more == (counts[pair] == n + 1)[:, np.newaxis]).mean(axis=1)
                    rows.append([noise, turns, depth, n, told.size, round(told.sum(), 4)])
    return {"rows": sorted(rows), "points": points}


def _torque(depth: float, n_per_count: int) -> NDArray[np.float32]:
    """Return windows without noise, shape (n_assemblies, max(TURNS), n_samples).

    Assemblies of one number are twins at all depths: same pins, same worn lobes.
    """
    rig = rig_preset("R1").without("noise")
    plans = []
    for index in range(n_per_count * N_COUNTS):
        worn = draw_worn_lobes(index % N_COUNTS, N_LOBES, np.random.default_rng([_SEED, index]), depth=depth)
        plans.append(rig.plan_run(
            worn, duration=max(TURNS) * _TURN_S, sampling_rate=_RATE,
            random_state=recording_seed(_SEED, rig.name, index), solver=SOLVER, torque_in=False, motion=False,
        ))  # fmt: skip
    torque = [run.record().torque_out.astype(np.float32) for run in sample_runs(plans)]
    return np.stack(torque).reshape(len(plans), max(TURNS), -1)


def _held_out(clean: NDArray[np.float32], counts: NDArray[np.int64], noise: float) -> Float:
    """Return probabilities of the counts of assemblies held out, shape (*clean.shape[:3], N_COUNTS)."""
    lobe_map, trees = make_lobe_counter(_RATE)
    random = np.random.default_rng(_SEED)
    # Twins have the same noise too.
    white = noise * random.standard_normal(clean.shape[1:], dtype=np.float32)
    X = np.concatenate(
        [lobe_map.fit_transform((one + white).reshape(-1, clean.shape[-1]).astype(float)) for one in clean]
    )
    assembly = np.tile(np.repeat(np.arange(len(counts)), max(TURNS)), len(clean))
    folds = StratifiedGroupKFold(5, shuffle=True, random_state=0)
    proba = cross_val_predict(trees, X, counts[assembly], groups=assembly, cv=folds, method="predict_proba")
    return np.asarray(proba.reshape(*clean.shape[:3], N_COUNTS))


def write_table(found: Mapping[str, Any], path: Path) -> None:
    """Write the table that plans are made from."""
    with path.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(["rig", "depth", "noise_nm", "turns", "worn", "assemblies", "right"])
        for noise, turns, depth, worn, assemblies, right in found["rows"]:
            writer.writerow(["R1", f"{depth:g}", f"{noise:g}", turns, worn, assemblies, f"{right:g}"])


def draw(found: Mapping[str, Any], path: Path) -> None:
    """Plot exact counts against depth, one panel per number of output turns, one line per noise."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, panels = plt.subplots(1, len(TURNS), figsize=(10, 3.6), sharey=True, layout="constrained")
    colours = plt.get_cmap("viridis")(np.linspace(0, 0.9, len(NOISES)))
    for panel, turns in zip(panels, TURNS, strict=True):
        for noise, colour in zip(NOISES, colours, strict=True):
            at = np.array([point[2:] for point in found["points"] if point[:2] == [noise, turns]])
            depth, value, low, high = at.T
            panel.plot(depth, value, marker="o", ms=3, color=colour, label=f"{noise:g} Nm")
            panel.fill_between(depth, low, high, color=colour, alpha=0.12, lw=0)
        panel.axhline(1 / N_COUNTS, color="0.5", lw=0.8, ls=":")
        panel.set(
            title=f"{turns} output turn{'s' if turns > 1 else ''} ({turns * _TURN_S:g} s)", xlim=(0.05, 1.02)
        )
        panel.set_xlabel("depth of the wear (share of the lobe's width)")
    panels[0].set(ylabel="share of exact counts", ylim=(0, 1.02))
    panels[0].text(0.98, 1 / 8 + 0.01, "chance", ha="right", va="bottom", color="0.4", fontsize=8)
    panels[-1].legend(title="white noise", fontsize=8, loc="lower right")
    figure.savefig(path, dpi=130)
    plt.close(figure)
