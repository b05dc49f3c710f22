"""Display of overlays: every curve with its band, and what it is."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from gap_answers import FIRST, SECOND, answered, overlay
from matplotlib import pyplot as plt
from numpy.testing import assert_allclose

from cyclofeat.plotting import GapOverlayDisplay

KINDS = ("spectrum", "orders", "distribution")


@pytest.mark.parametrize("kind", KINDS)
def test_curves_and_bands_are_those_of_the_overlay(kind):
    shown = overlay(kind)
    _, ax = plt.subplots()
    display = GapOverlayDisplay(shown, label="surrogate").plot(ax)
    assert display.ax_ is ax
    lines = {line.get_label(): line for line in ax.get_lines()}
    assert list(lines) == ["model", "surrogate", "corrected model"]
    bands = (shown.model, shown.measured, shown.corrected)
    for line, band, area in zip(lines.values(), bands, ax.collections, strict=True):
        assert_allclose(line.get_xydata(), np.column_stack([shown.x, band.mean]))
        heights = area.get_paths()[0].vertices[:, 1]
        assert [heights.min(), heights.max()] == pytest.approx([band.low.min(), band.high.max()])
    assert [text.get_text() for text in ax.get_legend().get_texts()] == list(lines)
    assert ax.get_yscale() == ("linear" if kind == "distribution" else "log")


def test_without_a_corrected_model_there_are_two():
    display = GapOverlayDisplay(dataclasses.replace(overlay(), corrected=None)).plot()
    assert [line.get_label() for line in display.ax_.get_lines()] == ["model", "measured"]


def test_of_a_result_by_kind_and_condition(compared_hum):
    result = answered(compared_hum["hum"])
    for number, condition in enumerate((FIRST, SECOND)):
        display = GapOverlayDisplay.from_result(result, "orders", condition=number)
        assert (display.overlay.kind, display.overlay.condition) == ("orders", condition)
    with pytest.raises(ValueError, match="overlays of kind='orders' at 2 conditions, got condition=2"):
        GapOverlayDisplay.from_result(result, "orders", condition=2)
    with pytest.raises(ValueError, match="result has overlays of kind='phase' at 0 conditions"):
        GapOverlayDisplay.from_result(result, "phase")
