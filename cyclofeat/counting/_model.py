"""A counter and a locator for whole recordings, with what they were made for."""

from __future__ import annotations

import platform
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import joblib
import numba
import numpy as np
import scipy
import sklearn
from numpy.typing import NDArray
from sklearn.base import BaseEstimator

from cyclofeat import __version__
from cyclofeat.counting._evaluation import evaluate
from cyclofeat.counting._locator import LobeLocator, passage_of_lobe_zero
from cyclofeat.counting._pipelines import make_lobe_counter
from cyclofeat.lobes import lobe_frequency
from cyclofeat.recording import Recording, Windower, WindowSet

# Relative deviation of a stated speed from the model's beyond which the speed search would not find it.
_SPEED_TOLERANCE = 0.015
# A tree ensemble's zero is "never seen among the trees", not "impossible".
_LEAST_PROBABILITY = 1e-3
# Places between two lobes at which a recording without an absolute angle is assumed to begin.
_BEGINNINGS = 4


@dataclass(frozen=True)
class LobeCount:
    """What a model says of one recording.

    Attributes
    ----------
    defect_count : int
        Most probable number of worn lobes.
    probability : dict
        Probability of each count.
    lobes : tuple of int
        The ``defect_count`` lobes most probably worn, counted from 0; empty where the model has no locator.
    lobe_probability : tuple of float
        Probability of each lobe of being worn; empty where the model has no locator.
    absolute : bool
        Whether lobes are numbered as on the disc. Otherwise lobe 0 is the one under load at the recording's
        first sample.
    n_windows : int
        Windows that were combined.
    warnings : tuple of str
        What the reader should know.
    """

    defect_count: int
    probability: dict[int, float]
    lobes: tuple[int, ...]
    lobe_probability: tuple[float, ...]
    absolute: bool
    n_windows: int
    warnings: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """The result in plain types, for JSON."""
        return {
            "defect_count": self.defect_count,
            "probability": {str(count): value for count, value in self.probability.items()},
            "lobes": list(self.lobes),
            "lobe_probability": list(self.lobe_probability),
            "lobes_absolute": self.absolute,
            "n_windows": self.n_windows,
            "warnings": list(self.warnings),
        }


