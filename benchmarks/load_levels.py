"""Load level of measured gearbox vibration, trained in one health state and tested in the other.

python -m benchmarks.load_levels [--data FILE] [--json]     # seconds
"""

from __future__ import annotations

import argparse
import json
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from numbers import Integral
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sklearn.linear_model import Ridge
from sklearn.model_selection import GridSearchCV, LeaveOneGroupOut
from sklearn.pipeline import FeatureUnion, make_pipeline
from sklearn.preprocessing import StandardScaler

from benchmarks._load_level_data import ALL, LEVELS, STATES, VibrationData, checked, cut
from cyclofeat.datasets import load_oedi_gearbox
from cyclofeat.features import SpectralEntropy, TorqueStatistics

Float = NDArray[np.float64]
Int = NDArray[np.int64]
_SHORTEST = 256  # samples; shorter windows have too short Welch segments for octave bands
_CONFIDENCE = 0.95
_N_BOOTSTRAP = 2000
_PENALTIES = (0.01, 0.1, 1.0, 10.0, 100.0, 1000.0)
# The mean of an accelerometer is meaningless: mean and ripple (std over mean) would be noise, and rms would
# equal std. Logarithms of sizes and ratios turn an unknown unit into a constant.
_LOGARITHMS = ("torque_std_nm", "torque_range_nm", "torque_crest_factor", "torque_kurtosis")
_LEFT_OUT = ("torque_min_nm", "torque_max_nm", "torque_mean_nm", "torque_rms_nm", "torque_ripple")
_CAVEATS = (
    "This is measured vibration of another kind of gearbox: no torque, no cycloidal disc, no lobes. It tries "
    "the plumbing and the honesty of the evaluation on measured data; it says nothing about counting lobes.",
    "There is one recording per state and load, and one assembly per state: the intervals, over recordings, "
    "leave out how assemblies differ.",
    "The unit of the acceleration is not documented; the predictions do not depend on it.",
)


@dataclass(frozen=True)
class LevelScore:
    """Accuracy of predicted levels.

    Attributes
    ----------
    accuracy : float
        Share of exact predictions.
    accuracy_interval : tuple of float
        95 % bootstrap interval over recordings.
    mean_absolute_error : float
        In levels.
    mean_absolute_error_interval : tuple of float
        95 % bootstrap interval over recordings.
    """

    accuracy: float
    accuracy_interval: tuple[float, float]
    mean_absolute_error: float
    mean_absolute_error_interval: tuple[float, float]


@dataclass(frozen=True)
class LevelChance:
    """Score of guessing on the tested recordings, without any signal.

    Attributes
    ----------
    accuracy : float
        Expected accuracy of guessing every level with the same probability.
    best_constant : int
        The constant prediction with the smallest error (the lowest of equals).
    constant_error : float
        Mean absolute error, in levels, of always predicting it.
    uniform_error : float
        Expected mean absolute error, in levels, of guessing every level with the same probability.
    """

    accuracy: float
    best_constant: int
    constant_error: float
    uniform_error: float


@dataclass(frozen=True)
class LoadLevelCase:
    """Result for one choice of channels, in one direction.

    Attributes
    ----------
    channel : str
        Name of the accelerometer, or ``"all"``.
    direction : str
        ``"healthy to broken"`` (trained on healthy recordings, tested on broken ones) or the reverse.
    per_recording : LevelScore
        One prediction per recording: the mean over its windows, rounded.
    per_window : LevelScore
        One prediction per window.
    chance : LevelChance
    validation_error : float
        Mean absolute error, in levels, within the training state, each recording left out in turn, of the
        chosen penalty, before rounding. The difference to the test shows the effect of the change of state.
    penalty : float
        Penalty of the ridge regression, chosen within the training state.
    recordings : tuple of str
        Names of the tested recordings.
    levels, predictions : tuple of int
        Their true and predicted levels.
    """

    channel: str
    direction: str
    per_recording: LevelScore
    per_window: LevelScore
    chance: LevelChance
    validation_error: float
    penalty: float
    recordings: tuple[str, ...] = field(repr=False)
    levels: tuple[int, ...] = field(repr=False)
    predictions: tuple[int, ...] = field(repr=False)


