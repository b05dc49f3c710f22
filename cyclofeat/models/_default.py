"""Models that come with the package: one for each quantity, trained on simulated assemblies."""

from __future__ import annotations

import os
from pathlib import Path

from cyclofeat._base.checks import one_of
from cyclofeat._base.quantities import QUANTITIES
from cyclofeat.counting import LobeModel
from cyclofeat.models._persistence import load_model

FOLDER = Path(__file__).with_name("default")
# They are tested with each supported version of these.
_TESTED_WITH = ("python", "numpy", "scipy", "scikit-learn", "skops")


def default_model_path(quantity: str = "output_torque") -> Path:
    """Return the path of the packaged model of a quantity; its card lies beside it.

    Parameters
    ----------
    quantity : {"output_torque", "input_torque", "motor_current"}

    Raises
    ------
    ValueError
        If there is no such quantity.
    """
    return FOLDER / f"{one_of('quantity', quantity, QUANTITIES)}.skops"


def load_default_model(
    quantity: str = "output_torque", *, cache: str | os.PathLike[str] | None = None
) -> LobeModel:
    """Read the packaged model of a quantity.

    It has learned from simulated assemblies of rig R2 (:func:`cyclofeat.datasets.make_rig_recordings`), whose
    brake, torque meter and contacts vary, at 100 to 1,500 RPM and 3 to 40 Nm. A model of a rig whose brake is
    known counts better: ``benchmarks/operating_points.md``.

    Parameters
    ----------
    quantity : {"output_torque", "input_torque", "motor_current"}, default="output_torque"
        What the recordings hold.
    cache : path-like, optional
        As of :func:`load_model`.

    Raises
    ------
    ImportError
        If skops is not installed.
    ValueError
        If there is no such quantity.

    Examples
    --------
    >>> model = load_default_model("motor_current")
    >>> model.made_for()
    'of motor current at 99.23 to 1511 RPM and 3 to 40 Nm, with at least 37 samples per input turn'
    >>> model.samples_per_turn, model.coarser.samples_per_turn
    (128, 37)
    """
    loaded: LobeModel = load_model(default_model_path(quantity), allow=_TESTED_WITH, cache=cache)
    return loaded