@dataclass(frozen=True)
class LobeModel:
    """Counter and locator of worn lobes, for recordings of one sampling rate and nominal speed.

    Build it with :meth:`train`.

    Attributes
    ----------
    counter : estimator
        Fitted classifier of windows, classes are defect counts.
    locator : LobeLocator or None
        Fitted; None where the training recordings did not state angle and worn lobes.
    sampling_rate : float
        In Hz.
    input_speed_hz : float
        Nominal input speed in turns per second.
    n_lobes : int
    card : dict
        What the model was made from: training data, versions.
    """

    counter: BaseEstimator
    locator: LobeLocator | None
    sampling_rate: float
    input_speed_hz: float
    n_lobes: int
    card: dict[str, Any] = field(repr=False)

    @classmethod
    def train(
        cls,
        recordings: Sequence[Recording],
        *,
        input_speed_hz: float | None = None,
        n_lobes: int = 15,
        random_state: int = 0,
        n_splits: int = 5,
        description: str = "",
    ) -> LobeModel:
        """Train on labelled recordings.

        Parameters
        ----------
        recordings : sequence of Recording
            With ``defect_count``; where all of them also state ``worn_lobes`` and an absolute angle, the
            model learns to locate lobes too.
        input_speed_hz : float, optional
            Nominal input speed; default the one that the recordings share.
        n_lobes : int
            Number of lobes of a disc.
        random_state : int
            Seed of the trees.
        n_splits : int
            Folds of the cross-validation with whole assemblies held out, whose result goes on the card; 0
            for none. Where a class has fewer assemblies than that there is none either, and the card says so.
        description : str
            Where the recordings come from, for the card.

        Returns
        -------
        LobeModel

        Raises
        ------
        ValueError
            Where recordings lack a defect count, hold one class only or cannot be cut into windows.
        """
        windower = Windower(input_speed_hz=input_speed_hz, reduction=n_lobes)
        windows = windower.windows(recordings)
        if windows.y is None:
            raise ValueError("recordings must all state their defect_count to train on, some do not")
        speed = input_speed_hz or recordings[0].input_speed_hz
        assert speed is not None  # the windower would have raised
        if np.unique(windows.y).size < 2:
            raise ValueError(f"recordings must hold at least two defect counts, got {windows.y[0]} only")
        counter = make_lobe_counter(
            windows.sampling_rate, input_speed_hz=speed, n_lobes=n_lobes, random_state=random_state
        )
        scores = _cross_validation(counter, windows, n_splits, random_state)
        counter.fit(windows.X, windows.y)
        locator = None
        worn = _worn_lobes(windows, n_lobes)
        if worn is not None and worn.any() and not worn.all():
            locator = LobeLocator(
                windows.sampling_rate, input_speed_hz=speed, n_lobes=n_lobes, random_state=random_state
            ).fit(windows.X, worn, passage_of_lobe_zero(windows.start_angle, n_lobes))
        sources = sorted({str(r.source) for r in recordings})
        card = {
            "description": description,
            "n_recordings": len(recordings),
            "n_windows": len(windows),
            "sources": sources,
            "classes": np.unique(windows.y).tolist(),
            "cross_validation": scores,
            "versions": versions(),
        }
        return cls(counter, locator, windows.sampling_rate, speed, n_lobes, card)

    def check(self, recording: Recording) -> None:
        """Raise ``ValueError`` where a recording does not suit the model: sampling rate, speed, length."""
        if abs(recording.sampling_rate / self.sampling_rate - 1) > 1e-6:
            raise ValueError(
                f"sampling_rate of the recording is {recording.sampling_rate:g} Hz, but the model was "
                f"trained at {self.sampling_rate:g} Hz: resample the recording or train a model at its rate"
            )
        stated = {"speed_rpm of the recording is": recording.input_speed_hz}
        phi = recording.input_angle(self.n_lobes)
        if phi is not None:
            # Speed by the tachometer, whatever the label says; in the middle half, away from a run-up.
            first, last = phi.size // 4, 3 * phi.size // 4
            turns = (phi[last] - phi[first]) / (2 * np.pi)
            stated["the angle of the recording turns at"] = float(
                turns * recording.sampling_rate / max(last - first, 1)
            )
        for source, speed in stated.items():
            if speed is not None and abs(speed / self.input_speed_hz - 1) > _SPEED_TOLERANCE:
                raise ValueError(
                    f"{source} {60 * speed:.5g} RPM, but the model was trained at "
                    f"{60 * self.input_speed_hz:.5g} RPM: train a model at that speed"
                )

    def count(self, recording: Recording) -> LobeCount:
        """Count and locate the worn lobes of one recording.

        Windows of whole output turns are classified one by one, and their probabilities multiplied.

        Parameters
        ----------
        recording : Recording

        Returns
        -------
        LobeCount

        Raises
        ------
        ValueError
            Where the recording does not suit the model or is shorter than one output turn.
        """
        self.check(recording)
        windows = Windower(input_speed_hz=self.input_speed_hz, reduction=self.n_lobes).windows([recording])
        by_window = np.maximum(self.counter.predict_proba(windows.X), _LEAST_PROBABILITY)
        joint = np.log(by_window).sum(axis=0)
        probability = np.exp(joint - joint.max())
        probability /= probability.sum()
        classes = [int(c) for c in self.counter.classes_]
        count = classes[int(np.argmax(probability))]
        notes = []
        if recording.input_speed_hz is None:
            notes.append(
                f"no speed stated: taken as {60 * self.input_speed_hz:g} RPM, as the model was trained"
            )
        lobes: tuple[int, ...] = ()
        by_lobe: tuple[float, ...] = ()
        absolute = False
        if self.locator is not None:
            absolute = bool(windows.absolute.all())
            share = self._lobe_probability(windows, absolute)
            lobes = tuple(sorted(int(lobe) for lobe in np.argsort(-share, kind="stable")[:count]))
            by_lobe = tuple(float(p) for p in share)
            if not absolute and lobes:
                notes.append(
                    "positions are relative: without an absolute angle they count from the lobe under load "
                    "at the first sample counted"
                )
        if probability.max() < 0.5:
            notes.append(
                f"uncertain: {count} is most probable with {probability.max():.3f} only (share of the trees, "
                "not calibrated); more output turns decide better"
            )
        return LobeCount(
            defect_count=count,
            probability={c: float(p) for c, p in zip(classes, probability, strict=True)},
            lobes=lobes,
            lobe_probability=by_lobe,
            absolute=absolute,
            n_windows=len(windows),
            warnings=tuple(notes),
        )

    def _lobe_probability(self, windows: WindowSet, absolute: bool) -> NDArray[np.float64]:
        """Mean over windows of each lobe's probability, numbered as on the disc or from the first sample."""
        assert self.locator is not None
        if absolute:
            passage = passage_of_lobe_zero(windows.start_angle, self.n_lobes)
            return np.asarray(self.locator.predict_proba(windows.X, passage).mean(axis=0))
        # The lobe that passes at the first sample passes again after whole periods of the lobe frequency.
        # Where between two lobes the recording begins is not known: the most decided answer tells.
        speed = self.locator.lobe_map_.lines(windows.X).input_speed_hz
        again = -windows.start_s * lobe_frequency(1.0, self.n_lobes) * speed
        answers = [
            self.locator.predict_proba(windows.X, again + begin / (_BEGINNINGS * self.n_lobes)).mean(axis=0)
            for begin in range(_BEGINNINGS)
        ]
        return np.asarray(max(answers, key=lambda share: float(np.abs(share - 0.5).sum())))


def versions() -> dict[str, str]:
    """Versions of everything that a stored model depends on."""
    return {
        "cyclofeat": __version__,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "scipy": scipy.__version__,
        "scikit-learn": sklearn.__version__,
        "joblib": joblib.__version__,
        "numba": numba.__version__,
    }


def _cross_validation(
    counter: BaseEstimator, windows: WindowSet, n_splits: int, random_state: int
) -> dict[str, Any] | None:
    """Scores with whole assemblies held out; None where too few are known."""
    if n_splits == 0 or windows.y is None or windows.groups is None:
        return None
    fewest = min(np.unique(windows.groups[windows.y == label]).size for label in np.unique(windows.y))
    if fewest < n_splits:
        return None
    return evaluate(
        counter, windows.X, windows.y, windows.groups, n_splits=n_splits, random_state=random_state
    ).to_dict()


def _worn_lobes(windows: WindowSet, n_lobes: int) -> NDArray[np.bool_] | None:
    """Whether each lobe is worn, shape (n_windows, n_lobes); None where it is not known of all windows."""
    if not windows.absolute.all():
        return None
    worn = np.zeros((len(windows), n_lobes), dtype=bool)
    for row, lobes in zip(worn, windows.worn_lobes, strict=True):
        if lobes is None:
            return None
        row[list(lobes)] = True
    return worn
