"""The pictures behind the ``plot`` methods of recordings and results, by the name of the class."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

from cyclofeat._base.plots import Draw, register
from cyclofeat.plotting._count import CountDisplay
from cyclofeat.plotting._evaluation import EvaluationDisplay
from cyclofeat.plotting._gap import GapDisplay
from cyclofeat.plotting._gap_overlay import GapOverlayDisplay
from cyclofeat.plotting._gap_reduction import GapReductionDisplay
from cyclofeat.plotting._lobe_map import LobeMapDisplay
from cyclofeat.plotting._orders import OrderDisplay
from cyclofeat.plotting._spectrum import SpectrumDisplay
from cyclofeat.plotting._torque import TorqueDisplay

if TYPE_CHECKING:
    from cyclofeat.counting import Evaluation, LobeCount
    from cyclofeat.gap import GapResult


def _count(kind: Any, count: LobeCount, ax: Any, **options: Any) -> CountDisplay:
    return CountDisplay(count).plot(kind, ax, **options)


def _evaluation(kind: Any, result: Evaluation, ax: Any, **options: Any) -> EvaluationDisplay:
    return EvaluationDisplay(result).plot(kind, ax, **options)


def _overlay(kind: Any, result: GapResult, ax: Any, **options: Any) -> GapOverlayDisplay:
    return GapOverlayDisplay.from_result(result, kind, ax, **options)


def _differences(result: GapResult, ax: Any, **options: Any) -> GapDisplay:
    return GapDisplay.from_result(result, "families", ax, **options)


def _of_recording(display: Any) -> Draw:
    return lambda recording, ax, **options: display.from_recording(recording).plot(ax, **options)


def _each(draw: Callable[..., Any], *kinds: str) -> dict[str, Draw]:
    return {kind: partial(draw, kind) for kind in kinds}


register(
    "Recording",
    {
        "torque": _of_recording(TorqueDisplay),
        "spectrum": _of_recording(SpectrumDisplay),
        "orders": _of_recording(OrderDisplay),
        "lobes": _of_recording(LobeMapDisplay),
    },
)
register("LobeCount", _each(_count, "counts", "lobes"))
register("Evaluation", _each(_evaluation, "confusion", "calibration"))
register(
    "GapResult",
    {
        **_each(_overlay, "spectrum", "orders", "distribution"),
        "differences": _differences,
        "closed": GapReductionDisplay.from_result,
    },
)
