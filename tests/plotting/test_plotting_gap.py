"""Displays of a gap: what they draw is what was found, no more and no less."""

from __future__ import annotations

import dataclasses
from itertools import combinations
from types import SimpleNamespace

import matplotlib
import numpy as np
import pytest
from gap_answers import FIRST, SECOND, answered, overlay
from matplotlib import pyplot as plt
from matplotlib.colors import to_rgb
from numpy.testing import assert_allclose

from cyclofeat._base.gap_words import cell_name, difference_words, family_name, row_words
from cyclofeat.gap import Condition
from cyclofeat.gap.proof.prove import ProofRow
from cyclofeat.gap.summaries.summarise import Cell
from cyclofeat.gap.where.locate import Where, WhereRow, where_of
from cyclofeat.plotting import GapDisplay, GapOverlayDisplay, GapReductionDisplay
from cyclofeat.report._figures import theme_settings

SPEED = 500 / 60
KINDS = ("families", "spectrum", "orders", "lobe phase", "input phase")


@pytest.fixture(scope="module")
def where(compared_hum):
    return where_of(compared_hum["hum"])


def row(
    family="spectrum", name="third octave at 400 Hz", difference=-6.0, p=0.01, unit="dB", of="mean", hz=400.0
):
    cell = Cell(family, name, unit, hz * 0.9, hz * 1.1)
    return WhereRow(
        cell=cell, difference=difference, low=difference - 2, high=difference + 2, p=p, detectable=3.0,
        spread=1.0, of=of, mean=0.0, measured_spread=1.0, simulated_spread=1.0,
    )  # fmt: skip


def display_of(*rows, **found):
    return GapDisplay(Where(
        verdict="disagree", rows=rows, n_recordings=6, n_simulated=24, alpha=0.05, margin_db=1.5,
        margin_spreads=0.5, n_permutations=499, random_state=0, one_assembly=False, sampling_rate=6400.0,
        condition=Condition(60 * SPEED, 22.0), **{"family_p": {}} | found,
    ))  # fmt: skip


def flagged_rows(where, *families):
    return [found for found in where.means(*families) if found.p <= where.alpha]


def texts_of(display):
    return [text.get_text() for ax in getattr(display, "axes_", [display.ax_]) for text in ax.texts]


def legend_of(ax):
    return [text.get_text() for text in ax.get_legend().get_texts()] if ax.get_legend() else []


# -- a comparison as it is


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_is_drawn_on_the_axes_given(where, kind):
    figure, ax = plt.subplots()
    display = GapDisplay(where).plot(kind, ax)
    assert display.ax_ is ax
    assert display.figure_ is figure
    assert display.plot(kind) is display
    assert display.ax_ is not ax
    for panel in display.axes_:
        assert panel.lines
        assert panel.get_ylabel() or kind == "families"
    figure.canvas.draw()


@pytest.mark.slow
def test_the_hum_is_flagged_and_as_many_marks_are_drawn_as_rows_are_flagged(where):
    lines = flagged_rows(where, "lobe lines", "shaft lines")
    assert any(found.cell.name == "input order 6" for found in lines)
    assert len(GapDisplay(where).plot("orders").flags_) == len(lines)
    bands = flagged_rows(where, "spectrum")
    assert bands
    display = GapDisplay(where).plot("spectrum")
    assert len(display.flags_) == len(bands)
    assert_allclose(
        [flag.get_extents().transformed(display.axes_[0].transData.inverted()).x0 for flag in display.flags_],
        [found.cell.low_hz for found in bands],
    )
    overview = GapDisplay(where).plot("families")
    families = {row.cell.family for row in where.rows}
    assert len(overview.flags_) == sum(where.family_p[name] <= where.alpha for name in families)
    phases = GapDisplay(where).plot("input phase")
    assert len(phases.flags_) == int(where.phase["input"].flagged.sum())


