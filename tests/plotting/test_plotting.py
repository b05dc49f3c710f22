"""Displays: what they compute, what they draw, what they refuse."""

import copy

import matplotlib
import numpy as np
import pytest
import small_model
from matplotlib import pyplot as plt
from matplotlib.colors import to_rgba
from matplotlib.patches import Polygon, Wedge
from numpy.testing import assert_allclose
from small_model import recording as small_recording

from cyclofeat import Recording
from cyclofeat.counting import LobeCount
from cyclofeat.plotting import LobeMapDisplay, OrderDisplay, SpectrumDisplay, TorqueDisplay, TrainingDisplay

RATE = 25_600
SPEED = 500 / 60


def worn_recording(lobes, start_angle=0.0, speed=SPEED, with_angle=True, duration=1.85):
    """Torque that bursts for a tenth of a lobe whenever the cam points to the tip of one of ``lobes``."""
    phi = start_angle + 2 * np.pi * speed * np.arange(round(duration * RATE)) / RATE
    disc = -(phi + np.pi) / 15  # rest position of the wheel
    lobe = (phi - disc) * 15 / (2 * np.pi)  # number of the lobe that the cam points to, with fractions
    torque = 22 + np.random.default_rng(3).normal(0, 0.02, phi.size)
    for number in lobes:
        torque += np.exp(-((((lobe - number + 7.5) % 15 - 7.5) / 0.1) ** 2))
    angle = {"angle": phi, "angle_is_absolute": True} if with_angle else {}
    return Recording(torque, RATE, worn_lobes=lobes, speed_rpm=500, source="simulated", **angle)


@pytest.fixture(scope="module")
def model():
    return small_model.small_model()


@pytest.fixture(scope="module")
def recording():
    return worn_recording((3, 9), start_angle=20.0)


def answer(probability, lobes=(), absolute=True):
    return LobeCount(len(lobes), {}, lobes, tuple(probability), absolute, 1)


def disc(recording, slot_rms, **changes):
    """Draw the disc of a recording with other disturbances."""
    display = LobeMapDisplay(recording.replace(**changes))
    display.slot_rms = slot_rms
    return display.plot()


def numbers_of(display):
    return {text.get_text(): text for text in display.ax_.texts}


def wedges_of(display):
    """Slots and bars of a disc."""
    wedges = [patch for patch in display.ax_.patches if isinstance(patch, Wedge)]
    return wedges[:15], wedges[15:]


def legend_of(display):
    return [text.get_text() for text in display.ax_.get_legend().get_texts()]


# -- all displays


@pytest.mark.parametrize("display_class", [TorqueDisplay, SpectrumDisplay, LobeMapDisplay])
def test_plot_returns_the_display_and_draws_where_it_is_told(display_class, recording):
    display = display_class(recording)
    assert display.plot() is display
    own = display.ax_
    figure, ax = plt.subplots()
    assert display.plot(ax) is display
    assert display.ax_ is ax
    assert own is not ax
    assert display.figure_ is figure
    figure.canvas.draw()


# -- torque


def test_torque_has_units_and_its_own_times(recording):
    display = TorqueDisplay(recording.crop(0.5, 0.75)).plot()
    assert display.time[-1] == pytest.approx(0.25 - 1 / RATE)
    assert_allclose(display.torque, recording.torque[12_800:19_200])
    assert display.ax_.get_xlabel() == "time (s)"
    assert display.ax_.get_ylabel() == "output torque (Nm)"
    current = recording.replace(quantity="motor_current")
    assert TorqueDisplay(current).plot().ax_.get_ylabel() == "motor current (A)"
    assert "(A)" in SpectrumDisplay(current).plot().ax_.get_ylabel()
    assert "(A)" in OrderDisplay(current).plot().ax_.get_ylabel()


def test_thinning_keeps_every_peak():
    torque = np.random.default_rng(0).normal(22, 1, 100_003)
    torque[[777, 100_002]] = 90, -40
    display = TorqueDisplay(Recording(torque, RATE))
    display.max_points = 500
    drawn = display.plot().line_.get_ydata()
    assert 400 < drawn.size <= 500
    assert (drawn.max(), drawn.min()) == (90, -40)
    assert_allclose(drawn, torque[np.round(display.line_.get_xdata() * RATE).astype(int)])
    assert np.all(np.diff(display.line_.get_xdata()) > 0)


def test_short_torque_is_drawn_sample_by_sample():
    assert_allclose(TorqueDisplay(Recording([5, 6, 4], 1)).plot().line_.get_ydata(), [5, 6, 4])


