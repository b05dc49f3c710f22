"""Features of other methods: the papers' one by one, pycatch22, tsfel, MiniRocket."""

from __future__ import annotations

import subprocess
import tempfile
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sklearn.linear_model import RidgeClassifierCV
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from benchmarks.counting._data import held_out
from cyclofeat import features
from cyclofeat.counting import EntropyLadder
from cyclofeat.counting.estimators.trees import CountingTrees
from cyclofeat.features.base import WindowTransformer
from cyclofeat.recordings import WindowSet

Float = NDArray[np.float64]

_WITH_MEAN = {"preset": "matlab_pwelch"}  # as in the papers
# Transformers of the papers' methods, with the label of each row.
METHODS: dict[str, tuple[type[WindowTransformer], dict[str, Any]]] = {
    "A table 4: min, max, mean, std, range": (features.TorqueStatistics, {}),
    "A 5.3: Shannon entropy": (features.SpectralEntropy, {}),
    "A 5.3: normalised entropy": (features.SpectralEntropy, {"normalize": True}),
    "A 5.4: spectral centroid": (features.SpectralCentroid, {"n_parts": 4, **_WITH_MEAN}),
    "A 5.4: 95 % roll-off": (features.SpectralRolloff, {"n_parts": 4, **_WITH_MEAN}),
    "A 5.5: narrowband ratio": (features.NarrowbandRatio, _WITH_MEAN),
    "A 5.6: spectral flatness": (features.SpectralFlatness, _WITH_MEAN),
    "A 6: power in bands": (features.BandPower, {}),
    "A 5.1: envelope of the mesh level": (features.WaveletEnvelopeSpectrum, {}),
    "B 5: wavelet levels (mb32.3)": (features.WaveletLevelStatistics, {}),
    "B 6: 8192-point Hamming spectrum, 200-800 Hz": (features.AmplitudeSpectrum, {"band": (200.0, 800.0)}),
    "B 5, A 5.2: coherence with healthy": (features.CoherenceToReference, {}),
    "B 7, A 5.1: minima overlap": (features.WaveletMinimaOverlap, {}),
}
# These learn from the counts, so they are fitted inside the folds. The others are computed once.
_LEARNS = (features.CoherenceToReference, features.WaveletMinimaOverlap)
LADDER = "A 5.3 as a ladder: Shannon entropy, thresholds between counts"
CATCH22, TSFEL, MINIROCKET = "pycatch22, 24 features", "tsfel, all features", "MiniRocket (aeon) and ridge"
PEERS = (LADDER, *METHODS, CATCH22, TSFEL, MINIROCKET)


def right(windows: WindowSet, slow: WindowSet, rocket: Float) -> dict[str, int]:
    """Return how many windows each method counts right, in folds by assembly.

    ``slow`` are the windows at a reduced rate, ``rocket`` their MiniRocket features, behind which stands
    ridge regression. Trees stand behind all others.
    """
    trees = CountingTrees(100, random_state=0)
    made, found = {}, {}
    for name, (kind, options) in METHODS.items():
        transformer = kind(windows.sampling_rate, **options)
        if kind in _LEARNS:
            found[name] = held_out(make_pipeline(transformer, trees), windows.X, windows.y, 3)
        else:
            made[name] = np.nan_to_num(transformer.fit_transform(windows.X))
    made |= {CATCH22: catch22(slow.X), TSFEL: all_of_tsfel(slow.X, slow.sampling_rate)}
    made |= {MINIROCKET: rocket, LADDER: made["A 5.3: Shannon entropy"]}
    ridge = make_pipeline(StandardScaler(), RidgeClassifierCV(np.logspace(-3, 3, 7)))
    counters = {LADDER: EntropyLadder(), MINIROCKET: ridge}
    return found | {name: held_out(counters.get(name, trees), X, windows.y, 3) for name, X in made.items()}


def catch22(X: Float) -> Float:
    """Return pycatch22's features of each window."""
    import pycatch22

    return np.nan_to_num([pycatch22.catch22_all(row.tolist(), catch24=True)["values"] for row in X])


def all_of_tsfel(X: Float, sampling_rate: float) -> Float:
    """Return tsfel's features of each window."""
    import tsfel

    settings = tsfel.get_features_by_domain()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = [
            tsfel.time_series_features_extractor(settings, row, fs=sampling_rate, verbose=0).to_numpy()[0]
            for row in X
        ]
    return np.clip(np.nan_to_num(np.array(found)), -1e30, 1e30)


_MINIROCKET = """
import sys
import numpy as np
from aeon.transformations.collection.convolution_based import MiniRocket
for path in sys.argv[1:]:
    X = np.load(path)[:, np.newaxis].astype(np.float32)
    np.save(path, MiniRocket(random_state=0, n_jobs=1).fit_transform(X))
"""


def minirocket(several: Sequence[Float], python: Path) -> list[Float]:
    """Return MiniRocket's 9,996 features of several sets of windows, by the interpreter that has aeon.

    Its biases are quantiles of the windows and do not use counts.
    """
    with tempfile.TemporaryDirectory() as folder:
        paths = [Path(folder) / f"{k}.npy" for k in range(len(several))]
        for path, X in zip(paths, several, strict=True):
            np.save(path, (X - X.mean(axis=1, keepdims=True)) / X.std(axis=1, keepdims=True))
        subprocess.run([str(python), "-c", _MINIROCKET, *map(str, paths)], check=True)
        return [np.load(path).astype(np.float64) for path in paths]
