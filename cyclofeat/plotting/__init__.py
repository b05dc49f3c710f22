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

``from_recording`` (or ``from_estimator``) makes a display, ``plot(ax=None)`` draws it, sets ``ax_`` and
``figure_`` and returns the display. Those of the gap draw at once, by ``from_result``. Only drawing needs
matplotlib (``pip install matplotlib``). ``plot`` of recordings and results makes and draws a display in one
call: ``recording.plot("spectrum")``.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

from cyclofeat._base import Draw, register_plots
from cyclofeat.plotting._gap import GapDisplay
from cyclofeat.plotting._gap_correction import GapOverlayDisplay, GapReductionDisplay
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


def _of_recording(display: Any) -> Draw:
    return lambda recording, ax, **options: display.from_recording(recording).plot(ax, **options)


def _of_result(display: Any) -> Callable[..., Any]:
    return lambda kind, result, ax, **options: display(result).plot(kind, ax, **options)


def _of_gap(kind: Any, result: Any, ax: Any, **options: Any) -> Any:
    display = GapDisplay if kind == "families" else GapOverlayDisplay
    return display.from_result(result, kind, ax, **options)


def _each(draw: Callable[..., Any], *kinds: str) -> dict[str, Draw]:
    return {kind: partial(draw, kind) for kind in kinds}


# The pictures behind the ``plot`` methods of recordings and results, by the name of the class.
register_plots(
    "Recording",
    {
        "torque": _of_recording(TorqueDisplay),
        "spectrum": _of_recording(SpectrumDisplay),
        "orders": _of_recording(OrderDisplay),
        "lobes": _of_recording(LobeMapDisplay),
    },
)
register_plots("LobeCount", _each(_of_result(CountDisplay), "counts", "lobes"))
register_plots("Evaluation", _each(_of_result(EvaluationDisplay), "confusion", "calibration"))
register_plots(
    "GapResult",
    {
        **_each(_of_gap, "spectrum", "orders", "distribution"),
        "differences": partial(_of_gap, "families"),
        "closed": GapReductionDisplay.from_result,
    },
)
