"""Probability of detection: exact counts against depth of wear, noise and output turns, rig R1."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sklearn.model_selection import StratifiedGroupKFold

from benchmarks.counting import _designs as designs
from benchmarks.counting._rows import default_trees, shares
from benchmarks.counting._work import JUDGED_NOISE, Work
from cyclofeat.counting import aligned_proba, combine_proba

Float = NDArray[np.float64]

NOISES = (0.2, 0.5, 1.0, 2.0, 4.0, 8.0)
TURNS = (1, 2, 4)
COLUMNS = ("rig", "depth", "noise_nm", "turns", "worn", "assemblies", "right")


def detection(work: Work, noise: float) -> dict[str, Any]:
    """Rows of the plan's table and points of the curves at one noise.

    One counter serves all depths, because the depth of the wear is unknown in use; folds are by assembly.
    """

    def run() -> dict[str, Any]:
        X, y, member, depths, number = [], [], [], [], []
        for depth, design in (designs.DEPTHS | {1.0: designs.EIGHT}).items():
            F, windows = work.features(design, noise, JUDGED_NOISE, n_windows=max(TURNS))
            X.append(F)
            y.append(windows.y)
            # The designs share seeds of assemblies and of noise: an assembly of one depth has twins at the
            # other depths, in the same place, which must be on the same side of a fold.
            member.append(windows.assembly)
            depths.append(np.full(len(windows.y), depth))
            number.append(windows.number)
        data, counts, members = np.concatenate(X), np.concatenate(y), np.concatenate(member)
        deep, order = np.concatenate(depths), np.concatenate(number)
        classes = np.unique(counts)
        proba = np.zeros((len(counts), classes.size))
        for train, test in StratifiedGroupKFold(5, shuffle=True, random_state=0).split(data, counts, members):
            fitted = default_trees().fit(data[train], counts[train])
            proba[test] = aligned_proba(fitted, data[test], classes)
        return _summary(proba, counts, members, deep, order)

    return work.kept(f"detection-{noise:g}", run)


def _summary(proba: Float, counts: Any, members: Any, deep: Float, order: Any) -> dict[str, Any]:
    rows, points = [], []
    assert order.max() < 100
    for turns in TURNS:
        # blocks of consecutive windows: each is one recording
        at_depth = np.unique(deep, return_inverse=True)[1]
        named = (at_depth * 10_000 + members) * 100 + order // turns
        _, block = np.unique(named, return_inverse=True)
        combined = combine_proba(proba, block, 0.0)
        first = np.unique(block, return_index=True)[1]
        truth, member, depth = counts[first], members[first], deep[first]
        for value in np.unique(depth):
            at = depth == value
            found = shares((np.argmax(combined[at], axis=1) == truth[at]).astype(float), member[at])
            points.append({"depth": float(value), "turns": turns} | found)
            for n in range(int(truth.max())):
                pair = at & ((truth == n) | (truth == n + 1))
                right = (combined[pair, n + 1] > combined[pair, n]) == (truth[pair] == n + 1)
                names, which = np.unique(member[pair], return_inverse=True)
                by_assembly = np.bincount(which, weights=right) / np.bincount(which)
                rows.append([float(value), turns, n, int(names.size), round(float(by_assembly.sum()), 4)])
    return {"rows": rows, "points": points}


def done(work: Work) -> list[float]:
    """Return the noises whose trials exist."""
    return [noise for noise in NOISES if work.found(f"detection-{noise:g}") is not None]


def write_table(work: Work, path: Path) -> None:
    """Return the plan's table from the stored results."""
    with path.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(COLUMNS)
        for noise in done(work):
            for depth, turns, worn, assemblies, right in detection(work, noise)["rows"]:
                writer.writerow(["R1", f"{depth:g}", f"{noise:g}", turns, worn, assemblies, f"{right:g}"])


def draw(work: Work, path: Path) -> None:
    """Plot exact counts against depth, one panel per number of output turns, one line per noise."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, panels = plt.subplots(1, len(TURNS), figsize=(10, 3.6), sharey=True, layout="constrained")
    colours = plt.get_cmap("viridis")(np.linspace(0, 0.9, len(NOISES)))
    for panel, turns in zip(panels, TURNS, strict=True):
        for noise, colour in zip(done(work), colours, strict=False):
            points = [p for p in detection(work, noise)["points"] if p["turns"] == turns]
            depth, value = [p["depth"] for p in points], [p["value"] for p in points]
            low, high = zip(*(p["interval"] for p in points), strict=True)
            panel.plot(depth, value, marker="o", ms=3, color=colour, label=f"{noise:g} Nm")
            panel.fill_between(depth, low, high, color=colour, alpha=0.12, lw=0)
        panel.axhline(1 / 8, color="0.5", lw=0.8, ls=":")
        panel.set(
            title=f"{turns} output turn{'s' if turns > 1 else ''} ({turns * 1.8:g} s)", xlim=(0.05, 1.02)
        )
        panel.set_xlabel("depth of the wear (share of the lobe's width)")
    panels[0].set(ylabel="share of exact counts", ylim=(0, 1.02))
    panels[0].text(0.98, 1 / 8 + 0.01, "chance", ha="right", va="bottom", color="0.4", fontsize=8)
    panels[-1].legend(title="white noise", fontsize=8, loc="lower right")
    figure.savefig(path, dpi=130)
    plt.close(figure)
