"""Other methods on the same folds: the papers' one by one, pycatch22, tsfel, MiniRocket."""

from __future__ import annotations

import importlib.util
import subprocess
import tempfile
import warnings
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sklearn.base import BaseEstimator
from sklearn.linear_model import RidgeClassifierCV
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from benchmarks.counting import _designs as designs
from benchmarks.counting._data import SAMPLING_RATE
from benchmarks.counting._work import JUDGED_NOISE, REDUCED_RATE, Work, reduced, share
from cyclofeat import features
from cyclofeat.counting import EntropyLadder, evaluate
from cyclofeat.counting.trees import CountingTrees
from cyclofeat.features.base import WindowTransformer

Float = NDArray[np.float64]

# Transformers of the papers' methods, with the label of each row.
METHODS: dict[str, tuple[str, type[WindowTransformer], dict[str, Any]]] = {
    "statistics": ("A table 4: min, max, mean, std, range", features.TorqueStatistics, {}),
    "entropy": ("A 5.3: Shannon entropy", features.SpectralEntropy, {}),
    "normalized_entropy": ("A 5.3: normalised entropy", features.SpectralEntropy, {"normalize": True}),
    "centroid": ("A 5.4: spectral centroid", features.SpectralCentroid, {"n_parts": 4}),
    "rolloff": ("A 5.4: 95 % roll-off", features.SpectralRolloff, {"n_parts": 4}),
    "narrowband": ("A 5.5: narrowband ratio", features.NarrowbandRatio, {}),
    "flatness": ("A 5.6: spectral flatness", features.SpectralFlatness, {}),
    "band_power": ("A 6: power in bands", features.BandPower, {}),
    "envelope": ("A 5.1: envelope of the mesh level", features.WaveletEnvelopeSpectrum, {}),
    "levels": ("B 5: wavelet levels (mb32.3)", features.WaveletLevelStatistics, {}),
    "amplitude": ("B 6: 8192-point Hamming spectrum, 200-800 Hz", features.AmplitudeSpectrum,
                  {"band": (200.0, 800.0)}),
    "coherence": ("B 5, A 5.2: coherence with healthy", features.CoherenceToReference, {}),
    "minima": ("B 7, A 5.1: minima overlap", features.WaveletMinimaOverlap, {}),
}  # fmt: skip
# These learn from the counts, so they are fitted inside the folds. The others are computed once.
_LEARNS = ("coherence", "minima")
PEERS = {
    "ladder": "A 5.3 as a ladder: Shannon entropy, thresholds between counts",
    **{key: text for key, (text, *_) in METHODS.items()},
    "catch22": "pycatch22, 22 features",
    "tsfel": "tsfel, all features",
    "minirocket": "MiniRocket (aeon) and ridge",
}
_N_TREES = 100


def peer(work: Work, key: str, rig: str, noise: float) -> dict[str, Any]:
    """One method, one window, folds by assembly; trees behind features, ridge behind MiniRocket."""

    def run() -> dict[str, Any]:
        judged = work.windows(designs.JUDGED[rig], 2)
        counter: BaseEstimator = CountingTrees(_N_TREES, random_state=0)
        if key in METHODS or key == "ladder":
            _, kind, options = METHODS["entropy" if key == "ladder" else key]
            X = judged.noisy(noise, JUDGED_NOISE).X.astype(float)
            transformer = kind(SAMPLING_RATE, **options)
            if key in _LEARNS:
                counter = make_pipeline(transformer, counter)
            else:
                X = np.nan_to_num(transformer.fit_transform(X))
            if key == "ladder":
                counter = EntropyLadder()
        else:
            X = _PEERS[key](work, reduced(judged, noise, JUDGED_NOISE))
            if key == "minirocket":
                counter = make_pipeline(StandardScaler(), RidgeClassifierCV(np.logspace(-3, 3, 7)))
        if key not in _LEARNS:
            # Two constant columns: a row of equal features must not look like a constant window.
            X = np.column_stack([X, np.zeros(len(X)), np.ones(len(X))])
        return share(evaluate(counter, X, judged.y, judged.assembly))

    return work.kept(f"peer-{key}-{rig}-{noise:g}", run)