@pytest.mark.slow
def test_levels_and_spreads_are_those_of_the_recordings(compared_hum, where):
    """Against means and standard deviations taken count by count from the summaries."""
    located, display = compared_hum["hum"], GapDisplay(where)
    band = next(found for found in where.means() if found.cell.name == "third octave at 50.1 Hz")
    column = next(c for c, cell in enumerate(located.cells) if cell.name == "third octave at 50.1 Hz")
    values, counts = located.simulated[:, column], located.bank.counts
    left = np.concatenate([values[counts == c] - values[counts == c].mean() for c in (0, 3)])
    assert band.simulated_spread == pytest.approx(left.std(ddof=1))
    assert band.mean == pytest.approx(located.measured.values[:, column].mean())
    simulated = np.mean([values[counts == c].mean() for c in (0, 3)])
    dashed = next(line for line in display.plot("spectrum").axes_[0].lines if line.get_linestyle() == "--")
    drawn = dict(zip(np.round(dashed.get_xdata(), 1), dashed.get_ydata(), strict=True))
    # The model at the recordings' own speed and load, within the prior's reach of the model's mean.
    assert drawn[50.1] == pytest.approx(band.mean - band.difference)
    assert drawn[50.1] == pytest.approx(simulated, abs=0.5)


def test_names_and_words_of_the_clearest_are_in_the_pictures(where):
    for kind, name in (
        ("orders", "input order 6: "),
        ("spectrum", "50.1 Hz: "),
        ("families", "input order 6: "),
    ):
        texts = texts_of(GapDisplay(where).plot(kind))
        assert any(text.startswith(name) for text in texts)
    assert {"lines of the input shaft", *(family_name(row.cell.family) for row in where.rows)} <= {*texts}


@pytest.mark.slow
def test_surrogates_are_called_so(where):
    for kind in KINDS:
        panels = GapDisplay(where, label="surrogate").plot(kind).axes_
        said = str([(legend_of(ax), ax.get_xlabel(), ax.get_ylabel()) for ax in panels])
        assert "surrogate" in said
        assert "measured" not in said


# -- made-up tables


def test_differences_have_their_intervals_at_their_orders():
    sound = row("lobe lines", "lobe line 1 (order 1.07)", 1.0, 0.5, hz=SPEED * 16 / 15)
    other = row("shaft lines", "input order 6", 20.0, 0.001, hz=SPEED * 6)
    display = display_of(sound, other).plot("orders")
    dots = [line for line in display.ax_.lines if line.get_marker() in ("o", "s")]
    assert_allclose([dot.get_xydata()[0] for dot in dots], [(16 / 15, 1.0), (6, 20.0)])
    assert [dot.get_markerfacecolor() for dot in dots] == ["none", "C1"]
    ranges = sorted(tuple(c.get_segments()[0][:, 1]) for c in display.ax_.collections)
    assert ranges == [(-1.0, 3.0), (18.0, 22.0)]
    assert texts_of(display) == ["input order 6: 20 dB more"]


def test_neighbouring_bands_of_one_sign_are_told_once():
    hz = 100 * 10 ** (np.arange(8) / 10)
    effects = [0.0, -3.0, -9.0, -4.0, 0.0, 5.0, 0.0, 0.0]
    rows = [
        row(name=f"third octave at {f:.3g} Hz", difference=e, p=0.01 if e else 1.0, hz=f)
        for f, e in zip(hz, effects, strict=True)
    ]
    display = display_of(*rows).plot("spectrum")
    assert len(display.flags_) == 4
    assert sorted(texts_of(display)) == ["158 Hz: 9.0 dB less", "316 Hz: 5.0 dB more"]


