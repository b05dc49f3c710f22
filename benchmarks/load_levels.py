"""Load level of measured gearbox vibration, trained in one health state and tested in the other.

    python -m benchmarks.load_levels [--data FILE]     # seconds

*Features* of each channel's windows, worked out before the split, for none learns from data: skewness and the
logarithms of standard deviation, range, crest factor and kurtosis; spectral entropies over all frequencies
under both presets, and in the top three octaves and the rest below them. The predictions depend neither on
the unit of the signals nor on their sampling rate, which are not documented.

*Regression*: ridge on standardised features, because the classes are ordered. Its penalty is chosen by the
mean absolute error with each recording of the training state left out in turn. By the same error, never by a
score across states, the method was chosen: trees, support vectors, shorter windows, and statistics or
entropies alone were no better in both states.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from sklearn.linear_model import Ridge
from sklearn.model_selection import GridSearchCV, LeaveOneGroupOut
from sklearn.pipeline import FeatureUnion, make_pipeline
from sklearn.preprocessing import StandardScaler

from cyclofeat.datasets import load_oedi_gearbox
from cyclofeat.features import SpectralEntropy, TorqueStatistics

Float = NDArray[np.float64]
Int = NDArray[np.int64]
LEVELS: Int = np.arange(10)  # the ordered classes: load in per cent, divided by 10
STATES = ("healthy", "broken")  # index: value of broken_tooth
WINDOW = 4096  # samples, without overlap
PENALTIES = (0.01, 0.1, 1.0, 10.0, 100.0, 1000.0)
_DRAWS = 2000
# The mean of an accelerometer is meaningless: mean and ripple (std over mean) would be noise, and rms would
# equal std. Logarithms of sizes and ratios turn an unknown unit into a constant.
_LOGARITHMS = ("torque_std_nm", "torque_range_nm", "torque_crest_factor", "torque_kurtosis")
_LEFT_OUT = ("torque_min_nm", "torque_max_nm", "torque_mean_nm", "torque_rms_nm", "torque_ripple")


class Case(NamedTuple):
    """Predictions for one choice of channels, in one direction."""

    channel: str  # name of the accelerometer, or "all"
    direction: (
        str  # "healthy to broken" (trained on healthy recordings, tested on broken ones) or the reverse
    )
    levels: Int  # true ones of the tested recordings
    predicted: Int  # by the mean over a recording's windows
    by_window: Int  # shape (n_recordings, n_windows)
    penalty: float  # of the ridge regression
    validation_error: float  # mean absolute error in levels within the training state


def all_cases(data: Any) -> list[Case]:
    """Predict from each channel alone and from all together, in both directions."""
    features = channel_features(data.signals, data.sampling_rate)
    choices = [*zip(data.channel_names, features, strict=True), ("all", np.concatenate(features, axis=2))]
    return [
        _case(data, channel, table, trained, 1 - trained) for channel, table in choices for trained in (0, 1)
    ]


def channel_features(signals: Float, sampling_rate: float) -> list[Float]:
    """Return the features of each channel, shape (n_recordings, n_windows, n_features)."""
    nyquist = sampling_rate / 2
    edges = [nyquist, nyquist / 2, nyquist / 4, nyquist / 8, 0.0]
    entropies = [SpectralEntropy(sampling_rate, preset) for preset in ("matlab_pwelch", "ripple")]
    entropies += [
        SpectralEntropy(sampling_rate, "ripple", band=band) for band in zip(edges[1:], edges, strict=False)
    ]
    steps = [TorqueStatistics(sampling_rate), *entropies]
    union = FeatureUnion([(str(i), step) for i, step in enumerate(steps)], verbose_feature_names_out=False)
    n_windows = signals.shape[1] // WINDOW
    made = []
    for channel in np.moveaxis(signals, 2, 0):
        table = union.fit_transform(channel[:, : n_windows * WINDOW].reshape(-1, WINDOW))
        columns = dict(zip(union.get_feature_names_out(), table.T, strict=True))
        kept = [
            np.log(values) if name in _LOGARITHMS else values
            for name, values in columns.items()
            if name not in _LEFT_OUT
        ]
        made.append(np.column_stack(kept).reshape(len(signals), n_windows, -1))
    return made


def _case(data: Any, channel: str, features: Float, trained: int, tested: int) -> Case:
    """Train on one state (0 or 1) and test on the other."""
    train, test = (features[data.broken_tooth == state] for state in (trained, tested))
    known, levels = (data.load_percent[data.broken_tooth == state] // 10 for state in (trained, tested))
    n_recordings, n_windows, n_features = train.shape
    search = GridSearchCV(
        make_pipeline(StandardScaler(), Ridge()),
        {"ridge__alpha": PENALTIES},
        scoring="neg_mean_absolute_error",
        cv=LeaveOneGroupOut(),
    )
    groups = np.repeat(np.arange(n_recordings), n_windows)
    search.fit(train.reshape(-1, n_features), np.repeat(known, n_windows), groups=groups)
    raw = search.predict(test.reshape(-1, n_features)).reshape(len(test), -1)
    return Case(
        channel,
        f"{STATES[trained]} to {STATES[tested]}",
        levels,
        _nearest_level(raw.mean(axis=1)),
        _nearest_level(raw),
        search.best_params_["ridge__alpha"],
        -float(search.best_score_),
    )


def _nearest_level(values: Float) -> Int:
    # Round halves up; numpy rounds them to the even level.
    return np.clip(np.floor(values + 0.5), LEVELS[0], LEVELS[-1]).astype(np.int64)


def scores(levels: Int, predicted: Int) -> list[tuple[float, float, float]]:
    """Accuracy and mean absolute error in levels, each with its 95 % bootstrap interval over recordings."""
    error = np.abs(predicted.reshape(len(levels), -1) - levels[:, None])
    drawn = np.random.default_rng(0).integers(levels.size, size=(_DRAWS, levels.size))
    of_recordings = ((error == 0).mean(axis=1), error.mean(axis=1))
    return [(each.mean(), *np.percentile(each[drawn].mean(axis=1), [2.5, 97.5])) for each in of_recordings]


def rows(cases: Sequence[Case], of: str) -> str:
    """Return the table of all cases, by their predictions ``of``: "predicted" or "by_window"."""
    lines = [f"{'channel':7}  {'direction':17}  {'accuracy':17}  {'MAE':17}  chance: accuracy; MAE"]
    for case in cases:
        words = [
            f"{value:.2f} [{low:.2f}, {high:.2f}]"
            for value, low, high in scores(case.levels, getattr(case, of))
        ]
        guesses = np.abs(case.levels[:, None] - LEVELS)
        chance = f"{(guesses == 0).mean():.2f}; {guesses.mean(axis=0).min():.2f} / {guesses.mean():.2f}"
        lines.append(f"{case.channel:7}  {case.direction:17}  {words[0]:17}  {words[1]:17}  {chance}")
    return "\n".join(lines)


def main(argv: Sequence[str] | None = None) -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--data", help="file of the data set, outside a checkout")
    data = load_oedi_gearbox(parser.parse_args(argv).data)
    cases = all_cases(data)
    n_windows, rate = cases[0].by_window.shape[1], data.sampling_rate
    print(f"""\
Load level ({LEVELS.size} ordered classes) of measured gearbox VIBRATION, not torque:
learned in one health state, tested in the other

Per recording (mean over its windows, rounded)
{rows(cases, "predicted")}

Per window ({n_windows} per recording, of {WINDOW} samples ({WINDOW / rate:.2f} s))
{rows(cases, "by_window")}

MAE: mean absolute error in levels.
[ ]: 95% bootstrap interval over the tested recordings.
chance: accuracy of uniform guessing; MAE of the best constant guess / of uniform guessing.
This is measured vibration of another kind of gearbox: no torque, no cycloidal disc, no lobes. It
tries the plumbing and the honesty of the evaluation on measured data; it says nothing about
counting lobes.
There is one recording per state and load, and one assembly per state: the intervals, over
recordings, leave out how assemblies differ.
The unit of the acceleration is not documented; the predictions do not depend on it.
The sampling rate is {rate:g} Hz, inferred, not documented; the predictions do not depend on it.""")


if __name__ == "__main__":
    main()
