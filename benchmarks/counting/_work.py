"""Shared code of the rows: windows with noise at two rates, additional training data, stored results."""

from __future__ import annotations

import functools
import json
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from sklearn.base import BaseEstimator, ClassifierMixin, clone
from sklearn.utils.metaestimators import available_if

from benchmarks.counting._data import SAMPLING_RATE, Design, Windows, load
from cyclofeat._base.files import write_whole
from cyclofeat.counting import Evaluation, fit_grouped
from cyclofeat.features import LobeMap
from cyclofeat.features.registry import REGISTRY
from cyclofeat.signal.lobes import reduce_rate

NOISES = (0.05, 0.2, 0.5, 1.0, 2.0)
REDUCED_RATE = 2560.0
# Results hold for one definition of the lobe map; those of other methods and data hold for all.
DEFINITION = REGISTRY["lobe_slot_mean"].version
_APART = ("peer-", "oedi-")
# One seed each: noise of the test windows, and of windows used for training only.
JUDGED_NOISE, TRAINING_NOISE = 11, 12


def reduced(windows: Windows, noise_nm: float, seed: int) -> NDArray[np.float32]:
    """Torque with noise at a tenth of the rate, as :class:`LobeMap` reduces it from the full rate.

    Works in blocks, because all windows at the full rate in double precision would fill the memory.
    """
    parts = []
    for k in range(0, len(windows.y), 64):
        block = windows.take(slice(k, k + 64)).noisy(noise_nm, seed + 1000 * k)
        parts.append(reduce_rate(block.X.astype(float), SAMPLING_RATE, REDUCED_RATE)[0].astype(np.float32))
    return np.concatenate(parts)


@dataclass
class Work:
    """Folder of simulations and results, with the options of the run.

    Attributes
    ----------
    folder : pathlib.Path
    n_jobs : int
    quick : bool
        Use a fifth of the assemblies, to test that everything runs, not for figures.
    """

    folder: Path
    n_jobs: int = 1
    quick: bool = False

    def windows(self, design: Design, n_windows: int | None = None) -> Windows:
        """Simulated windows of a design; the first ``n_windows`` of each assembly."""
        if self.quick:
            design = replace(
                design, name=f"{design.name}-quick", n_assemblies=max(design.n_assemblies // 5, 6)
            )
        found = _loaded(self.folder, self.n_jobs, design)
        return found if n_windows is None else found.take(found.number < n_windows)

    def features(
        self, design: Design, noise_nm: float, seed: int, n_windows: int | None = None, **options: Any
    ) -> Any:
        """Stored lobe maps of a design's windows, and their truth. ``options`` are those of the lobe map."""
        windows = self.windows(design, n_windows)
        name = f"{design.name}-{noise_nm:g}-{seed}-{n_windows}{'-quick' if self.quick else ''}"
        name += "".join(f"-{option}{value}" for option, value in options.items()) + f"-v{DEFINITION}"
        path = self.folder / "features" / f"{name}.npy"
        if not path.exists():
            speed = design.speed_rpm / 60
            map_ = LobeMap(REDUCED_RATE, input_speed_hz=speed, **options)
            found = map_.fit_transform(reduced(windows, noise_nm, seed))
            path.parent.mkdir(parents=True, exist_ok=True)
            write_whole(path, lambda stream: np.save(stream, found))
        return np.load(path), windows

    def kept(self, key: str, work: Callable[[], Any]) -> Any:
        """Return the result of ``work``, from its file if it exists."""
        found = self.found(key)
        if found is None:
            began = time.process_time()
            found = work()
            path = self._path(key)
            path.parent.mkdir(parents=True, exist_ok=True)
            content = (json.dumps(found, indent=1) + "\n").encode()
            write_whole(path, lambda stream: stream.write(content))
            print(f"{key}: {time.process_time() - began:.0f} s", flush=True)
        return found

    def found(self, key: str) -> Any:
        """Return a stored result, or None."""
        path = self._path(key)
        return json.loads(path.read_text(encoding="utf-8")) if path.exists() else None

    def latest(self, key: str) -> Any:
        """Return a stored result, else that of an earlier definition, marked as such."""
        for definition in range(DEFINITION, 0, -1):
            path = self._path(key, definition)
            if path.exists():
                found = json.loads(path.read_text(encoding="utf-8"))
                return found if definition == DEFINITION else found | {"earlier": True}
        return None

    def _path(self, key: str, definition: int = DEFINITION) -> Path:
        home = "results-quick" if self.quick else "results"
        if definition > 1 and not key.startswith(_APART):
            home += f"-v{definition}"
        return self.folder / home / f"{key}.json"


@functools.lru_cache(maxsize=3)
def _loaded(folder: Path, n_jobs: int, design: Design) -> Windows:
    return load(design, folder / "data", n_jobs)


class WithMore(ClassifierMixin, BaseEstimator):
    """Counter that is always trained on additional windows of assemblies that are never tested."""

    def __init__(self, counter: Any, X: Any, y: Any, groups: Any) -> None:
        self.counter = counter
        self.X = X
        self.y = y
        self.groups = groups

    def __sklearn_clone__(self) -> Self:
        return type(self)(clone(self.counter), self.X, self.y, self.groups)

    def fit(self, X: Any, y: Any, groups: Any) -> Self:
        windows, counts = np.concatenate([X, self.X]), np.concatenate([y, self.y])
        # their numbers must differ from those of the tested assemblies
        members = np.concatenate([groups, self.groups + groups.max() + 1])
        self.counter_ = fit_grouped(self.counter, windows, counts, members)
        self.classes_ = self.counter_.classes_
        return self

    def predict(self, X: Any) -> Any:
        return self.counter_.predict(X)

    def predict_proba(self, X: Any) -> Any:
        return self.counter_.predict_proba(X)

    @available_if(lambda self: hasattr(self.counter, "predict_set"))
    def predict_set(self, X: Any) -> Any:
        return self.counter_.predict_set(X)


def share(result: Evaluation) -> dict[str, Any]:
    """Accuracy with its interval, and the error in lobes."""
    return {
        "value": result.accuracy,
        "interval": list(result.accuracy_interval),
        "error": result.mean_absolute_error,
        "n_assemblies": int(result.groups.size),
    }
