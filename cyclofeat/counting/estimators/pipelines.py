"""Ready pipelines: windows of torque in, number of worn lobes out."""

from __future__ import annotations

from typing import Any

from sklearn.base import BaseEstimator
from sklearn.pipeline import Pipeline

from cyclofeat.counting.estimators.entropy_ladder import EntropyLadder
from cyclofeat.counting.estimators.lobe_counter import LobeCounter
from cyclofeat.counting.estimators.trees import CountingTrees
from cyclofeat.features import LobeMap, SpectralEntropy, TorqueFeatures
from cyclofeat.signal.lobes import SPEED_TOLERANCE, lines_held

KINDS = ("lobe_map", "features", "entropy", "ladder", "trees", "network")


def make_lobe_counter(
    sampling_rate: float,
    *,
    kind: str = "lobe_map",
    input_speed_hz: float = 500 / 60,
    n_lobes: int = 15,
    n_trees: int = 300,
    random_state: int | None = None,
    speed_tolerance: float = SPEED_TOLERANCE,
) -> Any:
    """Make a counter of worn lobes of a chosen kind, ready to fit to windows.

    Only a :class:`LobeCounter` is calibrated; put the others into a :class:`GroupCalibratedCounter`.

    ==============  ====================================================================================
    kind            what it is made of
    ==============  ====================================================================================
    ``"lobe_map"``  :class:`~cyclofeat.features.LobeMap`, then extremely randomised trees
    ``"features"``  :class:`~cyclofeat.features.TorqueFeatures` (all of them), then the same trees
    ``"entropy"``   :class:`~cyclofeat.features.SpectralEntropy`, the papers' feature, then the same trees
    ``"ladder"``    the same feature, then :class:`EntropyLadder`, as the papers read it
    ``"trees"``     :class:`LobeCounter`: calibrated count, and positions
    ``"network"``   :class:`LobeCounter` of kind "network": the same for lobes that are neighbours
    ==============  ====================================================================================

    Parameters
    ----------
    sampling_rate : float
        Samples per second of the windows, in Hz. A low rate holds fewer lobe lines than 44.
    kind : {"lobe_map", "features", "entropy", "ladder", "trees", "network"}
    input_speed_hz : float
        Nominal input speed in turns per second.
    n_lobes : int
        Number of lobes of a disc.
    n_trees : int
        Number of trees, for the kinds that have any.
    random_state : int or None
        Seed of the trees and folds.
    speed_tolerance : float
        Largest relative deviation from the nominal speed that the kinds with a lobe map search; 0 for windows
        over the angle of the shaft.

    Returns
    -------
    sklearn.pipeline.Pipeline or LobeCounter
        Unfitted. The steps of the pipelines are ``"lobe_map"``, ``"features"`` or ``"entropy"``, and
        ``"trees"`` or ``"ladder"``.

    Examples
    --------
    >>> counter = make_lobe_counter(sampling_rate=25_600)
    >>> [name for name, _ in counter.steps]
    ['lobe_map', 'trees']
    """
    if kind not in KINDS:
        raise ValueError(f"kind must be one of {KINDS}, got {kind!r}")
    disc: dict[str, Any] = {"input_speed_hz": input_speed_hz, "n_lobes": n_lobes}
    if kind in ("trees", "network"):
        return LobeCounter(
            sampling_rate, kind=kind, **disc, n_trees=n_trees, random_state=random_state,
            speed_tolerance=speed_tolerance,
        )  # fmt: skip
    trees = ("trees", CountingTrees(n_estimators=n_trees, random_state=random_state))
    n_lines = lines_held(sampling_rate, input_speed_hz, n_lobes, speed_tolerance)
    lobe_map = LobeMap(sampling_rate, **disc, n_lines=n_lines, speed_tolerance=speed_tolerance)
    entropy = ("entropy", SpectralEntropy(sampling_rate))
    steps: dict[str, list[tuple[str, BaseEstimator]]] = {
        "lobe_map": [("lobe_map", lobe_map), trees],
        "features": [("features", TorqueFeatures(sampling_rate, **disc)), trees],
        "entropy": [entropy, trees],
        "ladder": [entropy, ("ladder", EntropyLadder())],
    }
    return Pipeline(steps[kind])
