"""Shared code of the examples: surrogate windows, simulated on assumed rigs, and their plots."""

from __future__ import annotations

from functools import cache

import matplotlib
import numpy as np
from scipy.stats import spearmanr

from cyclofeat import Recording, Windower
from cyclofeat.datasets import make_rig_recordings, rig_preset
from cyclofeat.simulators import Noise

SAMPLING_RATE = 25_600  # Hz, as on the papers' rig
ALL_COUNTS = tuple(range(8))


@cache
def _round(rig: str, counts: tuple[int, ...], noise_nm: float | None, seed: int) -> tuple[Recording, ...]:
    """Simulate one assembly per count; cached, so that a whole gallery simulates each of them once."""
    n_jobs = 2 if len(counts) > 2 else 1
    simulated = rig_preset(rig)
    if noise_nm is not None:
        simulated = simulated.with_effects(Noise(noise_nm))
    made = make_rig_recordings(1, counts, rig=simulated, random_state=seed, with_angle=True, n_jobs=n_jobs)
    return tuple(made)


def surrogate_windows(
    n_assemblies: int,
    counts: tuple[int, ...] = ALL_COUNTS,
    rig: str = "R1",
    noise_nm: float | None = None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return windows of one output turn (1.8 s), their numbers of worn lobes, and their assemblies.

    Each of the ``n_assemblies`` per count is a separate assembly, worn on adjacent lobes from a random one
    on. Rig R1 has a brake behind a torque meter; R0 is the papers' free output. Both add 3 Nm rms of slow
    drift and noise (``noise_nm``, by default 0.2 Nm).
    """
    recordings = [
        recording for seed in range(n_assemblies) for recording in _round(rig, counts, noise_nm, seed)
    ]
    return Windower(output_turns=1).transform(recordings)


def shades(n: int) -> np.ndarray:
    """Colours from dark to light, which remain distinguishable in a grey print."""
    return matplotlib.colormaps["viridis"](np.linspace(0, 0.9, n))


def dots_by_count(ax, y: np.ndarray, values: np.ndarray, title: str, unit: str) -> None:
    """Plot a dot per assembly and a line through the means of the counts; title: Spearman's correlation."""
    counts = np.unique(y)
    ax.plot(y, values, "o", color="C0", alpha=0.5, markersize=4)
    ax.plot(counts, [values[y == count].mean() for count in counts], color="C0")
    ax.set(title=f"{title}\nrank correlation {spearmanr(y, values).statistic:+.2f}", ylabel=unit)
    ax.set(xlabel="worn lobes", xticks=counts)