@dataclass(frozen=True)
class LoadLevelResult:
    """Result of :func:`evaluate_load_levels`.

    The result is about measured vibration of another kind of gearbox, not about torque or lobes.

    Attributes
    ----------
    cases : tuple of LoadLevelCase
        Each channel, then all together, in both directions.
    features : tuple of str
        Features of one channel's windows. Their names mention torque and Nm, but the values are accelerations
        in an undocumented unit.
    window_samples : int
        Samples in a window.
    windows_per_recording : int
        Windows cut from each recording.
    sampling_rate : float
        Samples per second in Hz, as the dataset states it.
    sampling_rate_inferred : bool
        True if that rate was inferred and is not documented at the source.
    confidence : float
        Coverage of the bootstrap intervals.
    """

    cases: tuple[LoadLevelCase, ...]
    features: tuple[str, ...] = field(repr=False)
    window_samples: int
    windows_per_recording: int
    sampling_rate: float
    sampling_rate_inferred: bool
    confidence: float = _CONFIDENCE

    @property
    def caveats(self) -> tuple[str, ...]:
        """Limits of these numbers."""
        rate = "inferred, not documented" if self.sampling_rate_inferred else "as documented"
        return (
            *_CAVEATS,
            f"The sampling rate is {self.sampling_rate:g} Hz, {rate}; the predictions do not depend on it.",
        )

    def to_dict(self) -> dict[str, Any]:
        """The result in plain types, for JSON.

        Returns
        -------
        dict
            The attributes by name, with lists for tuples, and ``"caveats"``.
        """
        plain: dict[str, Any] = _lists(asdict(self))
        return plain | {"caveats": list(self.caveats)}

    def table(self) -> str:
        """The result as plain text: one table per recording, one per window, then the caveats.

        Returns
        -------
        str
            Columns channel, direction, accuracy and mean absolute error (MAE, in levels) with their
            intervals, and chance: the accuracy of uniform guessing, the MAE of the best constant guess and of
            uniform guessing.
        """
        seconds = self.window_samples / self.sampling_rate
        windows = (
            f"{self.windows_per_recording} per recording, of {self.window_samples} samples ({seconds:.2f} s)"
        )
        lines = [
            f"Load level ({LEVELS.size} ordered classes) of measured gearbox VIBRATION, not torque:",
            "learned in one health state, tested in the other",
            "",
            "Per recording (mean over its windows, rounded)",
            *_rows([(case, case.per_recording) for case in self.cases]),
            "",
            f"Per window ({windows})",
            *_rows([(case, case.per_window) for case in self.cases]),
            "",
            "MAE: mean absolute error in levels.",
            f"[ ]: {self.confidence:.0%} bootstrap interval over the tested recordings.",
            "chance: accuracy of uniform guessing; MAE of the best constant guess / of uniform guessing.",
            *(textwrap.fill(caveat, 100) for caveat in self.caveats),
        ]
        return "\n".join(lines)


