"""Speed and memory of the features. ``make bench-features`` writes the table next to it.

All rows use the same windows, 1.8 s at 25.6 kHz (46,080 samples) of synthetic torque, and, except for the row
on two cores, one core with one BLAS thread. Each figure is the median of several repeats; compared variants
run alternately. Times are processor times unless stated.
"""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import tempfile
import threading
import time
import warnings
from functools import partial
from pathlib import Path
from typing import Any

import antropy
import librosa
import numpy as np
import psutil
import pycatch22
import tsfel
from _markdown import table
from _timing import Work, in_turn, on_free_cores, processor_seconds, ratio
from scipy import signal
from threadpoolctl import threadpool_limits

from cyclofeat.features import TorqueFeatures
from cyclofeat.signal import (
    band_power,
    narrowband_ratio,
    normalized_entropy,
    shannon_entropy,
    spectral_centroid,
    spectral_flatness,
    spectral_rolloff,
    welch_psd,
)

SAMPLING_RATE = 25_600
N_SAMPLES = 46_080
SEGMENT, N_FFT = 10_240, 16_384  # MATLAB's defaults for windows of this length
REPEATS = 9
MANY = 10_000


def torque(n_windows: int) -> np.ndarray:
    """Windows of mesh and lobe lines, drift and noise around 22 Nm."""
    rng = np.random.default_rng(0)
    phase = 2 * np.pi * 500 / 60 * np.arange(N_SAMPLES) / SAMPLING_RATE
    lines = sum(np.outer(rng.normal(size=n_windows), np.cos(16 / 15 * k * phase)) for k in (1, 7, 15, 22, 30))
    drift = np.outer(rng.normal(size=n_windows), np.sin(phase / 20))
    return np.asarray(22 + lines + drift + rng.normal(size=(n_windows, N_SAMPLES)))


def compared(one: Work, other: Work, repeats: int = REPEATS) -> tuple[float, float, float]:
    """Medians of both in seconds, and the median of their ratio."""
    times = in_turn((one, other), repeats)
    return statistics.median(times[0]), statistics.median(times[1]), ratio(*times)


def spectral_set(X: np.ndarray) -> None:
    """Entropy both ways, flatness, centroid, roll-off, narrowband ratio and band powers from one density."""
    frequencies, psd = welch_psd(X, SAMPLING_RATE)
    shannon_entropy(psd)
    normalized_entropy(psd)
    spectral_flatness(psd)
    spectral_centroid(psd, frequencies)
    spectral_rolloff(psd, frequencies)
    narrowband_ratio(psd, frequencies)
    band_power(psd, frequencies)


def four_features(X: np.ndarray) -> list[np.ndarray]:
    """The features that antropy and librosa also have."""
    frequencies, psd = welch_psd(X, SAMPLING_RATE, "ripple")
    return [
        shannon_entropy(psd),
        spectral_flatness(psd),
        spectral_centroid(psd, frequencies),
        spectral_rolloff(psd, frequencies),
    ]


def four_by_peers(X: np.ndarray, segment: int = SEGMENT, n_fft: int = N_FFT) -> list[np.ndarray]:
    """Entropy by antropy, the others by librosa from one density; our segments, the "ripple" preset."""
    frequencies, psd = signal.welch(X, SAMPLING_RATE, nperseg=segment, nfft=n_fft)
    spectrum = psd[..., np.newaxis]
    return [
        antropy.spectral_entropy(X, SAMPLING_RATE, method="welch", nperseg=segment),
        librosa.feature.spectral_flatness(S=spectrum, power=1.0, amin=1e-300)[..., 0, 0],
        librosa.feature.spectral_centroid(S=spectrum, freq=frequencies)[..., 0, 0],
        librosa.feature.spectral_rolloff(S=spectrum, freq=frequencies, roll_percent=0.95)[..., 0, 0],
    ]


def four_by_peers_defaults(X: np.ndarray) -> None:
    """The same with the libraries' defaults: short frames, a spectrum for each feature."""
    antropy.spectral_entropy(X, SAMPLING_RATE, method="welch")
    librosa.feature.spectral_flatness(y=X)
    librosa.feature.spectral_centroid(y=X, sr=SAMPLING_RATE)
    librosa.feature.spectral_rolloff(y=X, sr=SAMPLING_RATE, roll_percent=0.95)


def check_that_peers_agree() -> None:
    """Check that equal definitions (segments of 8192 samples, not padded) give equal values."""
    X = torque(3)[:, :36_864]
    for ours, theirs in zip(four_features(X), four_by_peers(X, 8192, 8192), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-8)


def cold_import_seconds() -> float:
    """Wall time of ``import cyclofeat`` in a new interpreter, less that of an empty one."""
    times = []
    for code in ("import cyclofeat", "pass"):
        runs = []
        for _ in range(5):
            began = time.perf_counter()
            subprocess.run([sys.executable, "-c", code], check=True)
            runs.append(time.perf_counter() - began)
        times.append(statistics.median(runs))
    return times[0] - times[1]


