"""Ready pipelines: windows of torque in, number of worn lobes out."""

from __future__ import annotations

from typing import Any

from sklearn.ensemble import ExtraTreesClassifier
from sklearn.pipeline import Pipeline

from cyclofeat.features import LobeMap, SpectralEntropy


class CountingTrees(ExtraTreesClassifier):
    """Extremely randomised trees over features of windows; parameters as in scikit-learn.

    Says of itself that it scores poorly on arbitrary data, so that scikit-learn's conformance suite does not
    ask it to tell clouds of points with two coordinates apart, of which no lobe map can be made.
    """

    def __sklearn_tags__(self) -> Any:
        tags = super().__sklearn_tags__()
        tags.classifier_tags.poor_score = True
        return tags


def make_lobe_counter(
    sampling_rate: float,
    *,
    input_speed_hz: float = 500 / 60,
    n_lobes: int = 15,
    n_trees: int = 300,
    random_state: int | None = 0,
) -> Pipeline:
    """Counter of worn lobes: :class:`~cyclofeat.features.LobeMap`, then extremely randomised trees.

    Parameters
    ----------
    sampling_rate : float
        Samples per second of the windows, in Hz.
    input_speed_hz : float
        Nominal input speed in turns per second.
    n_lobes : int
        Number of lobes of a disc.
    n_trees : int
        Number of trees.
    random_state : int or None
        Seed of the trees.

    Returns
    -------
    sklearn.pipeline.Pipeline
        Steps ``"lobe_map"`` and ``"trees"``; unfitted.

    Examples
    --------
    >>> counter = make_lobe_counter(sampling_rate=25_600)
    >>> [name for name, _ in counter.steps]
    ['lobe_map', 'trees']
    """
    return Pipeline(
        [
            ("lobe_map", LobeMap(sampling_rate, input_speed_hz=input_speed_hz, n_lobes=n_lobes)),
            ("trees", CountingTrees(n_estimators=n_trees, random_state=random_state)),
        ]
    )


def make_entropy_counter(
    sampling_rate: float, *, n_trees: int = 300, random_state: int | None = 0
) -> Pipeline:
    """The papers' best feature in the same place: Shannon spectral entropy, then the same trees.

    Parameters
    ----------
    sampling_rate : float
        Samples per second of the windows, in Hz.
    n_trees : int
        Number of trees.
    random_state : int or None
        Seed of the trees.

    Returns
    -------
    sklearn.pipeline.Pipeline
        Steps ``"entropy"`` and ``"trees"``; unfitted.
    """
    return Pipeline(
        [
            ("entropy", SpectralEntropy(sampling_rate)),
            ("trees", CountingTrees(n_estimators=n_trees, random_state=random_state)),
        ]
    )
