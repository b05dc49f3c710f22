"""All that the report of a gap is made from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from cyclofeat.gap import GapLocator
    from cyclofeat.simulators import Effect


@dataclass(frozen=True)
class GapFindings:
    """All that the report of a gap is made from.

    Parameters
    ----------
    result : mapping
        What ``cyclofeat gap --json`` prints: ``verdict``, ``p``, ``effects``, ``ranking``, ``tie_group``,
        ``unknown``, ``next_measurement``, ``warnings``; keys that are missing count as empty.
    locator : GapLocator
        Fitted with the simulator as it was.
    locator_after : GapLocator, optional
        Fitted with the corrected simulator.
    report : GapReport, optional
        Scored on recordings held out: ``comparison_``, ``distances_``, ``grr_``, ``grr_ci_``, ``undefined_``.
    effects : sequence of Effect
        The fitted effects.
    theta : mapping from str to float
        Fitted parameters by ``"effect_id.parameter"``, in their units.
    theta_ci : mapping from str to tuple of float
        Their intervals.
    identifiable, at_bound : mapping from str to bool
        Whether the recordings fix them, and whether they lie at an end of their range.
    confidence : float, default=0.9
        Of the intervals.
    sources : sequence of str or None
        ``Recording.source`` of each recording. Where one is ``"simulated"`` or ``"surrogate"`` the report
        says so, and calls nothing of it measured.
    settings : mapping
        What the results were made from, label to value.
    warnings : sequence of str
        Besides those of ``result``.
    seconds : float, optional
        Computing time.
    title : str, optional
        Heading.
    """

    result: Mapping[str, Any]
    locator: GapLocator
    locator_after: GapLocator | None = None
    report: Any = None
    effects: Sequence[Effect] = ()
    theta: Mapping[str, float] = field(default_factory=dict)
    theta_ci: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    identifiable: Mapping[str, bool] = field(default_factory=dict)
    at_bound: Mapping[str, bool] = field(default_factory=dict)
    confidence: float = 0.9
    sources: Sequence[str | None] = ()
    settings: Mapping[str, Any] = field(default_factory=dict)
    warnings: Sequence[str] = ()
    seconds: float | None = None
    title: str = ""
