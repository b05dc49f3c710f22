"""Spoiling of recordings in the benchmark: strengths follow the quantity, outcomes mean what they say."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from benchmarks.spoiled import _run
from benchmarks.spoiled._kind import KINDS, LOAD_NM, Base, noisy
from cyclofeat import Recording
from cyclofeat.simulators import Rig

pytestmark = pytest.mark.slow  # a benchmark is no part of the package

RATE, SPEED_RPM, TURNS = 12_800.0, 580.0, 30
MEANS = {"output_torque": 22.0, "input_torque": 1.5, "motor_current": 13.0}


def base_of(quantity):
    """A wave of lobes about the quantity's mean; the same of each quantity, but for this scale."""
    angle = np.arange(round(TURNS * 60 / SPEED_RPM * RATE)) / RATE * 2 * np.pi * SPEED_RPM / 60
    angle += 0.01 * np.sin(angle)

    def recording(quantity, phase):
        torque = MEANS[quantity] * (1 + 0.1 * np.sin(16 * angle / 15 + phase))
        return Recording(
            torque, RATE, angle=angle, angle_is_absolute=True, speed_rpm=SPEED_RPM, quantity=quantity,
            defect_count=3,
        )  # fmt: skip

    silent, other = recording(quantity, 0.0), recording(quantity, 1.0)
    random = np.random.default_rng(0)
    mistaken = recording(_run.MISTAKEN[quantity], 0.0)
    return Base(silent, noisy(silent, random), noisy(other, random), mistaken)


@pytest.mark.parametrize("quantity", ["input_torque", "motor_current"])
@pytest.mark.parametrize("kind", KINDS.values(), ids=lambda kind: kind.name)
def test_strengths_are_the_same_share_of_the_mean_in_each_quantity(kind, quantity):
    for strength in kind.strengths:
        ours, output = (
            kind.spoil(base_of(one), strength, np.random.default_rng(1))
            for one in (quantity, "output_torque")
        )
        assert ours.quantity == quantity
        scale = MEANS[quantity] / MEANS["output_torque"]
        assert_allclose(ours.torque, scale * output.torque, rtol=1e-9, atol=1e-9 * MEANS[quantity])


@pytest.mark.parametrize("quantity", MEANS)
def test_a_strength_in_nm_is_that_share_of_the_load(quantity):
    base = base_of(quantity)
    drifted = KINDS["drift"].spoil(base, 11.0, np.random.default_rng(0))
    drift = drifted.torque - base.recording.torque
    assert_allclose([drift[0], drift[-1]], [0, 11 / LOAD_NM * MEANS[quantity]], rtol=1e-3, atol=1e-9)
    noise = base.recording.torque - base.silent.torque
    assert_allclose(noise.std(), 0.2 / LOAD_NM * MEANS[quantity], rtol=0.02)


def test_only_a_current_has_a_motor_and_none_has_noise_of_its_own():
    rigs = {quantity: _run._silent_rig(SPEED_RPM, quantity) for quantity in MEANS}
    assert {quantity: rig.has_motor for quantity, rig in rigs.items()} == {
        "output_torque": False, "input_torque": False, "motor_current": True,
    }  # fmt: skip
    for rig in rigs.values():
        assert isinstance(rig, Rig)
        assert not {"noise", "current_sensor"} & {effect.effect_id for effect in rig.effects}


def test_a_wrong_answer_is_sure_above_nine_tenths_and_any_answer_is_wrong_without_a_truth():
    class Answers:
        def __init__(self, count, probability, refused=False):
            self.defect_count, self.probability, self.refused = count, {count: probability}, refused

        def count(self, recording):
            return self

    assert _run.outcome(Answers(3, 0.95), None, 3) == [_run.RIGHT]
    assert _run.outcome(Answers(3, 0.95), None, 2) == [_run.WRONG, _run.SURE]
    assert _run.outcome(Answers(3, 0.9), None, None) == [_run.WRONG]
    assert _run.outcome(Answers(3, 0.95, refused=True), None, 2) == [_run.REFUSED]
