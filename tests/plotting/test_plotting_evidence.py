"""Orders by what they belong to, and a recording beside the training windows."""

import copy

import numpy as np
import pytest
from numpy.testing import assert_allclose
from small_model import RATE, SPEED, recording, small_model

from cyclofeat import Recording
from cyclofeat.plotting import LobeMapDisplay, OrderDisplay, TrainingDisplay


@pytest.fixture(scope="module")
def model():
    return small_model()


# -- orders


def test_lines_belong_to_lobes_input_or_mesh():
    one = recording(())
    display = OrderDisplay(one)
    for line, (order, kind) in {
        1: (1 / 15, "other"), 15: (1, "input"), 16: (16 / 15, "lobe"), 32: (32 / 15, "lobe"),
        240: (16, "mesh"), 480: (32, "mesh"), 495: (33, "input"),
    }.items():  # fmt: skip
        assert display.orders[line - 1] == pytest.approx(order)
        assert display.kinds[line - 1] == kind
    assert OrderDisplay(one.replace(n_lobes=11)).kinds[132 - 1] == "mesh"


def test_sines_stand_at_their_orders():
    phase = 2 * np.pi * SPEED * np.arange(3600) / RATE
    torque = 22 + 0.5 * np.cos(16 / 15 * phase) + 0.2 * np.cos(3 * phase) + 0.1 * np.cos(16 * phase)
    display = OrderDisplay.from_recording(Recording(torque, RATE, speed_rpm=500))
    found = dict(zip(display.orders.round(4), display.amplitudes, strict=True))
    assert_allclose([found[1.0667], found[3.0], found[16.0]], [0.5, 0.2, 0.1], atol=1e-3)
    assert np.sort(display.amplitudes)[-4] < 1e-3
    display.plot()
    assert display.ax_.get_yscale() == "log"
    x, y = display.lines_["mesh"].get_data()
    assert_allclose(x[:2], 16)
    assert y[1] == pytest.approx(0.1, abs=1e-3)


def test_the_angle_tells_the_true_speed():
    phase = 2 * np.pi * 1.01 * SPEED * np.arange(3600) / RATE
    one = Recording(22 + np.cos(20 * phase), RATE, speed_rpm=500, angle=phase)
    display = OrderDisplay.from_recording(one)
    assert display.orders[display.amplitudes.argmax()] == pytest.approx(20)


def test_one_nominal_turn_of_a_slower_machine_is_enough():
    phase = 2 * np.pi * 0.99 * SPEED * np.arange(3600) / RATE
    slow = Recording(22 + 0.5 * np.cos(16 / 15 * phase), RATE, speed_rpm=500)
    display = OrderDisplay.from_recording(slow, input_speed_hz=0.99 * SPEED)
    assert display.amplitudes[16 - 1] == pytest.approx(0.5, abs=0.02)
    with pytest.raises(ValueError, match=r"must last one output turn, 1.8 s at 500 RPM, got 1.75 s"):
        OrderDisplay.from_recording(slow.replace(torque=slow.torque[:3500]))


def test_orders_need_a_speed():
    with pytest.raises(ValueError, match="input_speed_hz must be given"):
        OrderDisplay(Recording([1.0, 2.0], RATE))


# -- training windows


def test_means_are_those_of_the_training_windows(model):
    one = recording((4, 5, 6), seed=100)
    display = TrainingDisplay.from_estimator(model, one)
    assert_allclose(display.features, model.counter_.lobe_map_.transform(model.windows(one).X))
    # Healthy discs have no burst: their slots are quieter than those of three worn lobes, which model and
    # pictures must agree on.
    slots = [k for k, name in enumerate(display.names) if name.startswith("lobe_slot_rms")]
    assert display.means[2, slots].max() > 2 * display.means[0, slots].max()
    assert np.abs(display.features[0, slots] - display.means[2, slots]).mean() < 0.1


def test_kinds_of_features_are_drawn_by_their_places(model):
    display = TrainingDisplay.from_estimator(model, recording((4, 5, 6), seed=100))
    assert set(display.kinds) == {
        "lobe_slot_mean", "lobe_slot_rms", "lobe_line_prominence_db", "lobe_line_contrast_db",
    }  # fmt: skip
    display.plot(kind="lobe_slot_rms", counts=(3, 0))
    labels = display.ax_.get_legend_handles_labels()[1]
    assert labels == ["trained: 3 worn (one std)", "trained: 0 worn", "this recording"]
    assert display.ax_.lines[-1].get_ydata().size == 15


@pytest.mark.parametrize("lobe", [0, 6, 14])
@pytest.mark.parametrize("absolute", [True, False])
def test_slots_are_drawn_by_the_lobes_of_the_disc(model, lobe, absolute):
    one = recording((lobe,), seed=100)
    if not absolute:
        one = one.replace(angle=None, angle_is_absolute=False)
    display = TrainingDisplay.from_estimator(model, one)
    columns = [k for k, name in enumerate(display.names) if name.startswith("lobe_slot_rms")]
    loudest = int(display.features[0, columns].argmax())
    on_disc = int(LobeMapDisplay.from_recording(one).slot_rms.argmax())
    assert display.absolute == absolute
    # halves of a burst may fall into neighbouring slots
    assert (display.slot_lobes[loudest] - on_disc + 1) % 15 <= 2
    assert not absolute or display.slot_lobes[loudest] == lobe == on_disc
    assert sorted(display.slot_lobes) == list(range(15))
    display.plot(kind="lobe_slot_rms", counts=(1, 0))
    labels = [label.get_text() for label in display.ax_.get_xticklabels()]
    assert labels == [str(number + 1) for number in display.slot_lobes]
    start = "as numbered on the disc" if absolute else "counted from the first sample"
    assert display.ax_.get_xlabel() == f"lobe, {start}"


def test_kinds_that_tell_counts_apart_come_first(model):
    display = TrainingDisplay(model, recording(()))
    display.names = [f"{kind}(k{k})" for kind in ("dull", "telling") for k in range(3)] + ["alone"]
    display.features, display.means, display.spread = np.zeros((1, 7)), np.zeros((3, 7)), np.ones(7)
    display.means[1, 3:6] = 5
    assert display.kinds == ["telling", "dull"]
    assert display.plot().ax_.get_legend_handles_labels()[1][:2] == [
        "trained: 0 worn (one std)", "trained: 1 worn",
    ]  # fmt: skip


def test_training_refuses(model):
    display = TrainingDisplay.from_estimator(model, recording(()))
    with pytest.raises(ValueError, match="kind must be one of"):
        display.plot(kind="x")
    with pytest.raises(ValueError, match=r"counts must be of \[0, 1, 3\], got 2"):
        display.plot(kind="lobe_slot_rms", counts=(2,))
    without = copy.copy(model)
    without.domain_ = None
    with pytest.raises(ValueError, match="model must have a domain"):
        TrainingDisplay.from_estimator(without, recording(()))