# -- spectrum


def sines(speed_rpm=500):
    time = np.arange(RATE) / RATE
    torque = 22 + 0.5 * np.sin(2 * np.pi * 100 * time) + 0.01 * np.sin(2 * np.pi * 250 * time)
    return Recording(torque, RATE, speed_rpm=speed_rpm)


def test_a_sine_has_its_own_amplitude():
    display = SpectrumDisplay(sines())
    assert_allclose(display.values[[100, 250]], [0.5, 0.01])
    assert_allclose(display.frequencies[[100, 250]], [100, 250])
    assert display.values[0] < 1e-9  # the mean is gone


def test_lobe_lines_and_orders_lie_where_they_belong():
    display = SpectrumDisplay(sines()).plot(max_frequency_hz=200)
    lobe_lines, orders = (
        np.array([segment[0, 0] for segment in marks.get_segments()]) for marks in display.ax_.collections
    )
    assert_allclose(lobe_lines, np.arange(1, 23) * SPEED * 16 / 15)
    assert_allclose(orders, np.arange(1, 25) * SPEED)
    assert display.ax_.get_xlim() == (0, 200)
    assert "order of the input shaft" in display.order_ax_.get_xlabel()
    display.figure_.canvas.draw()
    assert_allclose(display.order_ax_.get_xlim(), (0, 24))
    assert "8.89 Hz (16/15 of input)" in legend_of(display)[0]
    assert "8.33 Hz" in legend_of(display)[1]


def test_the_angle_gives_the_true_speed():
    recording = worn_recording((3,), speed=1.008 * SPEED)
    assert SpectrumDisplay(recording).input_speed_hz == pytest.approx(1.008 * SPEED)
    nominal = recording.replace(angle=None, angle_is_absolute=False)
    assert SpectrumDisplay(nominal).input_speed_hz == pytest.approx(SPEED)
    assert SpectrumDisplay(recording, input_speed_hz=8).input_speed_hz == 8


def test_without_a_speed_there_are_no_marks():
    display = SpectrumDisplay(sines(speed_rpm=None)).plot(max_frequency_hz=1e9)
    assert display.order_ax_ is None
    assert not display.ax_.collections
    assert display.ax_.get_xlim() == (0, RATE / 2)


def test_a_record_without_ripple_is_drawn():
    SpectrumDisplay(Recording([1, 1, 1, 1], 4)).plot().figure_.canvas.draw()


# -- lobe map


@pytest.mark.parametrize("start_angle", [0.0, 3.0, 40.0, 94.0])
@pytest.mark.parametrize("lobe", [0, 6, 14])
def test_slots_of_an_absolute_angle_are_the_lobes_of_the_disc(lobe, start_angle):
    display = LobeMapDisplay(worn_recording((lobe,), start_angle))
    assert display.absolute
    assert display.worn_lobes == (lobe,)
    assert int(display.slot_rms.argmax()) == lobe
    # the burst lies in the middle of its slot
    assert display.slot_rms[lobe] > 5 * np.delete(display.slot_rms, lobe).max()


def test_the_angle_of_the_disc_serves_as_well():
    recording = worn_recording((4,), start_angle=33.0)
    disc = recording.replace(angle=-(recording.angle + np.pi) / 15, angle_of="disc")
    expected = LobeMapDisplay(recording)
    assert_allclose(LobeMapDisplay(disc).slot_rms, expected.slot_rms, rtol=1e-6)


def test_without_an_absolute_angle_slots_count_from_the_start():
    # The cam points to lobe (16 phi + pi) / 24 deg = 0.5 at phi = 0: the burst of lobe 3 lies in slot 2.
    display = LobeMapDisplay(worn_recording((3,), with_angle=False))
    assert not display.absolute
    assert display.worn_lobes is None
    assert int(display.slot_rms.argmax()) == 2
    assert "first sample" in display.plot().ax_.get_title()


def test_skipped_time_changes_nothing_of_absolute_slots():
    recording = worn_recording((3, 9), duration=2.4)
    whole, later = (LobeMapDisplay(recording.crop(skip)) for skip in (0.0, 0.5))
    assert_allclose(later.slot_rms, whole.slot_rms, atol=0.05)