def transform_memory_map(path: str) -> None:
    """Fit and transform a memory map of MANY windows; print the peak of this process's own memory in KiB."""
    peak, done, here = [0], threading.Event(), psutil.Process()

    def watch() -> None:
        while not done.wait(0.005):
            memory = here.memory_info()
            peak[0] = max(peak[0], (memory.rss - memory.shared) // 1024)

    watcher = threading.Thread(target=watch)
    watcher.start()
    X = np.memmap(path, np.float32, "r", shape=(MANY, N_SAMPLES))
    rows = TorqueFeatures(SAMPLING_RATE).fit_transform(X, np.arange(MANY) % 8)
    done.set()
    watcher.join()
    if rows.shape[0] != MANY or not np.isfinite(rows).all():
        raise RuntimeError(f"{MANY} finite rows expected, got {rows.shape}")
    print(peak[0])


def memory_map_gib() -> float:
    """Peak of the process's own memory in GiB over MANY windows (1.7 GiB of file)."""
    some = torque(100).astype(np.float32)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "windows.f32"
        with path.open("wb") as file:
            for _ in range(MANY // len(some)):
                file.write(some.tobytes())
        run = subprocess.run(
            [sys.executable, __file__, str(path)],
            capture_output=True,
            text=True,
            check=True,
            env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
        )
    return int(run.stdout) / 2**20


def on_two_cores() -> str:
    """How many times faster ``n_jobs=2`` is than one thread."""
    X = torque(132)  # 6 chunks of windows
    one, two = TorqueFeatures(SAMPLING_RATE).fit(X), TorqueFeatures(SAMPLING_RATE, n_jobs=2).fit(X)
    return on_free_cores(lambda: one.transform(X), lambda: two.transform(X))


def results() -> str:
    """Return the results as a Markdown table."""
    check_that_peers_agree()
    X = torque(44)
    n = len(X)
    rows: list[tuple[str, str, str]] = []

    same = {"window": "hamming", "nperseg": SEGMENT, "nfft": N_FFT, "detrend": False}
    for name, options, goal in (
        ("full spectral set, one bare `scipy.signal.welch` (its defaults)", {}, "<= 1.5 x"),
        ("the same, `scipy.signal.welch` with our segments", same, ""),
    ):
        ours, bare, factor = compared(
            lambda: spectral_set(X),
            lambda options=options: signal.welch(X, SAMPLING_RATE, **options),  # type: ignore[misc]
        )
        rows.append((name, f"{ours / n * 1e3:.2f} ms, {bare / n * 1e3:.2f} ms: {factor:.2f} x", goal))
    four = "entropy, flatness, centroid, roll-off by antropy and librosa, our segments, one density"
    for name, by_peers, repeats in (
        (four, four_by_peers, REPEATS),
        ("the same by their own defaults", four_by_peers_defaults, 5),
    ):
        theirs, ours, factor = compared(partial(by_peers, X), lambda: four_features(X), repeats)
        text = f"{theirs / n * 1e3:.2f} ms, ours {ours / n * 1e3:.2f} ms: {factor:.1f} x faster"
        rows.append((name, text, ">= 2 x"))

    features = TorqueFeatures(SAMPLING_RATE).fit(X, np.arange(n) % 8)
    n_columns = features.get_feature_names_out().size
    taken = statistics.median(processor_seconds(lambda: features.transform(X)) for _ in range(REPEATS)) / n
    rows.append((f'`TorqueFeatures("all")`, {n_columns} features', f"{taken * 1e3:.1f} ms", "<= 10 ms"))

    window = list(X[0])
    config = tsfel.get_features_by_domain()

    def extracted() -> Any:
        return tsfel.time_series_features_extractor(config, X[0], fs=SAMPLING_RATE, verbose=0)

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        began = time.process_time()
        n_extracted = extracted().shape[1]
        slow = time.process_time() - began >= 20
        for name, work, repeats in (
            ("pycatch22, 22 features", lambda: pycatch22.catch22_all(window), 5),
            (f"tsfel's full extractor, {n_extracted} features", extracted, 1 if slow else 3),
        ):
            theirs, ours, _ = compared(work, lambda: features.transform(X), repeats)
            text = f"{theirs * 1e3:.0f} ms, ours {ours / n * 1e3:.1f} ms: {theirs / (ours / n):.0f} x faster"
            rows.append((name, text, ">= 10 x"))
    two_cores = "two cores (`n_jobs=2`: threads), wall time while both are free"
    memory = f"peak memory of its own, {MANY:,} windows as a float32 memory map"
    rows += [
        (two_cores, on_two_cores(), ">= 1.7 x"),
        (memory, f"{memory_map_gib():.2f} GiB", "< 1 GiB"),
        ("cold `import cyclofeat`", f"{cold_import_seconds():.2f} s", "< 1.5 s"),
    ]
    return table(("per window of 1.8 s at 25.6 kHz, one core", "result", "goal"), rows)


def main() -> None:
    text = f"Made by `make bench-features`.\n\n{results()}"
    print(text, end="")
    Path(__file__).with_suffix(".md").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    with threadpool_limits(1):
        if sys.argv[1:]:  # the process whose memory is measured
            transform_memory_map(sys.argv[1])
        else:
            main()
