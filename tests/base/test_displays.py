"""Cards of objects in notebooks: well-formed, escaped, with the numbers of the data."""

from __future__ import annotations

import copy
import re

import numpy as np
import pytest
from pages import parse, words
from small_model import small_model

from cyclofeat import Recording
from cyclofeat._base import displays
from cyclofeat._base.displays import Card
from cyclofeat.counting import LobeCount, evaluate
from cyclofeat.simulators import Hum, Rig

HOSTILE = '"><script>alert(1)</script>'
ANSWER = LobeCount(2, {0: 0.125, 2: 0.875}, (3, 4), (0.0, 0.1, 0.0, 0.75, 1.0), False, 3, (HOSTILE,))


def described_model():
    model = copy.copy(small_model())
    model.card_ = model.card_ | {"description": HOSTILE}
    return model


def evaluation():
    from sklearn.dummy import DummyClassifier

    y = np.repeat(np.arange(20) % 2, 2)
    return evaluate(DummyClassifier(), np.arange(80.0).reshape(40, 2), y, np.repeat(np.arange(20), 2))


CARDS = {
    "recording": (
        Recording([1.0, 3.0, 2.0, 2.0], 2.0, run=HOSTILE, worn_lobes=(0, 4), speed_rpm=500),
        ["2 s: 4 samples at 2 Hz", "1 to 3 Nm, mean 2 Nm", "500 RPM", "2: 1, 5, counted from 1", HOSTILE],
    ),
    "count": (ANSWER, ["2 worn lobes", "0.88", "4, 5 (numbered from 1, the lobe under load", "3 windows"]),
    "refused": (
        LobeCount(0, {0: 1.0}, (), (), False, 1, refused=True, reason="no lobe lines", distance=2.0),
        ["Refused, not reliable: No worn lobe", "no lobe lines", "2.00 (1: edge of the training)"],
    ),
    "model": (
        described_model(),
        ["of output torque at 500 RPM", HOSTILE, "0, 1, 3", "none: accuracy unknown", "not calibrated"],
    ),
    "evaluation": (evaluation(), ["Accuracy 0.500", "20 assemblies, 40 windows (stratified)"]),
    "rig": (
        Rig(effects=[Hum((0.1, 0.4))], variants=[[Hum(0.2)], []], name="<b>"),
        ["Rig <b>", "15 lobes, 16 pins on a circle of 64 mm", "amplitude_nm 0.1 to 0.4 Nm", "2 sets"],
    ),
}


@pytest.mark.parametrize("name", CARDS)
def test_cards_are_whole_escaped_and_state_the_numbers(name):
    drawn, parts = CARDS[name]
    parsed = parse(drawn._repr_html_())
    for part in parts:
        assert part in words(parsed), part
    assert not {"script", "b", "style"} & set(parsed.tags)
    assert len(repr(drawn)) < 800
    lines = str(drawn).splitlines()
    assert 1 <= len(lines) <= 12
    assert max(map(len, lines)) <= 160


def test_every_argument_but_the_pictures_is_escaped():
    made = Card(HOSTILE, {HOSTILE: HOSTILE}, notes=[HOSTILE], code=HOSTILE).to_html()
    assert "<script" not in made
    assert words(parse(made)).count(HOSTILE) == 5
    assert "<td" not in Card("", {"empty": "", "none": None}).to_html()


def test_pictures_escape_their_names():
    for drawn in (
        displays.draw_columns([0.5], [HOSTILE], HOSTILE),
        displays.draw_confusion(np.eye(1), [HOSTILE]),
    ):
        assert "script" not in parse(drawn).tags


def test_a_curve_fills_the_picture_and_keeps_its_peaks():
    values = np.zeros(100_000)
    values[31_234] = 5.0
    drawn = displays.draw_curves([displays.Curve(values)], "peak")
    points = np.array(re.findall(r"([\d.]+),([\d.]+)", drawn), dtype=float)
    assert len(points) <= 500
    assert points[:, 1].min() == 2
    assert points[points[:, 1].argmin(), 0] == pytest.approx(0.31234 * 258 + 1, abs=2)
    assert displays.draw_curves([displays.Curve(np.ones(3))], "constant").count(",94.0") == 3


def test_the_disc_is_as_dark_as_its_shares_and_marks_the_counted_lobes():
    drawn = displays.draw_disc([0.0, 0.25, 1.0], {2}, "")
    assert sorted(re.findall(r'fill-opacity="([\d.]+)"', drawn)) == ["0.00", "0.25", "1.00"]
    assert re.findall(r"<title>([^<]*)</title>", drawn) == ["lobe 2: 0.25", "lobe 1: 0", "lobe 3: 1"]
    assert 'font-weight="bold" text-anchor="middle" fill="currentColor">3<' in drawn