def evaluate_load_levels(
    dataset: Mapping[str, Any], *, window_samples: int = 4096, random_state: int = 0
) -> LoadLevelResult:
    """Predict the load level of measured vibration across health states, with the toolkit's features.

    Models are trained on the recordings of the healthy gearbox and tested on those of the one with a broken
    tooth, and vice versa, from each accelerometer alone and from all together.

    **Limits.** The signals are vibration, not torque, of another kind of gearbox without cycloidal disc and
    lobes. This tests the software and the evaluation on measured data; it shows nothing about counting lobes.
    There is one recording per state and load and one assembly per state, so a change of state is also a
    change of assembly, and the effect of load cannot be separated from other differences between two
    recordings. The unit of the signals is not documented and their sampling rate (12.8 kHz) is inferred; the
    result depends on neither.

    Parameters
    ----------
    dataset : sklearn.utils.Bunch
        As from ``cyclofeat.datasets.load_oedi_gearbox()``: ``signals`` (n_recordings, n_samples, n_channels),
        ``broken_tooth`` (0 or 1), ``load_percent`` (0, 10, ... 90, each in both states), ``recording_names``,
        ``channel_names``, ``sampling_rate`` (Hz), ``sampling_rate_inferred``.
    window_samples : int
        Samples in a window. Windows do not overlap; the remainder after the last window is not used.
    random_state : int
        Seed of the bootstrap. Nothing else is random.

    Returns
    -------
    LoadLevelResult

    Raises
    ------
    TypeError
        If the dataset is not such a Bunch, or ``window_samples`` or ``random_state`` no integer.
    ValueError
        If something is missing from the dataset, of another shape, not finite, or constant over a window; if
        a load level is missing in one of the states; if windows are shorter than 256 samples or longer than
        the recordings; if ``random_state`` is negative.

    Notes
    -----
    *Features*, per channel: of :class:`~cyclofeat.features.TorqueStatistics` skewness and the logarithms of
    standard deviation, range, crest factor and kurtosis; :class:`~cyclofeat.features.SpectralEntropy` over
    all frequencies under both presets, and in the top three octaves and the rest below them under
    ``"ripple"``. No feature learns from data, so all are computed before the split.

    *Regression*: ridge regression on the standardised features, because the classes are ordered and errors
    should be small. A window's prediction is rounded to the nearest class, a recording's is the
    mean over its windows, before rounding, then rounded. The penalty is chosen for each case by the mean
    absolute error with each recording of the *training* state left out in turn.

    *Choice of the method*: by that same error within one state (healthy / broken, mean over all choices of
    channels), never by a score across states. At 4096 samples, ridge regression had 0.84 / 0.64 levels,
    extremely randomised trees as regression 0.84 / 0.75, support vector regression 1.10 / 1.24, and trees as
    a classifier, which never predict the level that was left out, 1.24 / 1.20. Ridge regression is as good as
    any in both states, simple and deterministic, and it can extrapolate. With windows of 2048 samples it had
    1.04 / 0.83, of 1024 samples 1.10 / 0.94. The statistics alone had 0.90 / 0.55, the entropies alone
    1.32 / 1.22: the states disagree, so both kinds are used.

    *Intervals* are percentiles of 2,000 bootstrap draws of the tested recordings. There are ten of them, one
    per level: the intervals are wide, shrink to a point if all are right or all wrong, and do not include
    differences between assemblies.
    """
    data = checked(dataset)
    window, seed = _integer("window_samples", window_samples), _integer("random_state", random_state)
    n_samples = data.signals.shape[1]
    if not _SHORTEST <= window <= n_samples:
        raise ValueError(
            f"window_samples must lie between {_SHORTEST} and the {n_samples} samples of a recording, "
            f"got {window}"
        )
    if seed < 0:
        raise ValueError(f"random_state must not be negative, got {seed}")
    names, features = _features_by_channel(cut(data, window), data.sampling_rate)
    choices = [(name, [i]) for i, name in enumerate(data.channels)]
    choices.append((ALL, list(range(len(data.channels)))))
    cases = []
    for channel, members in choices:
        table = np.concatenate([features[i] for i in members], axis=2)
        for trained, tested in ((0, 1), (1, 0)):
            cases.append(_case(data, channel, table, trained, tested, seed))
    return LoadLevelResult(
        cases=tuple(cases),
        features=names,
        window_samples=window,
        windows_per_recording=features.shape[2],
        sampling_rate=data.sampling_rate,
        sampling_rate_inferred=data.sampling_rate_inferred,
    )


def _integer(name: str, value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, Integral):
        raise TypeError(f"{name} must be an integer, got {value!r}")
    return int(value)


def _union(sampling_rate: float) -> FeatureUnion:
    # Bands are fractions of the rate, so they contain the same lines even if the inferred rate is wrong.
    nyquist = sampling_rate / 2
    octaves = [(nyquist / 2, nyquist), (nyquist / 4, nyquist / 2), (nyquist / 8, nyquist / 4)]
    bands: list[tuple[float, float]] = [*octaves, (0.0, nyquist / 8)]
    entropies: list[tuple[str, Any]] = [
        (preset, SpectralEntropy(sampling_rate, preset)) for preset in ("matlab_pwelch", "ripple")
    ]
    entropies += [
        (f"band_{i}", SpectralEntropy(sampling_rate, "ripple", band=band)) for i, band in enumerate(bands)
    ]
    return FeatureUnion(
        [("statistics", TorqueStatistics(sampling_rate)), *entropies], verbose_feature_names_out=False
    )


def _features_by_channel(windows: Float, sampling_rate: float) -> tuple[tuple[str, ...], Float]:
    """Names, and features of shape (n_channels, n_recordings, n_windows, n_features)."""
    flat = windows.reshape(-1, windows.shape[-1])
    union = _union(sampling_rate).fit(flat)
    columns = dict(zip(union.get_feature_names_out(), union.transform(flat).T, strict=True))
    kept = {}
    for name, values in columns.items():
        if name in _LOGARITHMS:
            # The floor handles a window whose variation is below the rounding of its mean.
            kept[f"log_{name}"] = np.log(np.maximum(values, np.finfo(np.float64).tiny))
        elif name not in _LEFT_OUT:
            kept[str(name)] = values
    return tuple(kept), np.column_stack(list(kept.values())).reshape(*windows.shape[:-1], len(kept))


