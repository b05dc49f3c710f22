"""Gain of a counter of worn lobes that is trained on a corrected model."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from cyclofeat.counting import make_lobe_counter
from cyclofeat.gap.comparison import Comparison
from cyclofeat.gap.summaries import Measured, per_recording

Float = NDArray[np.float64]

_INTERVAL = (0.05, 0.95)


@dataclass(frozen=True)
class DownstreamGain:
    """Accuracy on measured recordings of counters that are trained on simulated ones.

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
    comparison: Comparison,
    corrected: Any,
    measured: Measured,
    *,
    oracle: Any = None,
    n_per_class: int = 24,
    n_trees: int = 300,
) -> DownstreamGain:
    """Train the toolkit's counter of worn lobes on each model, and count held-out recordings with it.

    Parameters
    ----------
    comparison : Comparison
        With the model as it was.
    corrected : Rig
        The corrected model.
    measured : Measured
        Recordings not used so far, with known counts; the counter's probabilities are averaged over the
        windows of a recording.
    oracle : Rig, optional
        The true model, where it is known.
    n_per_class : int, default=24
        Simulated recordings of each count, from the same random numbers for all models. The counts are those
        of the comparison and of the measured recordings.
    n_trees : int, default=300
        Trees of the counter.

    Returns
    -------
    DownstreamGain

    Raises
    ------
    ValueError
        If the counts of the recordings are not known.

    Notes
    -----
    The accuracy over n recordings has a standard error of up to 0.5 / sqrt(n). The share of the oracle's gain
    has two accuracies in its denominator, so a dozen recordings give a wide interval.

    Examples
    --------
    >>> from cyclofeat.simulators import Rig, TorqueMeterLowPass
    >>> rig = Rig.r1().with_added(TorqueMeterLowPass(100.0))
    >>> truth = Comparison(sampling_rate=6400.0, rig=rig, defect_counts=(0, 7))
    >>> comparison, hold = truth.replace(rig=Rig.r1()), truth.bank(4, random_state=5)
    >>> measured = comparison.measured(hold.X, y=hold.counts)
    >>> gain = downstream_gain(comparison, rig, measured, oracle=rig, n_per_class=4)
    >>> gain.n_recordings, gain.accuracy["after"] == gain.accuracy["oracle"]
    (4, True)
    """
    counts = measured.counts
    if counts is None:
        raise ValueError("measured must have known counts of worn lobes, got none")
    classes = sorted({*comparison.defect_counts, *counts.tolist()})
    models = {"before": comparison.rig, "after": corrected} | ({} if oracle is None else {"oracle": oracle})
    right: dict[str, NDArray[np.bool_]] = {}
    hits_of: dict[str, NDArray[np.bool_]] = {}  # equal models share a counter
    for name, model in models.items():
        of_model = comparison.replace(rig=model, random_state=comparison.random_state + 2)
        if of_model.text not in hits_of:
            bank = of_model.bank(n_per_class * len(classes), classes)
            counter = make_lobe_counter(
                comparison.sampling_rate, input_speed_hz=comparison.conditions.input_speed_hz,
                n_lobes=comparison.n_lobes, n_trees=n_trees, random_state=comparison.random_state,
            )  # fmt: skip
            counter.fit(bank.X, bank.counts)
            votes = per_recording(counter.predict_proba(measured.windows), measured.of_window)
            hits_of[of_model.text] = counter.classes_[votes.argmax(axis=1)] == counts
        right[name] = hits_of[of_model.text]
    accuracy = {name: float(hits.mean()) for name, hits in right.items()}
    share, interval = np.nan, (np.nan, np.nan)
    if oracle is not None and accuracy["oracle"] > accuracy["before"]:
        share = _share(*(np.array([accuracy[name]]) for name in ("before", "after", "oracle")))[0]
        random = np.random.default_rng([comparison.random_state, 4])
        draws = random.integers(len(counts), size=(1000, len(counts)))
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
    """Return (after - before) / (oracle - before); infinite if the oracle gains nothing."""
    gain, total = after - before, oracle - before
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(total > 0, gain / total, np.where(gain >= 0, np.inf, -np.inf))


def _wilson(n_right: int, n: int) -> tuple[float, float]:
    interval = stats.binomtest(n_right, n).proportion_ci(0.95, method="wilson")
    return float(interval.low), float(interval.high)
