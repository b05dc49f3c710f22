"""Simulated windows of one output turn, one of each assembly, and the noise that is added to them.

All of them are surrogates on assumed rigs.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sklearn.model_selection import StratifiedKFold, cross_val_predict

from cyclofeat.counting import passage_of_lobe_zero
from cyclofeat.datasets import make_rig_recordings, rig_preset
from cyclofeat.recordings import Windower, WindowSet
from cyclofeat.signal.lobes import reduce_rate
from cyclofeat.simulators import Solver

N_COUNTS, N_LOBES = 8, 15
# Drives log motor currents at some kHz.
RATES = {"output_torque": 25_600.0, "input_torque": 25_600.0, "motor_current": 8_000.0}
REDUCED_RATE = 2_560.0
SOLVER = Solver(integrator="adams_bashforth")


def simulated(rig: str, n_per_count: int, quantity: str, seed: int) -> tuple[WindowSet, NDArray[np.int64]]:
    """Return windows without white noise of the torque meter, and how many wheels are worn in each."""
    recordings = make_rig_recordings(
        n_per_count, range(N_COUNTS), rig=rig_preset(rig).without("noise"), output_turns=1.0,
        sampling_rate=RATES[quantity], random_state=seed, with_angle=True, kernel="auto", solver=SOLVER,
        quantity=quantity,
    )  # fmt: skip
    wheels = np.array([len(one.meta["wheels_from_1"]) for one in recordings])
    return Windower().windows(recordings), wheels


def held_out(counter: Any, X: Any, y: Any, n_folds: int = 5, **known: Any) -> int:
    """Return how many windows are counted right by counters that never saw their assembly.

    ``known`` is what else ``fit`` is told of each window.
    """
    folds = StratifiedKFold(n_folds, shuffle=True, random_state=0)  # one window is one assembly
    return int((cross_val_predict(counter, X, y, cv=folds, params=known) == y).sum())


def rows_known(windows: WindowSet) -> dict[str, Any]:
    """Return the worn lobes of windows and when lobe 0 passes, which a network learns from."""
    return {
        "worn": windows.worn_table(N_LOBES),
        "passage": passage_of_lobe_zero(windows.start_angle, N_LOBES),
    }


def noisy(windows: WindowSet, noise: float, seed: int) -> WindowSet:
    """Add white noise; the same seed gives the same noise except for its size."""
    white = np.random.default_rng([seed, 77]).standard_normal(windows.X.shape)
    return replace(windows, X=windows.X + noise * white)


def reduced(windows: WindowSet) -> WindowSet:
    """Return the windows at about a tenth of the rate, as :class:`LobeMap` reduces them itself."""
    X, rate = reduce_rate(windows.X, windows.sampling_rate, REDUCED_RATE)
    return replace(windows, X=X, sampling_rate=rate)
