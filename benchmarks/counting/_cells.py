"""Results of the benchmark; each is a plain dictionary of numbers of windows counted right, for JSON."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.counting import _peers as peers
from benchmarks.counting._data import held_out, noisy, reduced, rows_known, simulated
from benchmarks.counting._oracle import Twins
from cyclofeat.counting import (
    LobeCounter,
    Protocol,
    evaluate,
    make_lobe_counter,
    passage_of_lobe_zero,
)
from cyclofeat.recordings import WindowSet
from cyclofeat.signal.lobes import LobeComb, lobe_lines

# White noise in Nm; that of motor currents in A, besides the current sensor's own.
NOISES = {
    "output_torque": (0.05, 0.2, 0.5, 1.0, 2.0), "input_torque": (0.015, 0.06), "motor_current": (0.0, 0.5),
}  # fmt: skip
ROWS, TREES = "rows of worn lobes (ours)", "lobe map and trees (ours)"
# Seeds of the assemblies that are tested, and of those that train only; of the noise on either too.
_JUDGED, _TRAINING = 11, 12


def cells(rig: str, quantity: str, n_per_count: int, aeon: Path) -> dict[str, dict[str, int]]:
    """Return the windows that each method counts right in folds by assembly, by noise."""
    clean, _ = simulated(rig, n_per_count, quantity, _JUDGED)
    levels = [noisy(clean, noise, _JUDGED) for noise in NOISES[quantity]]
    slow = [reduced(windows) for windows in levels]
    rocket = peers.minirocket([one.X for one in slow], aeon)
    return {
        f"{noise:g}": {
            TREES: held_out(make_lobe_counter(windows.sampling_rate), windows.X, windows.y, 3),
            ROWS: held_out(_rows(one), one.X, one.y, 3, **rows_known(one)),
        }
        | peers.right(windows, one, features)
        for noise, windows, one, features in zip(NOISES[quantity], levels, slow, rocket, strict=True)
    }


def accuracy(rig: str, n_per_count: int) -> dict[str, int]:
    """Return the windows of output torque that the counter counts right in five folds, by noise."""
    clean, _ = simulated(rig, n_per_count, "output_torque", _JUDGED)
    return {
        f"{noise:g}": held_out(
            make_lobe_counter(clean.sampling_rate), noisy(clean, noise, _JUDGED).X, clean.y
        )
        for noise in NOISES["output_torque"]
    }


def twins(rig: str, n_per_count: int, n_twins: int) -> dict[str, dict[str, int]]:
    """Return what counters and the oracle count right that learn from other assemblies of the rig."""
    clean, _ = simulated(rig, n_per_count, "output_torque", _JUDGED)
    others, wheels = simulated(rig, n_twins, "output_torque", _TRAINING)
    comb = LobeComb(ar_order=16 if rig == "R2" else 0)  # R0 has no resonance
    found = {}
    for noise in NOISES["output_torque"]:
        judged, training = reduced(noisy(clean, noise, _JUDGED)), reduced(noisy(others, noise, _TRAINING))
        known, asked = (
            lobe_lines(one.X, one.sampling_rate, 500 / 60, comb).lines for one in (training, judged)
        )
        oracle = Twins().fit(
            known, training.y, wheels, training.worn_table(15), passage_of_lobe_zero(training.start_angle)
        )
        rows = _rows(training).fit(training.X, training.y, **rows_known(training))
        found[f"{noise:g}"] = {
            "oracle": _right(oracle.predict(asked), judged),
            TREES: _trained_elsewhere(training, judged),
            ROWS: _right(rows.predict(judged.X), judged),
        }
    return found


def checks(n_per_count: int) -> dict[str, int]:
    """Return other figures of rig R1 with 0.2 Nm of noise."""
    judged, of_r0 = (
        reduced(noisy(simulated(rig, n_per_count, "output_torque", seed)[0], 0.2, seed))
        for rig, seed in (("R1", _JUDGED), ("R0", _TRAINING))
    )
    permuted = np.random.default_rng(0).permutation(judged.y)
    located = evaluate(
        LobeCounter(judged.sampling_rate, n_splits=2), judged.X, judged.y, judged.groups,
        lobes=(judged.worn_table(15), passage_of_lobe_zero(judged.start_angle)),
        protocol=Protocol(n_splits=3, random_state=0),
    )  # fmt: skip
    return {
        "permuted": held_out(make_lobe_counter(judged.sampling_rate), judged.X, permuted),
        "exact lobes": round(located.exact_lobes * len(judged)),
        "from R0": _trained_elsewhere(of_r0, judged),
    }


def _rows(windows: WindowSet) -> Any:
    """Return a counter of rows; its calibration hardly changes a count."""
    return make_lobe_counter(windows.sampling_rate, kind="network", random_state=0).set_params(n_splits=0)


def _trained_elsewhere(training: WindowSet, judged: WindowSet) -> int:
    counter = make_lobe_counter(judged.sampling_rate)
    return _right(counter.fit(training.X, training.y).predict(judged.X), judged)


def _right(counts: Any, windows: WindowSet) -> int:
    return int((counts == windows.y).sum())