def catch22(_: Work, X: Any) -> Float:
    """pycatch22's features of each window."""
    import pycatch22

    found = [pycatch22.catch22_all(row.tolist(), catch24=True)["values"] for row in X.astype(float)]
    return np.nan_to_num(np.array(found))


def all_of_tsfel(_: Work, X: Any, sampling_rate: float = REDUCED_RATE) -> Float:
    """tsfel's features of each window."""
    import tsfel

    settings = tsfel.get_features_by_domain()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = [
            tsfel.time_series_features_extractor(settings, row, fs=sampling_rate, verbose=0).to_numpy()[0]
            for row in X.astype(float)
        ]
    return np.clip(np.nan_to_num(np.array(found)), -1e30, 1e30)


# aeon pins older libraries, so it runs in a separate environment.
_MINIROCKET = """
import sys
import numpy as np
from aeon.transformations.collection.convolution_based import MiniRocket
X = np.load(sys.argv[1])
np.save(sys.argv[2], MiniRocket(random_state=0, n_jobs=1).fit_transform(X[:, np.newaxis].astype(np.float32)))
"""


def minirocket(work: Work, X: Any) -> Float:
    """MiniRocket's 9,996 features; its biases are quantiles of the windows and do not use counts."""
    python = work.folder / "venv/bin/python"
    if not python.exists():
        raise FileNotFoundError(
            f"{python} is missing: MiniRocket needs an environment of its own, made by python -m venv "
            f"{work.folder}/venv and its pip install aeon"
        )
    with tempfile.TemporaryDirectory() as folder:
        source, target = Path(folder) / "X.npy", Path(folder) / "F.npy"
        scale = X.std(axis=1, keepdims=True)
        np.save(source, (X - X.mean(axis=1, keepdims=True)) / scale)
        subprocess.run([str(python), "-c", _MINIROCKET, str(source), str(target)], check=True)
        return np.asarray(np.load(target), dtype=np.float64)


LEVELS = {
    "cyclofeat": "cyclofeat", "held": "cyclofeat, held", "catch22": "pycatch22", "tsfel": "tsfel",
    "minirocket": "MiniRocket",
}  # fmt: skip

_PEERS = {"catch22": catch22, "tsfel": all_of_tsfel, "minirocket": minirocket}


def has_torch() -> bool:
    """Return True if torch is installed, which a convolutional network needs."""
    return importlib.util.find_spec("torch") is not None


def load_levels(work: Work, key: str) -> dict[str, Any]:
    """OEDI's load levels across health states under the protocol of ``evaluate_load_levels``.

    Windows, ridge regression, folds and scores are those of that function; only the features differ. ``held``
    are the toolkit's features, clipped to their range in the training state.
    """
    from benchmarks import _load_level_data as level_data
    from benchmarks import load_levels as levels
    from cyclofeat.datasets import load_oedi_gearbox

    def features(windows: Float, sampling_rate: float) -> Float:
        if key == "held":
            return levels._features_by_channel(windows, sampling_rate)[1]
        flat = windows.reshape(-1, windows.shape[-1])
        found = all_of_tsfel(work, flat, sampling_rate) if key == "tsfel" else _PEERS[key](work, flat)
        return found.reshape(*windows.shape[:-1], -1)

    def run() -> dict[str, Any]:
        dataset = load_oedi_gearbox()
        if key == "cyclofeat":
            cases = levels.evaluate_load_levels(dataset).cases
        else:
            data = level_data.checked(dataset)
            table = features(level_data.cut(data, 4096), data.sampling_rate)
            chosen = [(name, [i]) for i, name in enumerate(data.channels)]
            chosen.append(("all", list(range(len(data.channels)))))
            found = []
            for name, members in chosen:
                of_channels = np.concatenate([table[i] for i in members], axis=2)
                for trained, tested in ((0, 1), (1, 0)):
                    given = of_channels
                    if key == "held":
                        seen = of_channels[data.broken == trained]
                        given = np.clip(of_channels, seen.min(axis=(0, 1)), seen.max(axis=(0, 1)))
                    found.append(levels._case(data, name, given, trained, tested, 0))
            cases = tuple(found)
        return {
            f"{case.channel}, {case.direction}": [
                case.per_recording.accuracy, case.per_recording.mean_absolute_error
            ]
            for case in cases
        }  # fmt: skip

    return work.kept(f"oedi-{key}", run)
