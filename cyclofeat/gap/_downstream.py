"""What a corrected simulator is worth to a counter of worn lobes that is trained on its recordings."""

from __future__ import annotations

import os
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats
from sklearn.utils.validation import check_array

from cyclofeat.counting import make_lobe_counter
from cyclofeat.gap._baselines import Banks
from cyclofeat.gap._null import NuisancePrior
from cyclofeat.gap._recordings import per_recording, recordings_of, registered
from cyclofeat.simulators import CompositeSimulator, CycloidalGearbox, Rig

Float = NDArray[np.float64]

_INTERVAL = (0.05, 0.95)


@dataclass(frozen=True)
class DownstreamGain:
    """How well a counter trained on simulated recordings counts on measured ones.

    Attributes
    ----------
    n_recordings : int
        Held-out recordings.
    accuracy : dict from str to float
        Share of them counted right when trained on ``"before"``, ``"after"`` and ``"oracle"``.
    interval : dict from str to (float, float)
        Its interval of 95 % (Wilson).
    share : float
        (after - before) / (oracle - before); NaN without an oracle, or where the oracle gains nothing.
    share_interval : (float, float)
        Its interval of 90 % by bootstrap over recordings; infinite ends where draws have no gain to share.
    """

    n_recordings: int
    accuracy: dict[str, float]
    interval: dict[str, tuple[float, float]]
    share: float
    share_interval: tuple[float, float]


def downstream_gain(
    before: CompositeSimulator | Rig | CycloidalGearbox | None,
    after: CompositeSimulator | Rig | CycloidalGearbox | None,
    X_hold: ArrayLike,
    y_hold: ArrayLike,
    sampling_rate: float,
    *,
    groups: ArrayLike | None = None,
    oracle: CompositeSimulator | Rig | CycloidalGearbox | None = None,
    nuisance: NuisancePrior | None = None,
    input_speed_hz: float = 500 / 60,
    n_per_class: int = 24,
    n_trees: int = 300,
    random_state: int = 0,
    n_jobs: int = 1,
    cache: str | os.PathLike[str] | None = None,
) -> DownstreamGain:
    """Train the toolkit's counter of worn lobes on each simulator, and count held-out recordings with it.

    Parameters
    ----------
    before, after
        The simulator as it was and corrected.
    X_hold : array-like, shape (n_windows, n_samples)
        Torque in Nm of recordings not used so far.
    y_hold : array-like of int, shape (n_windows,)
        Their counts of worn lobes.
    sampling_rate : float
        In Hz.
    groups : array-like, shape (n_windows,), optional
        Recording of each window; the counter's probabilities are averaged over a recording's windows.
    oracle : optional
        The true simulator, where it is known.
    nuisance, input_speed_hz, random_state, n_jobs, cache
        As in :class:`GapReport`.
    n_per_class : int
        Simulated recordings of each count, with the same seeds for all simulators. The counts are those of
        the prior and of the held-out recordings.
    n_trees : int
        Trees of the counter.

    Returns
    -------
    DownstreamGain

    Raises
    ------
    ValueError
        If ``X_hold``, ``y_hold`` and ``groups`` do not belong together, or windows are too short.

    Notes
    -----
    An accuracy of n recordings has a standard error of up to 0.5 / sqrt(n), and a share of the oracle's gain
    has two of them in its denominator: with a dozen recordings it is an anecdote, and its interval says so.

    Examples
    --------
    >>> from cyclofeat.gap import NuisancePrior, make_bank
    >>> from cyclofeat.simulators import CompositeSimulator, Rig, TorqueMeterLowPass
    >>> prior, options = NuisancePrior(defect_counts=(0, 7)), {"n_samples": 11_520, "sampling_rate": 6400.0}
    >>> truth = CompositeSimulator(Rig.r1(), [TorqueMeterLowPass(100.0)])
    >>> hold = make_bank(truth, prior, n=4, random_state=5, **options)
    >>> found = downstream_gain(
    ...     Rig.r1(), truth, hold.X, hold.counts, 6400.0, oracle=truth, nuisance=prior, n_per_class=4
    ... )
    >>> found.n_recordings, found.accuracy["after"] == found.accuracy["oracle"]
    (4, True)
    """
    prior = NuisancePrior() if nuisance is None else nuisance
    n_lobes = prior.n_lobes(before, input_speed_hz)
    windows = check_array(X_hold, dtype=[np.float64, np.float32]).astype(np.float32)
    of_window, counts = recordings_of(len(windows), y_hold, groups)
    assert counts is not None
    windows = registered(windows, sampling_rate, input_speed_hz, n_lobes)
    classes = sorted({*prior.defect_counts, *counts.tolist()})
    banks = Banks(prior, sampling_rate, input_speed_hz, n_per_class * len(classes), n_jobs, cache)
    simulators = {"before": before, "after": after}
    if oracle is not None:
        simulators["oracle"] = oracle
    # One counter for simulators that are the same.
    texts = {name: prior.simulator(simulator).to_rig().to_text() for name, simulator in simulators.items()}
    hits_of: dict[str, NDArray[np.bool_]] = {}
    for name, simulator in simulators.items():
        if texts[name] in hits_of:
            continue
        bank = banks.make(simulator, classes, windows.shape[1], random_state + 2)
        counter = make_lobe_counter(
            sampling_rate, input_speed_hz=input_speed_hz, n_lobes=n_lobes, n_trees=n_trees,
            random_state=random_state,
        )  # fmt: skip
        counter.fit(bank.X, bank.counts)
        votes = per_recording(counter.predict_proba(windows), of_window)
        hits_of[texts[name]] = counter.classes_[votes.argmax(axis=1)] == counts
    right = {name: hits_of[text] for name, text in texts.items()}
    accuracy = {name: float(hits.mean()) for name, hits in right.items()}
    share, interval = np.nan, (np.nan, np.nan)
    if oracle is not None and accuracy["oracle"] > accuracy["before"]:
        share = _share(*(np.array([accuracy[name]]) for name in ("before", "after", "oracle")))[0]
        draws = np.random.default_rng([random_state, 4]).integers(len(counts), size=(1000, len(counts)))
        shares = _share(*(right[name][draws].mean(axis=1) for name in ("before", "after", "oracle")))
        low, high = np.quantile(shares, _INTERVAL, method="nearest")
        interval = (float(low), float(high))
    return DownstreamGain(
        n_recordings=len(counts),
        accuracy=accuracy,
        interval={name: _wilson(int(hits.sum()), len(counts)) for name, hits in right.items()},
        share=float(share),
        share_interval=interval,
    )


def _share(before: Float, after: Float, oracle: Float) -> Float:
    """(after - before) / (oracle - before); infinite with the sign of the numerator without a gain."""
    gain, total = after - before, oracle - before
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(total > 0, gain / total, np.where(gain >= 0, np.inf, -np.inf))


def _wilson(n_right: int, n: int) -> tuple[float, float]:
    interval = stats.binomtest(n_right, n).proportion_ci(0.95, method="wilson")
    return float(interval.low), float(interval.high)