def test_the_disc_has_its_numbered_lobes_and_coloured_slots(recording):
    count = answer(np.linspace(0, 1, 15))
    outline = 0.06 * np.exp(2j * np.pi * np.arange(4000) / 4000)
    display = LobeMapDisplay(recording, count=count, outline=outline).plot()
    numbers = numbers_of(display)
    assert list(numbers) == [str(number) for number in range(1, 16)]
    # the first lobe on top, the others counter-clockwise
    assert numbers["1"].get_position()[0] == pytest.approx(0, abs=1e-12)
    assert numbers["2"].get_position()[0] < 0
    assert [name for name, text in numbers.items() if text.get_fontweight() == "bold"] == ["4", "10"]
    slots, bars = wedges_of(display)
    assert len(bars) == 15
    longest = bars[int(display.slot_rms.argmax())].width
    assert_allclose([bar.width for bar in bars], display.slot_rms / display.slot_rms.max() * longest)
    assert (slots[3].theta1 + slots[3].theta2) / 2 == pytest.approx(90 + 3 * 24)
    light = [sum(slot.get_facecolor()[:3]) for slot in slots]
    assert sorted(light, reverse=True) == light  # as probable as they are dark
    (disc,) = (patch for patch in display.ax_.patches if isinstance(patch, Polygon))
    assert np.hypot(*disc.get_xy().T).max() == pytest.approx(1)
    assert "probability" in display.colorbar_.ax.get_xlabel()
    assert "truly worn" in legend_of(display)[0]
    assert "std of the torque" in legend_of(display)[-1]


def test_no_sound_lobe_is_darker_than_a_worn_one(recording):
    rms = np.full(15, 0.2)
    rms[5] = 0.9  # beside the worn ones, as where the load leaves them
    display = disc(recording, rms, worn_lobes=(1, 2, 3), defect_count=None)
    slots, _ = wedges_of(display)
    assert [slot.get_facecolor() == to_rgba("black") for slot in slots] == [k in (1, 2, 3) for k in range(15)]
    assert display.colorbar_ is None
    slots, _ = wedges_of(disc(recording, rms, worn_lobes=None, defect_count=None))
    assert {slot.get_facecolor()[3] for slot in slots} == {0}  # nothing says which are worn


def test_a_quiet_disc_looks_quiet(recording):
    quiet, loud = (wedges_of(disc(recording, np.full(15, rms)))[1][0] for rms in (0.05, 0.9))
    assert quiet.width / loud.width == pytest.approx(0.05 / 0.3)


def test_an_answer_counted_from_the_first_sample_turns_the_disc(recording):
    display = LobeMapDisplay(recording, count=answer(np.linspace(0, 1, 15), (4,), absolute=False))
    assert (display.absolute, display.worn_lobes, display.counted_lobes) == (False, None, (4,))


def test_a_map_takes_the_colours_of_its_surroundings(recording):
    with matplotlib.rc_context({"text.color": "lime"}):
        display = LobeMapDisplay(recording).plot()
    assert numbers_of(display)["1"].get_color() == "lime"


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda r: SpectrumDisplay(r, input_speed_hz=0), "input_speed_hz"),
        (lambda r: SpectrumDisplay(r).plot(max_frequency_hz=0), "max_frequency_hz"),
        (lambda r: LobeMapDisplay(r.replace(speed_rpm=None)), "input_speed_hz must be given"),
        (lambda r: LobeMapDisplay(r.crop(1.0)), "too short"),
        (lambda r: LobeMapDisplay(r, input_speed_hz=4.0), "input_speed_hz"),
        (lambda r: LobeMapDisplay(Recording([1.0] * 50_000, RATE, speed_rpm=500)), "constant"),
        (lambda r: LobeMapDisplay(r, count=answer(np.ones(14))), "of a disc of 15 lobes, got one of 14"),
        (lambda r: LobeMapDisplay(r, outline=[0, 0, 0]), "outline"),
    ],
)
def test_displays_refuse(call, message, recording):
    with pytest.raises(ValueError, match=message):
        call(recording)


# -- orders


def test_lines_belong_to_lobes_input_or_mesh():
    one = small_recording(())
    display = OrderDisplay(one)
    for line, (order, kind) in {
        1: (1 / 15, "other"), 15: (1, "input"), 16: (16 / 15, "lobe"), 32: (32 / 15, "lobe"),
        240: (16, "mesh"), 480: (32, "mesh"), 495: (33, "input"),
    }.items():  # fmt: skip
        assert display.orders[line - 1] == pytest.approx(order)
        assert display.kinds[line - 1] == kind
    assert OrderDisplay(one.replace(n_lobes=11)).kinds[132 - 1] == "mesh"