def _case(
    data: VibrationData, channel: str, features: Float, trained: int, tested: int, random_state: int
) -> LoadLevelCase:
    """Train on one state (0 or 1) and test on the other; features (n_recordings, n_windows, n_features)."""
    train, test = np.flatnonzero(data.broken == trained), np.flatnonzero(data.broken == tested)
    search = _fit(features[train], data.levels[train])
    raw = search.predict(features[test].reshape(-1, features.shape[2])).reshape(test.size, -1)
    truth = data.levels[test]
    predictions = _nearest_level(raw.mean(axis=1))
    return LoadLevelCase(
        channel=channel,
        direction=f"{STATES[trained]} to {STATES[tested]}",
        per_recording=_score(truth, predictions[:, np.newaxis], random_state),
        per_window=_score(truth, _nearest_level(raw), random_state),
        chance=_chance(truth),
        validation_error=-float(search.best_score_),
        penalty=float(search.best_params_["ridge__alpha"]),
        recordings=tuple(data.recordings[i] for i in test),
        levels=tuple(truth.tolist()),
        predictions=tuple(predictions.tolist()),
    )


def _fit(features: Float, levels: Int) -> GridSearchCV:
    """Fit ridge regression to the training state, its penalty chosen by leaving each recording out."""
    n_recordings, n_windows, n_features = features.shape
    search = GridSearchCV(
        make_pipeline(StandardScaler(), Ridge()),
        {"ridge__alpha": _PENALTIES},
        scoring="neg_mean_absolute_error",
        cv=LeaveOneGroupOut().split(
            np.empty(n_recordings * n_windows), groups=np.repeat(np.arange(n_recordings), n_windows)
        ),
    )
    return search.fit(features.reshape(-1, n_features), np.repeat(levels, n_windows))


def _nearest_level(values: Float) -> Int:
    # Round halves up; numpy rounds them to the even level.
    return np.clip(np.floor(values + 0.5), LEVELS[0], LEVELS[-1]).astype(np.int64)


def _score(levels: Int, predictions: Int, random_state: int) -> LevelScore:
    """Score of predictions, shape (n_recordings, n_predictions), with recordings drawn whole."""
    error = np.abs(predictions - levels[:, np.newaxis])
    hits, misses = (error == 0).mean(axis=1), error.mean(axis=1)
    drawn = np.random.default_rng(random_state).integers(levels.size, size=(_N_BOOTSTRAP, levels.size))
    return LevelScore(
        accuracy=float(hits.mean()),
        accuracy_interval=_interval(hits[drawn].mean(axis=1)),
        mean_absolute_error=float(misses.mean()),
        mean_absolute_error_interval=_interval(misses[drawn].mean(axis=1)),
    )


def _interval(values: Float) -> tuple[float, float]:
    tail = 100 * (1 - _CONFIDENCE) / 2
    low, high = np.percentile(values, [tail, 100 - tail])
    return float(low), float(high)


def _chance(levels: Int) -> LevelChance:
    """Chance for recordings of these true levels, each with as many windows."""
    distance = np.abs(levels[:, np.newaxis] - LEVELS)
    by_guess = distance.mean(axis=0)
    return LevelChance(
        accuracy=float((distance == 0).mean()),
        best_constant=int(LEVELS[by_guess.argmin()]),
        constant_error=float(by_guess.min()),
        uniform_error=float(distance.mean()),
    )


def _rows(scored: list[tuple[LoadLevelCase, LevelScore]]) -> list[str]:
    width = max(len("channel"), *(len(case.channel) for case, _ in scored))
    lines = [f"{'channel':{width}}  {'direction':17}  {'accuracy':17}  {'MAE':17}  chance: accuracy; MAE"]
    for case, score in scored:
        accuracy = _with_interval(score.accuracy, score.accuracy_interval)
        error = _with_interval(score.mean_absolute_error, score.mean_absolute_error_interval)
        chance = case.chance
        lines.append(
            f"{case.channel:{width}}  {case.direction:17}  {accuracy:17}  {error:17}  "
            f"{chance.accuracy:.2f}; {chance.constant_error:.2f} / {chance.uniform_error:.2f}"
        )
    return lines


def _with_interval(value: float, interval: tuple[float, float]) -> str:
    return f"{value:.2f} [{interval[0]:.2f}, {interval[1]:.2f}]"


def _lists(value: Any) -> Any:
    """Replace tuples by lists at any depth."""
    if isinstance(value, dict):
        return {key: _lists(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_lists(item) for item in value]
    return value


def main(argv: Sequence[str] | None = None) -> None:
    """Print the table, or JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--data", help="file of the data set, outside a checkout")
    parser.add_argument("--json", action="store_true", help="print JSON for programs")
    arguments = parser.parse_args(argv)
    levels = evaluate_load_levels(load_oedi_gearbox(arguments.data))
    print(json.dumps(levels.to_dict(), indent=2) if arguments.json else levels.table())


if __name__ == "__main__":
    main()
