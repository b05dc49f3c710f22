"""Text of ``cyclofeat gap``: the answer first, each thing once."""

from __future__ import annotations

import dataclasses
import math

import pytest
from gap_answers import REMAINDER, answered, compared, proof_of

from cyclofeat.cli.gap import gap_lines
from cyclofeat.gap.result import FoundEffect
from cyclofeat.simulators import Gain


@pytest.fixture(scope="module")
def result(compared_hum):
    return answered(compared_hum["hum"])


def test_all_is_told_in_order(result):
    assert gap_lines(result) == [
        f"model and measurement disagree (p = {result.p:.2g}, adjusted over all comparisons)",
        "missing: hum (100%): Mains hum in the torque signal",
        "  amplitude_nm = 1.99 (1.91 to 2.06) Nm",
        "missing: pin_errors (96%): Position errors of the pins",
        "  rms = 1.2e-05 (2e-06 to 5e-05) m",
        "probably missing: gain (61%), or offset (36%): Gain of the torque meter",
        "  factor = 1.05 (1.01 to 1.09)",
        "open: clearance (30%)",
        "open, but too small to be seen; would be seen with: run_out (12%, runout above 2.5e-05 m)",
        "left unexplained: nothing (p = 0.31)",
        "measure next: a record at 44 Nm, to tell apart gain, offset",
        "held out at 500 RPM, 22 Nm: 91% of the gap closed (86% to 95%)",
        "held out at 400 RPM, 12 Nm, reverse: 97% of the gap closed (92% to 101%)",
        "note: No tachometer.",
        "note: No tachometer.",
        "note: One record was clipped.",
    ]


def test_what_is_left_and_what_is_not_known(result):
    undefined = proof_of(compared(after=(math.nan,)), None)
    lines = gap_lines(dataclasses.replace(result, remainder=REMAINDER, proof=(undefined,), warnings=()))
    assert lines[9:] == [
        "left unexplained (p < 0.001):",
        "  third octave at 631 Hz: 2.3 dB more",
        "  values that repeat, end or stand still: share of the largest value: 0.4 lower",
        "something is missing that no effect considered explains: sizes are not confirmed by simulation",
        "measure next: a record at 44 Nm, to tell apart gain, offset",
        "held out: too little disagreement to state how far it shrank",
    ]


def test_look_alikes_that_are_probable_only_together_are_told_once(result):
    three = {"gain": 0.21, "offset": 0.21, "load_scale": 0.11}
    effects = [
        FoundEffect(name, p, "unresolved", (), tuple(other for other in three if other != name))
        for name, p in three.items()
    ]
    lines = gap_lines(dataclasses.replace(result, effects=tuple(effects), named=(Gain(1.05),)))
    assert lines[1:3] == [
        "probably missing: gain (21%), or offset (21%), load_scale (11%): Gain of the torque meter",
        "left unexplained: nothing (p = 0.31)",
    ]


def test_what_is_left_may_be_open_effects(result):
    perhaps = dataclasses.replace(REMAINDER, unexplained=False, p_open=0.2)
    lines = gap_lines(dataclasses.replace(result, remainder=perhaps))
    assert (
        "left unexplained: differences that open effects may explain (p = 0.2; without them p < 0.001); "
        "sizes are not confirmed by simulation"
    ) in lines