def test_sines_stand_at_their_orders():
    phase = 2 * np.pi * SPEED * np.arange(3600) / small_model.RATE
    torque = 22 + 0.5 * np.cos(16 / 15 * phase) + 0.2 * np.cos(3 * phase) + 0.1 * np.cos(16 * phase)
    display = OrderDisplay(Recording(torque, small_model.RATE, speed_rpm=500))
    found = dict(zip(display.orders.round(4), display.amplitudes, strict=True))
    assert_allclose([found[1.0667], found[3.0], found[16.0]], [0.5, 0.2, 0.1], atol=1e-3)
    assert np.sort(display.amplitudes)[-4] < 1e-3
    display.plot()
    assert display.ax_.get_yscale() == "log"
    x, y = display.lines_["mesh"].get_data()
    assert_allclose(x[:2], 16)
    assert y[1] == pytest.approx(0.1, abs=1e-3)


def test_the_angle_tells_the_true_speed():
    phase = 2 * np.pi * 1.01 * SPEED * np.arange(3600) / small_model.RATE
    one = Recording(22 + np.cos(20 * phase), small_model.RATE, speed_rpm=500, angle=phase)
    display = OrderDisplay(one)
    assert display.orders[display.amplitudes.argmax()] == pytest.approx(20)


def test_one_nominal_turn_of_a_slower_machine_is_enough():
    phase = 2 * np.pi * 0.99 * SPEED * np.arange(3600) / small_model.RATE
    slow = Recording(22 + 0.5 * np.cos(16 / 15 * phase), small_model.RATE, speed_rpm=500)
    display = OrderDisplay(slow, input_speed_hz=0.99 * SPEED)
    assert display.amplitudes[16 - 1] == pytest.approx(0.5, abs=0.02)
    with pytest.raises(ValueError, match=r"must last one output turn, 1.8 s at 500 RPM, got 1.75 s"):
        OrderDisplay(slow.replace(torque=slow.torque[:3500]))


def test_orders_need_a_speed():
    with pytest.raises(ValueError, match="input_speed_hz must be given"):
        OrderDisplay(Recording([1.0, 2.0], small_model.RATE))


# -- training windows


def test_means_are_those_of_the_training_windows(model):
    one = small_recording((4, 5, 6), seed=100)
    display = TrainingDisplay(model, one)
    assert_allclose(display.features, model.counter_.lobe_map_.transform(model.windows(one).X))
    # Healthy discs have no burst: their slots are quieter than those of three worn lobes, which model and
    # pictures must agree on.
    slots = [k for k, name in enumerate(display.names) if name.startswith("lobe_slot_rms")]
    assert display.means[2, slots].max() > 2 * display.means[0, slots].max()
    assert np.abs(display.features[0, slots] - display.means[2, slots]).mean() < 0.1


def test_kinds_of_features_are_drawn_by_their_places(model):
    display = TrainingDisplay(model, small_recording((4, 5, 6), seed=100))
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
    one = small_recording((lobe,), seed=100)
    if not absolute:
        one = one.replace(angle=None, angle_is_absolute=False)
    display = TrainingDisplay(model, one)
    columns = [k for k, name in enumerate(display.names) if name.startswith("lobe_slot_rms")]
    loudest = int(display.features[0, columns].argmax())
    on_disc = int(LobeMapDisplay(one).slot_rms.argmax())
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
    display = TrainingDisplay(model, small_recording(()))
    display.names = [f"{kind}(k{k})" for kind in ("dull", "telling") for k in range(3)] + ["alone"]
    display.features, display.means, display.spread = np.zeros((1, 7)), np.zeros((3, 7)), np.ones(7)
    display.means[1, 3:6] = 5
    assert display.kinds == ["telling", "dull"]
    assert display.plot().ax_.get_legend_handles_labels()[1][:2] == [
        "trained: 0 worn (one std)", "trained: 1 worn",
    ]  # fmt: skip


def test_training_refuses(model):
    display = TrainingDisplay(model, small_recording(()))
    with pytest.raises(ValueError, match="kind must be one of"):
        display.plot(kind="x")
    with pytest.raises(ValueError, match=r"counts must be of \[0, 1, 3\], got 2"):
        display.plot(kind="lobe_slot_rms", counts=(2,))
    without = copy.copy(model)
    without.domain_ = None
    with pytest.raises(ValueError, match="model must have a domain"):
        TrainingDisplay(without, small_recording(()))
