"""Radial wear: its depth, and the count of faint wear, from whole runs of windows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.isotonic import IsotonicRegression

from cyclofeat._base.checks import is_number, number_pair, repr_of
from cyclofeat._base.quantities import number_of
from cyclofeat.counting.calibration.conformal_regressor import ConformalRegressor
from cyclofeat.counting.calibration.group_calibrated_counter import GroupCalibratedCounter
from cyclofeat.counting.calibration.pooling import pool_windows
from cyclofeat.counting.estimators.lobe_counter import LobeCounter
from cyclofeat.counting.estimators.lobe_positions import passage_of_lobe_zero
from cyclofeat.counting.estimators.trees import CountingTrees
from cyclofeat.features import LobeMap
from cyclofeat.recordings import Recording, WindowSet
from cyclofeat.recordings.windower import SAMPLES_PER_TURN
from cyclofeat.signal.lobes import LobeComb, LobeLines, line_contrast, lobe_frequency, lobe_lines
from cyclofeat.signal.windows import Float

#: Windows of a run at most: more turns lower the noise, but assemblies then differ by more than noise.
MOST_WINDOWS = 5
# Share of worn assemblies that are not counted as healthy at the least visible depth.
_SEEN = 0.9
# Share of healthy assemblies that may be counted as worn.
_FALSE_ALARMS = 0.05
# Lobe lines reach up to this share of the highest frequency that the windows hold.
_SHARE_OF_BAND = 0.93
# Torque below this amplitude in Nm is nothing.
_LEAST_NM = 1e-5


@dataclass(frozen=True)
class WearDepth:
    """Depth of the radial wear of a recording's worn lobes, in um."""

    depth_um: float | None  # estimate; None where no wear was seen
    low_um: float  # ends of the interval; where no wear was seen, wear up to high_um may be there
    high_um: float
    coverage: float  # share of assemblies with visible wear whose interval holds the true depth
    # Least depth at which 9 of 10 worn assemblies of the training were not counted as healthy; None where not
    # even the deepest wear of the training was seen so often, or none of its assemblies was healthy.
    limit_um: float | None

    def in_words(self) -> tuple[str, str]:
        """Return the depth, and what is said about it."""
        if self.depth_um is None:
            return "below what can be seen", f"up to {self.high_um:.3g} um may be there"
        interval = f"{100 * self.coverage:.3g} % interval {self.low_um:.3g} to {self.high_um:.3g} um"
        return f"{self.depth_um:.3g} um", interval

    def __str__(self) -> str:
        depth, about = self.in_words()
        return f"{depth} ({about})"

    def to_dict(self) -> dict[str, Any]:
        """Return the depth in plain types, as columns of a table."""
        return {
            "wear_um": self.depth_um,
            "wear_um_low": self.low_um,
            "wear_um_high": self.high_um,
            "wear_um_coverage": self.coverage,
            "wear_um_limit": self.limit_um,
        }


