"""Pictures of torque, spectrum, lobe map and gap, as Display objects in scikit-learn's idiom.

=======================  ==================================================================================
class                    picture
=======================  ==================================================================================
``TorqueDisplay``        torque over time
``SpectrumDisplay``      spectrum of the torque, with lobe lines and orders of the input shaft
``OrderDisplay``         lines of the output turn, by what they belong to: lobes, input shaft, mesh
``LobeMapDisplay``       the disc with a ring as dark as its lobes are worn, and the torque's disturbance
``TrainingDisplay``      features of a recording beside those of the training windows of some counts
``GapDisplay``           where recordings and simulator differ: families, spectrum, orders, phase
``GapOverlayDisplay``    recordings, model and corrected model over each other
``GapReductionDisplay``  how far corrected simulators close that gap
``CountDisplay``         probability of each number of worn lobes, and of each lobe
``EvaluationDisplay``    confusion matrix and calibration of a counter
=======================  ==================================================================================

The class itself makes a display; ``plot(ax=None)`` draws it, sets ``ax_`` and ``figure_`` and returns the
display. Only drawing needs matplotlib (``pip install matplotlib``). ``plot`` of recordings and results makes
and draws a display in one call: ``recording.plot("spectrum")``.
"""

from functools import partial
from typing import Any

from cyclofeat._base import register_plots
from cyclofeat._base.quantities import number_of
from cyclofeat.plotting._gap import GapDisplay, GapOverlayDisplay, GapReductionDisplay
from cyclofeat.plotting._lobe_map import LobeMapDisplay
from cyclofeat.plotting._recording import OrderDisplay, SpectrumDisplay, TorqueDisplay
from cyclofeat.plotting._results import CountDisplay, EvaluationDisplay
from cyclofeat.plotting._training import TrainingDisplay

__all__ = [
    "CountDisplay",
    "EvaluationDisplay",
    "GapDisplay",
    "GapOverlayDisplay",
    "GapReductionDisplay",
    "LobeMapDisplay",
    "OrderDisplay",
    "SpectrumDisplay",
    "TorqueDisplay",
    "TrainingDisplay",
]


def _draw(display: Any, drawn: Any, ax: Any, **options: Any) -> Any:
    return display(drawn).plot(ax=ax, **options)


def _draw_gap(kind: str, result: Any, ax: Any, *, condition: int = 0, **options: Any) -> Any:
    display: Any = GapOverlayDisplay
    name, parts = f"overlays of {kind=}", [part for part in result.overlays if part.kind == kind]
    if kind == "closed":
        name, parts, display = "proof", [proof.rows for proof in result.proof], GapReductionDisplay
    elif kind == "differences":
        name, parts, display = "a comparison", result.where, GapDisplay
    if not 0 <= condition < len(parts):
        conditions = number_of(len(parts), "condition")
        raise ValueError(f"result has {name} at {conditions}, got condition={condition}")
    drawn = display(parts[condition], **options)
    return drawn.plot("families", ax) if kind == "differences" else drawn.plot(ax)


# The pictures behind the ``plot`` methods of recordings and results, by the name of the class.
_OF_RECORDING: dict[str, Any] = {
    "torque": TorqueDisplay, "spectrum": SpectrumDisplay, "orders": OrderDisplay, "lobes": LobeMapDisplay,
}  # fmt: skip
_OF_GAP = ("spectrum", "orders", "distribution", "differences", "closed")
register_plots("Recording", {kind: partial(_draw, display) for kind, display in _OF_RECORDING.items()})
register_plots("LobeCount", {kind: partial(_draw, CountDisplay, kind=kind) for kind in ("counts", "lobes")})
register_plots(
    "Evaluation",
    {kind: partial(_draw, EvaluationDisplay, kind=kind) for kind in ("confusion", "calibration")},
)
register_plots("GapResult", {kind: partial(_draw_gap, kind) for kind in _OF_GAP})