def test_other_spreads_are_marked_but_not_as_other_means():
    rows = [row(p=1.0), row(p=0.01, of="spread", difference=6.0206)]
    display = display_of(*rows, family_p={"spectrum": 0.01}).plot("spectrum")
    assert (len(display.flags_), len(display.spread_flags_)) == (0, 1)
    assert display.spread_flags_[0].get_xdata()[0] == pytest.approx(np.sqrt(360 * 440))
    words = "varies 2.0 times as much from one recording to the next"
    assert any(text.endswith(words) for text in texts_of(display.plot("families")))


def test_families_are_placed_by_spreads_of_one_recording():
    rows = [row(difference=-6.0), row("floor", "around order 2", 0.5, 0.9)]
    display = display_of(*rows, family_p={"spectrum": 0.01, "floor": 0.9}).plot("families")
    dots = [line for line in display.ax_.lines if line.get_marker() == "o"]
    assert_allclose([dot.get_xdata()[0] for dot in dots], [6.0, 0.5])
    assert display.flags_ == dots[:1]
    ticks = [line.get_xdata()[0] for line in display.ax_.lines if line.get_marker() == "|"]
    assert_allclose(ticks, 3.0)  # the least that would most likely be found


def test_phase_has_means_spreads_and_the_difference():
    phase, bump = (np.arange(40) + 0.5) / 40, np.isin(np.arange(40), range(10, 15))
    simulated = np.sin(2 * np.pi * phase)
    measured, spread = simulated + 0.4 * bump, np.full(40, 0.1)
    fold = SimpleNamespace(
        name="lobe", phase=phase, measured=measured, simulated=simulated, measured_spread=spread,
        simulated_spread=2 * spread, flagged=bump,
    )  # fmt: skip
    display = display_of(row(), phase={"lobe": fold}).plot("lobe phase")
    upper, lower = display.axes_
    assert_allclose([line.get_ydata() for line in upper.lines], [simulated, measured])
    difference = next(line.get_ydata() for line in lower.lines if len(line.get_xdata()) == 40)
    assert_allclose(difference, 0.4 * bump, atol=1e-12)
    assert len(display.flags_) == 5
    band = upper.collections[1].get_paths()[0].vertices[:, 1]
    assert band.max() == pytest.approx(np.max(measured + 0.1))
    assert "Nm" in upper.get_ylabel()
    assert display.kinds == ["families", "spectrum", "lobe phase"]


# -- reduction

COMPARISON = [
    ProofRow(name, condition, grr, grr - 0.1, grr + 0.05)
    for name, condition, grr in (
        ("after", "all", 0.9), ("after", "unseen", 0.8), ("oracle", "all", 0.7),
        ("oracle", "unseen", -3.0), ("nothing", "all", np.nan),
    )
]  # fmt: skip


def test_reduction_draws_every_finite_ratio_and_says_those_beyond_its_edge():
    display = GapReductionDisplay(COMPARISON).plot()
    assert len(display.drawn_) == 4
    assert ("oracle", "unseen", pytest.approx(-300)) in display.drawn_
    assert texts_of(display) == ["-300 %"]
    labels = [label.get_text() for label in display.ax_.get_yticklabels()]
    assert labels == ["named effects added", "the true simulator"]
    assert legend_of(display.ax_) == ["all recordings held out", "counts never seen in the fit"]
    dots = [line.get_xdata()[0] for line in display.ax_.lines if line.get_marker() != "None"]
    assert sorted(dots) == pytest.approx([-100.0, 70.0, 80.0, 90.0])


def test_a_result_is_drawn_at_the_condition(compared_hum):
    result = answered(compared_hum["hum"])
    for kind in ("spectrum", "orders", "distribution", "differences", "closed"):
        assert result.plot(kind, condition=1).ax_.has_data()
    assert result.plot("differences", condition=1).where is result.where[1]
    assert result.plot("closed", condition=1).drawn_ == [("after", "all", 97.0)]
    for number, condition in enumerate((FIRST, SECOND)):
        drawn = result.plot("orders", condition=number).overlay
        assert (drawn.kind, drawn.condition) == ("orders", condition)
    with pytest.raises(ValueError, match="overlays of kind='orders' at 2 conditions, got condition=2"):
        result.plot("orders", condition=2)
    with pytest.raises(ValueError, match="result has proof at 0 conditions"):
        dataclasses.replace(result, proof=()).plot("closed")
    with pytest.raises(ValueError, match="result has a comparison at 1 condition, got condition=1"):
        dataclasses.replace(result, where=result.where[:1]).plot("differences", condition=1)


