"""Ready pipelines: windows of torque in, number of worn lobes out."""

from __future__ import annotations

from typing import Any

from sklearn.base import BaseEstimator
from sklearn.pipeline import Pipeline
from sklearn.preprocessing import StandardScaler

from cyclofeat.counting._calibration import GroupCalibratedCounter
from cyclofeat.counting._ladder import EntropyLadder
from cyclofeat.counting._lobes import LobeCounter
from cyclofeat.counting._ordinal import OrdinalCounter
from cyclofeat.counting._trees import CountingTrees
from cyclofeat.features import LobeMap, SpectralEntropy, TorqueFeatures

KINDS = ("lobe_map", "features", "ladder", "ordinal", "lobes")


def make_lobe_counter(
    sampling_rate: float,
    *,
    kind: str = "lobe_map",
    input_speed_hz: float = 500 / 60,
    n_lobes: int = 15,
    n_trees: int = 300,
    calibrated: bool = False,
    random_state: int | None = 0,
) -> Any:
    """Counter of worn lobes, ready to fit to windows.

    ==============  ====================================================================================
    kind            what it is made of
    ==============  ====================================================================================
    ``"lobe_map"``  :class:`~cyclofeat.features.LobeMap`, then extremely randomised trees
    ``"features"``  :class:`~cyclofeat.features.TorqueFeatures` (all of them), then the same trees
    ``"ladder"``    :class:`~cyclofeat.features.SpectralEntropy`, then :class:`EntropyLadder`: the papers'
    ``"ordinal"``   :class:`~cyclofeat.features.LobeMap`, scaled, then :class:`OrdinalCounter`
    ``"lobes"``     :class:`LobeCounter`: count and positions
    ==============  ====================================================================================

    Parameters
    ----------
    sampling_rate : float
        Samples per second of the windows, in Hz.
    kind : {"lobe_map", "features", "ladder", "ordinal", "lobes"}
    input_speed_hz : float
        Nominal input speed in turns per second.
    n_lobes : int
        Number of lobes of a disc.
    n_trees : int
        Number of trees, for the kinds that have any.
    calibrated : bool
        Whether to put the counter into a :class:`GroupCalibratedCounter`, whose probabilities are right as
        often as they say: its ``fit`` takes the assemblies as ``groups``. ``"lobes"`` does that by itself and
        is left as it is.
    random_state : int or None
        Seed of the trees and folds.

    Returns
    -------
    sklearn.pipeline.Pipeline, LobeCounter or GroupCalibratedCounter
        Unfitted. The steps of the pipelines are ``"lobe_map"`` and ``"trees"``; ``"features"`` and
        ``"trees"``; ``"entropy"`` and ``"ladder"``; ``"lobe_map"``, ``"scaler"`` and ``"ordinal"``.

    Raises
    ------
    ValueError
        If there is no such kind.

    Examples
    --------
    >>> counter = make_lobe_counter(sampling_rate=25_600)
    >>> [name for name, _ in counter.steps]
    ['lobe_map', 'trees']
    >>> ordinal = make_lobe_counter(sampling_rate=25_600, kind="ordinal", calibrated=True)
    >>> ordinal.set_params(counter__ordinal__alpha=10.0).counter[-1]
    OrdinalCounter(alpha=10.0)
    """
    if kind not in KINDS:
        raise ValueError(f"kind must be one of {KINDS}, got {kind!r}")
    disc: dict[str, Any] = {"input_speed_hz": input_speed_hz, "n_lobes": n_lobes}
    if kind == "lobes":
        return LobeCounter(sampling_rate, **disc, n_trees=n_trees, random_state=random_state)
    trees = ("trees", CountingTrees(n_estimators=n_trees, random_state=random_state))
    lobe_map = ("lobe_map", LobeMap(sampling_rate, **disc))
    steps: dict[str, list[tuple[str, BaseEstimator]]] = {
        "lobe_map": [lobe_map, trees],
        "features": [("features", TorqueFeatures(sampling_rate, **disc)), trees],
        "ladder": [("entropy", SpectralEntropy(sampling_rate)), ("ladder", EntropyLadder())],
        "ordinal": [lobe_map, ("scaler", StandardScaler()), ("ordinal", OrdinalCounter())],
    }
    pipeline = Pipeline(steps[kind])
    return GroupCalibratedCounter(pipeline, random_state=random_state) if calibrated else pipeline


def make_entropy_counter(
    sampling_rate: float, *, n_trees: int = 300, random_state: int | None = 0
) -> Pipeline:
    """The papers' best feature in the same place: Shannon spectral entropy, then the same trees.

    Trees can take any course of the entropy over the count; ``make_lobe_counter(kind="ladder")`` reads it as
    the papers do, as a ladder.

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