@dataclass(frozen=True)
class RadialWear:
    """Count and depth of radial wear from runs of windows; part of a :class:`LobeModel`.

    Early wear changes the torque by less than the noise in one window. The lobe lines of several windows in a
    row are narrower by as many times: they stand out of the noise, and apart from the lines of the shaft.
    """

    counter: GroupCalibratedCounter | LobeCounter  # of the features of runs, or of runs
    depth: (
        ConformalRegressor  # of the logarithm of the depth in um, from features and probabilities of counts
    )
    n_windows: int  # of a run
    n_lobes: int
    range_um: tuple[float, float]  # least and largest depth of the training
    limit_um: float | None  # see WearDepth
    # Share of runs counted right, and of healthy ones counted as worn, by counters that have not seen their
    # assembly; None where assemblies are too few, or none is healthy.
    accuracy: float | None
    false_alarms: float | None
    samples_per_turn: int = SAMPLES_PER_TURN
    # How many times as frequent a sound disc is taken to be as a disc of each other count: at least once, and
    # as often as it takes for such counters to count about 5 % of the healthy runs as worn. Faint wear is
    # like none: with equal odds a third of them may be.
    sound_odds: float = 1.0

    @classmethod
    def train(
        cls,
        windows: WindowSet,
        stated: tuple[Float, tuple[float, float]],
        *,
        n_lobes: int,
        n_trees: int = 300,
        random_state: int | None = None,
        network: LobeCounter | None = None,
    ) -> RadialWear:
        """Train on labelled windows over the angle of the shaft, those of each recording in a row.

        ``stated`` are the depth of each recording's wear in um, not used where no lobe is worn, and the least
        and largest depth; ``network`` is a counter of kind "network" for the runs, whose worn lobes are known
        and neighbours. Default: trees.
        """
        assert windows.y is not None
        depths_um, (low, high) = stated
        rows = sorted(np.split(np.arange(len(windows)), breaks_between(windows)), key=len)
        longest = {windows.recording[k[0]]: k for k in rows}  # of windows that follow one another
        of_recordings = [longest[k] for k in sorted(longest)]
        n_windows = min(MOST_WINDOWS, *map(len, of_recordings))
        # The first window of each run.
        first = np.concatenate([k[: k.size // n_windows * n_windows : n_windows] for k in of_recordings])
        recording, count = windows.recording[first], windows.y[first]
        member = recording if windows.groups is None else windows.groups[first]
        runs = [runs_of(windows.X[k], n_windows) for k in of_recordings]
        per_turn = round(windows.sampling_rate)
        features = np.vstack([wear_features(of_one, n_lobes, per_turn) for of_one in runs])
        counter: GroupCalibratedCounter | LobeCounter
        if network is not None:
            counter = network.set_params(n_lines=_n_lines(n_lobes, per_turn))
            table = windows.part(first).worn_table(n_lobes)
            marks = {"worn": table, "passage": passage_of_lobe_zero(windows.start_angle[first], n_lobes)}
            proba = counter._fit_cross_val_proba(np.concatenate(runs), count, member, **marks)
        else:
            trees = CountingTrees(n_trees, max_features=0.2, random_state=random_state)
            counter = GroupCalibratedCounter(trees, random_state=random_state)
            proba = counter._fit_cross_val_proba(features, count, member)
        log_depth = np.log(depths_um[recording])
        limit, accuracy, false_alarms, odds = None, None, None, 1.0
        # Depths are stated, and so learned and judged, where wear is seen.
        worn = seen = count > 0
        if counter.calibrated_:
            if not worn.all():
                # The odds of a sound disc, of the first class, at which 5 % of these are counted as worn.
                sound = proba[~worn]
                needed = sound[:, 1:].max(axis=1) / np.maximum(sound[:, 0], np.finfo(float).tiny)
                odds = max(float(np.quantile(needed, 1 - _FALSE_ALARMS, method="lower")), 1.0)
            answer = counter.classes_[_with_odds(proba, odds).argmax(axis=1)]
            accuracy = float(np.mean(answer == count))
            seen = worn & (answer > 0)
            if not worn.all():
                limit = least_visible_depth(log_depth[worn], seen[worn])
                false_alarms = float(np.mean(answer[~worn] > 0))
        else:
            proba = np.full_like(proba, 1 / counter.classes_.size)  # nothing was held out: it tells nothing
        if seen.sum() < 2:
            raise ValueError(
                "recordings must hold at least two whose wear shows, to learn its depth, got "
                f"{seen.sum()} of {worn.sum()} with wear of {low:g} to {high:g} um"
            )
        depth = ConformalRegressor(n_trees, random_state=random_state)
        depth.fit(np.hstack([proba, features])[seen], log_depth[seen], groups=member[seen])
        return cls(
            counter, depth, n_windows, n_lobes, (low, high), limit, accuracy, false_alarms, per_turn, odds
        )

    def made_for(self) -> str:
        """Return in words which depths the model was trained for and which it sees."""
        low, high = self.range_um
        text = f"{low:g} to {high:g} um in {number_of(self.n_windows, 'output turn')}"
        if self.limit_um is not None:
            text += f", seen in 9 of 10 assemblies from {self.limit_um:.3g} um on"
        if self.false_alarms is not None:
            text += f"; {100 * self.false_alarms:.2g} % of the healthy ones are taken for worn"
        return text

    def summary(self) -> dict[str, Any]:
        """Return wear metrics for the card of a model."""
        error = np.nanmedian(np.abs(self.depth.held_out_ - self.depth.values_))
        return {
            "range_um": list(self.range_um),
            "output_turns": self.n_windows,
            "limit_um": self.limit_um,
            "coverage": self.depth.coverage,
            "median_relative_error": None if np.isnan(error) else float(np.expm1(error)),
            "accuracy": self.accuracy,
            "false_alarms": self.false_alarms,
            "sound_odds": self.sound_odds,
        }

    def answers(self, X: Float, faults: Sequence[str], breaks: ArrayLike = ()) -> Float | None:
        """Return count probabilities and features of each run of windows, (n_runs, n_classes + n_features).

        ``X`` are windows of one recording over the angle of the shaft, torque in Nm, (n_windows, n_samples);
        windows with one of ``faults`` belong to no run, and none goes over ``breaks``, numbers of windows
        before which some were left out. None if there is no run.
        """
        # A window that is not used parts the runs.
        before = np.asarray(breaks, dtype=int)
        used = np.insert(np.array([not fault for fault in faults]), before, False)
        runs = runs_of(np.insert(X, before, 0.0, axis=0) if before.size else X, self.n_windows, used)
        if not len(runs):
            return None
        features = wear_features(runs, self.n_lobes, self.samples_per_turn)
        seen = runs if isinstance(self.counter, LobeCounter) else features
        return np.hstack([self.counter.predict_proba(seen), features])

    def probability(self, answers: Float) -> Float:
        """Return the probability of each count from the :meth:`answers` of all runs, shape (n_classes,)."""
        combined = pool_windows(answers[:, : self.counter.classes_.size], self.counter.dependence_)
        return np.asarray(_with_odds(combined[np.newaxis], self.sound_odds)[0])

    def depth_of(self, answers: Float, count: int) -> WearDepth:
        """Return the depth of a recording's wear, from its :meth:`answers` and the number of worn lobes."""
        low, high = self.range_um
        if count == 0:
            most = high if self.limit_um is None else self.limit_um
            return WearDepth(None, 0.0, most, self.depth.coverage, self.limit_um)
        # Runs of one recording err together: the interval of their mean is as wide as that of one.
        logs = self.depth.predict(answers), *self.depth.predict_interval(answers)
        depth, least, most = (float(np.clip(np.exp(values.mean()), low, high)) for values in logs)
        return WearDepth(depth, least, most, self.depth.coverage, self.limit_um)


def stated_depths(recordings: Sequence[Recording], range_um: Any) -> tuple[Float, tuple[float, float]]:
    """Return the depth that each recording states, 1 where no lobe is worn, and the checked range."""
    low, high = number_pair("wear_um", range_um)
    if not 0 < low < high:
        raise ValueError(f"wear_um must be a range (low, high) in um with 0 < low < high, got {range_um!r}")
    depths = np.ones(len(recordings))
    for k, recording in enumerate(recordings):
        if not recording.defect_count:
            continue
        depth = (recording.meta or {}).get("wear_um")
        if depth is None or not is_number(depth) or not low <= depth <= high:
            raise ValueError(
                f"recordings with worn lobes must state one depth from {low:g} to {high:g} um in "
                f'meta["wear_um"], that of assembly {recording.assembly} is {repr_of(depth)}'
            )
        depths[k] = depth
    return depths, (low, high)


def breaks_between(windows: WindowSet) -> NDArray[np.intp]:
    """Return the numbers of windows over the angle that do not follow the one before."""
    far = 3 * np.pi * windows.X.shape[1] / windows.sampling_rate
    return np.flatnonzero((np.diff(windows.recording) != 0) | (np.diff(windows.start_angle) > far)) + 1


def runs_of(X: Float, n_windows: int, used: NDArray[np.bool_] | None = None) -> Float:
    """Join windows of one recording that follow each other to runs, shape (n_runs, n_windows * n_samples).

    ``used``, shape (n,), marks windows that may be part of a run. Default: all.
    """
    usable = np.ones(len(X), dtype=bool) if used is None else used
    rows, at = [], 0
    while at + n_windows <= len(X):
        if usable[at : at + n_windows].all():
            rows.append(X[at : at + n_windows].ravel())
            at += n_windows
        else:
            at += 1
    return np.array(rows).reshape(len(rows), n_windows * X.shape[1])


def wear_features(runs: Float, n_lobes: int, samples_per_turn: int = SAMPLES_PER_TURN) -> Float:
    """Return features of runs, torque in Nm over the shaft's angle, for count and depth of radial wear.

    Those of a :class:`~cyclofeat.features.LobeMap`: the disturbance of each lobe, and each lobe line over its
    surroundings, without the resonance. Then contrast and level (logarithm of the power in Nm^2) of each line
    with the resonance: the depth needs the level.
    """
    n_lines = _n_lines(n_lobes, samples_per_turn)
    white = LobeMap(samples_per_turn, 1.0, n_lobes, n_lines, speed_tolerance=0.0)
    lines = lobe_lines_nm(runs, n_lobes, samples_per_turn)
    level = np.log(np.abs(lines.lines) ** 2 + _LEAST_NM**2)
    return np.hstack([white.from_lines(white.lines(runs)), line_contrast(lines), level])


def lobe_lines_nm(runs: Float, n_lobes: int, samples_per_turn: int = SAMPLES_PER_TURN) -> LobeLines:
    """Return the lobe lines of runs, as for :func:`wear_features`, in Nm and with the resonance."""
    comb = LobeComb(n_lobes, _n_lines(n_lobes, samples_per_turn), ar_order=0, speed_tolerance=0.0)
    lines = lobe_lines(np.asarray(runs, dtype=np.float64), samples_per_turn, 1.0, comb)
    scale = runs.std(axis=1, keepdims=True)
    return LobeLines(lines.input_speed_hz, lines.lines * scale, lines.floor * scale**2)


def _n_lines(n_lobes: int, samples_per_turn: int) -> int:
    return int(_SHARE_OF_BAND * samples_per_turn / 2 / lobe_frequency(1.0, n_lobes))


def _with_odds(proba: Float, sound_odds: float) -> Float:
    """Return probabilities of counts where a sound disc, the first, is this many times as frequent."""
    weighed = proba * np.where(np.arange(proba.shape[1]) == 0, sound_odds, 1.0)
    return np.asarray(weighed / weighed.sum(axis=1, keepdims=True))


def least_visible_depth(log_depth: Float, seen: NDArray[np.bool_]) -> float | None:
    """Return the least depth from which 9 of 10 worn assemblies are seen; None if there is none."""
    order = np.argsort(log_depth, kind="stable")
    share = IsotonicRegression().fit_transform(log_depth[order], seen[order].astype(float))
    enough = np.flatnonzero(share >= _SEEN)
    return float(np.exp(log_depth[order][enough[0]])) if enough.size else None
