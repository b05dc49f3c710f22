"""What the examples share: surrogate windows, simulated on assumed rigs, never measured, and their dots."""

from __future__ import annotations

from functools import cache

import matplotlib
import numpy as np
from scipy.stats import spearmanr

from cyclofeat import Recording, Windower
from cyclofeat.datasets import make_rig_recordings

SAMPLING_RATE = 25_600  # Hz, as on the papers' rig
ALL_COUNTS = tuple(range(8))


@cache
def _round(rig: str, counts: tuple[int, ...], noise_nm: float | None, seed: int) -> tuple[Recording, ...]:
    """One assembly per count. Kept, so that a whole gallery simulates each of them once."""
    n_jobs = 2 if len(counts) > 2 else 1
    made = make_rig_recordings(
        1, counts, rig=rig, noise_nm=noise_nm, random_state=seed, with_angle=True, n_jobs=n_jobs
    )
    return tuple(made)


def surrogate_windows(
    n_assemblies: int,
    counts: tuple[int, ...] = ALL_COUNTS,
    rig: str = "R1",
    noise_nm: float | None = None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Windows of one output turn (1.8 s), their numbers of worn lobes, and their assemblies.

    Each of ``n_assemblies`` per count is an assembly of its own, worn on neighbouring lobes from a random one
    on. Rig R1 has a brake behind a torque meter; R0 is the papers' free output. Both add 3 Nm rms of slow
    drift and 0.2 Nm of noise, unless ``noise_nm`` says otherwise.
    """
    recordings = [
        recording for seed in range(n_assemblies) for recording in _round(rig, counts, noise_nm, seed)
    ]
    return Windower(output_turns=1).transform(recordings)


def shades(n: int) -> np.ndarray:
    """Colours from dark to light, which a grey print keeps apart."""
    return matplotlib.colormaps["viridis"](np.linspace(0, 0.9, n))


def dots_by_count(ax, y: np.ndarray, values: np.ndarray, title: str, unit: str, colour: str = "C0") -> None:
    """A dot per assembly, a line through the means of the counts, Spearman's rank correlation above."""
    counts = np.unique(y)
    ax.plot(y, values, "o", color=colour, alpha=0.5, markersize=4)
    ax.plot(counts, [values[y == count].mean() for count in counts], color=colour)
    ax.set(title=f"{title}\nrank correlation {spearmanr(y, values).statistic:+.2f}", ylabel=unit)
    ax.set(xlabel="worn lobes", xticks=counts)
