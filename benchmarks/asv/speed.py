"""Speed of features, counter and simulator over commits: ``make bench-asv``.

Only what users call, so that the same file measures old commits. What compiles does so in ``setup``.
"""

from __future__ import annotations

import numpy as np

SAMPLING_RATE = 25_600
N_SAMPLES = 46_080  # 1.8 s, an output turn at 500 RPM


def torque(n_windows: int) -> np.ndarray:
    """Windows of torque in Nm: lines of the lobes around 22 Nm, and noise."""
    random = np.random.default_rng(0)
    lobes = 2 * np.pi * 500 / 60 * 16 / 15 * np.arange(N_SAMPLES) / SAMPLING_RATE
    lines = sum(np.outer(random.normal(size=n_windows), np.cos(order * lobes)) for order in (1, 7, 15))
    return np.asarray(22 + lines + random.normal(size=(n_windows, N_SAMPLES)))


class Features:
    """Features of eight windows."""

    params = ("TorqueFeatures", "LobeMap", "OrderSpectrum", "WaveletMinimaOverlap")
    param_names = ("transformer",)

    def setup(self, transformer: str) -> None:
        from cyclofeat import features

        self.windows = torque(8)
        self.transformer = getattr(features, transformer)(sampling_rate=SAMPLING_RATE).fit(self.windows)
        self.transformer.transform(self.windows)

    def time_transform(self, transformer: str) -> None:
        self.transformer.transform(self.windows)

    def peakmem_transform(self, transformer: str) -> None:
        self.transformer.transform(self.windows)


class Counter:
    """A counter of 100 trees on 48 windows of four counts."""

    def setup(self) -> None:
        from cyclofeat.counting import make_lobe_counter

        self.windows = torque(48)
        self.counts = np.repeat([0, 1, 3, 5], 12)
        self.windows += self.counts[:, None] * np.sin(np.linspace(0, 150, N_SAMPLES))
        self.counter = make_lobe_counter(sampling_rate=SAMPLING_RATE, n_trees=100)
        self.counter.fit(self.windows, self.counts)

    def time_fit(self) -> None:
        self.counter.fit(self.windows, self.counts)

    def time_predict(self) -> None:
        self.counter.predict_proba(self.windows[:8])


class Simulator:
    """A worn gearbox for 0.25 s of its time: alone, and eight at once."""

    timeout = 300  # the first commit compiles

    def setup(self) -> None:
        from cyclofeat.simulators import CycloidalGearbox, LobeDefects

        self.worn = CycloidalGearbox.steel(), LobeDefects.worn(3)
        self.time_one()
        self.time_eight_at_once()

    def time_one(self) -> None:
        from cyclofeat.simulators import simulate

        simulate(*self.worn, duration=0.25)

    def time_eight_at_once(self) -> None:
        from cyclofeat.simulators import simulate_many

        gearbox, defects = self.worn
        simulate_many([gearbox] * 8, [defects] * 8, duration=0.25, kernel="batch")


def time_import() -> None:
    """Start of Python and ``import cyclofeat``."""
    import subprocess
    import sys

    subprocess.run([sys.executable, "-c", "import cyclofeat"], check=True)