# -- overlays


@pytest.mark.parametrize("kind", ["spectrum", "orders", "distribution"])
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
    assert legend_of(ax) == list(lines)
    assert ax.get_yscale() == "log"
    without = GapOverlayDisplay(dataclasses.replace(shown, corrected=None)).plot()
    assert [line.get_label() for line in without.ax_.get_lines()] == ["model", "recordings"]


# -- words


@pytest.mark.parametrize(
    ("found", "words"),
    [
        (row(), "third octave at 400 Hz: 6.0 dB less"),
        (row(name="third octave at 1.26e+03 Hz", difference=12.3), "third octave at 1260 Hz: 12 dB more"),
        (row("amplitudes", "mean", 0.514, unit="Nm"), "mean torque: 0.51 Nm more"),
        (row("amplitudes", "skewness", -0.25, unit="1"), "skewness: 0.25 lower"),
        (
            row("amplitudes", "mean", -6.0206, unit="Nm", of="spread"),
            "mean torque: varies 0.5 times as much from one recording to the next",
        ),
    ],
)
def test_words(found, words):
    assert row_words(found) == words
    assert words.endswith(difference_words(found))
    assert cell_name(found.cell) in words
    assert dataclasses.replace(found, difference=6.0).clarity == 2.0


# -- colours


XYZ = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])


def linear_rgb(colour):
    srgb = np.array(to_rgb(colour))
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)


def lab(linear):
    """CIE L*a*b* of a linear RGB colour, white point D65."""
    scaled = XYZ @ linear / np.array([0.9505, 1.0, 1.089])
    f = np.where(scaled > 0.008856, np.cbrt(scaled), 7.787 * scaled + 16 / 116)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


# Machado, Oliveira and Fernandes 2009, severity 1.0, on linear RGB.
DEUTERANOPIA = np.array(
    [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]]
)


def roles_of_a_comparison():
    display = display_of(row(), row(difference=3.0, p=0.9, hz=500.0)).plot("spectrum")
    curves = [line.get_color() for line in display.axes_[0].lines if line.get_label()[0] != "_"]
    return [*curves, display.flags_[0].get_facecolor()]


def roles_of_an_overlay():
    return [line.get_color() for line in GapOverlayDisplay(overlay()).plot().ax_.get_lines()]


@pytest.mark.parametrize("roles_of", [roles_of_a_comparison, roles_of_an_overlay])
def test_roles_are_told_apart_also_by_the_colour_blind(roles_of):
    with matplotlib.rc_context(theme_settings()):
        roles = [linear_rgb(colour) for colour in roles_of()]
    assert len(roles) == 3
    for rgb in roles:  # against white
        assert 1.05 / (XYZ[1] @ rgb + 0.05) > 2.5
    for seen in (np.eye(3), DEUTERANOPIA):
        points = [lab(np.clip(seen @ rgb, 0, 1)) for rgb in roles]
        assert min(np.linalg.norm(first - second) for first, second in combinations(points, 2)) > 25


# -- refusals


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: display_of(row()).plot("orders"), "compared: 'families', 'spectrum', got 'orders'"),
        (lambda: display_of().plot("families"), "compared: nothing"),
        (lambda: GapReductionDisplay([]).plot(), "finite grr"),
        (lambda: GapReductionDisplay(COMPARISON[-1:]).plot(), "finite grr"),
    ],
)
def test_displays_refuse(call, message):
    with pytest.raises(ValueError, match=message):
        call()
