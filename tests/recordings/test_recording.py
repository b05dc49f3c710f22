"""Recordings are checked when made, windows hold whole output turns, angle resampling keeps orders."""

from __future__ import annotations

import copy
import pickle
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from memory import peak_bytes

from cyclofeat.recordings import Recording, Windower
from cyclofeat.recordings.recording import common_quantity
from cyclofeat.recordings.windower import lobe_windower
from cyclofeat.signal.orders import resample_by_angle

RATE = 25_600.0
TURN = 2 * np.pi
STEADY = settings(derandomize=True, deadline=None, max_examples=15)


def noise(n_samples, seed=0):
    return 22 + np.random.default_rng(seed).normal(size=n_samples)


def record(seconds=2.0, **labels):
    defaults = {"assembly": "A", "defect_count": 0, "speed_rpm": 500}
    return Recording(noise(round(seconds * RATE)), RATE, **{**defaults, **labels})


def steady_angle(seconds, start=0.0, speed=500 / 60, rate=RATE):
    return start + TURN * speed * np.arange(round(seconds * rate)) / rate


# -- Recording


def test_what_was_checked_cannot_change_afterwards():
    mine = noise(100)
    recording = Recording(mine, RATE)
    mine[0] = np.nan
    assert np.isfinite(recording.torque[0])
    with pytest.raises(ValueError, match="read-only"):
        recording.torque[0] = np.nan
    with pytest.raises(AttributeError):
        recording.sampling_rate = 1.0


def test_numbers_of_numpy_become_plain_ones():
    # else labels could not be written as JSON
    recording = Recording(
        [1, 2], np.float32(10), assembly=np.int64(3), defect_count=np.int8(2), worn_lobes=np.array([4, 0])
    )
    assert type(recording.sampling_rate) is float
    assert type(recording.assembly) is int
    assert recording.worn_lobes == (0, 4)
    assert all(type(lobe) is int for lobe in recording.worn_lobes)
    assert recording.torque.dtype == np.float64


def test_defect_count_follows_from_the_lobes():
    assert record(defect_count=None, worn_lobes=(0, 4)).defect_count == 2
    assert record(defect_count=None, worn_lobes=()).defect_count == 0
    assert record(defect_count=3).worn_lobes is None
    assert record(defect_count=0).worn_lobes == ()
    assert Recording([1, 2], RATE).defect_count is None
    assert Recording([1, 2], 1, worn_lobes=(3, 15), n_lobes=16).defect_count == 2


@pytest.mark.parametrize(
    ("change", "kind", "words"),
    [
        ({"torque": np.zeros((2, 3))}, ValueError, ["torque", "1-D", "(2, 3)"]),
        ({"torque": [1.0]}, ValueError, ["torque", "at least 2 samples", "got 1"]),
        ({"torque": [1.0, np.nan, 2.0]}, ValueError, ["torque", "finite", "nan", "sample 1"]),
        ({"torque": [1j, 2.0]}, TypeError, ["torque", "real", "complex128"]),
        ({"torque": [True, False]}, TypeError, ["torque", "real", "bool"]),
        ({"sampling_rate": 0}, ValueError, ["sampling_rate", "positive", "got 0"]),
        ({"sampling_rate": "25600"}, TypeError, ["sampling_rate", "number", "'25600'"]),
        ({"angle": [0.0, 1.0]}, ValueError, ["angle", "torque's length", "got 2 for 3"]),
        ({"angle": [0.0, 1.0, 1.0]}, ValueError, ["angle", "rise strictly", "sample 1", "unwrap"]),
        ({"angle": [0.0, 2.0, 1.0], "angle_of": "disc"}, ValueError, ["angle", "rise strictly", "sample 1"]),
        ({"angle": [2.0, 0.0, 1.0], "angle_of": "disc"}, ValueError, ["angle", "fall strictly", "sample 1"]),
        ({"angle": [0.0, np.nan, 1.0]}, ValueError, ["angle", "finite", "sample 1"]),
        ({"angle_of": "output"}, ValueError, ["angle_of", "'input' or 'disc'", "'output'"]),
        ({"angle_is_absolute": True}, ValueError, ["angle_is_absolute", "no angle"]),
        ({"angle_is_absolute": 1}, TypeError, ["angle_is_absolute", "True or False", "1"]),
        ({"assembly": 1.5}, TypeError, ["assembly", "text or a whole number", "1.5"]),
        ({"assembly": "A\n1"}, ValueError, ["assembly", "printable"]),
        ({"assembly": 2**63}, ValueError, ["assembly", "64 bits"]),
        ({"run": False}, TypeError, ["run", "text or a whole number"]),
        ({"source": 3}, TypeError, ["source", "text", "3"]),
        ({"defect_count": -1}, ValueError, ["defect_count", "at least 0", "-1"]),
        ({"worn_lobes": (0, 0)}, ValueError, ["worn_lobes", "distinct", "(0, 0)"]),
        ({"worn_lobes": (-1,)}, ValueError, ["worn_lobes", "at least 0", "-1"]),
        ({"worn_lobes": 3}, TypeError, ["worn_lobes", "sequence", "3"]),
        ({"worn_lobes": (3, 15)}, ValueError, ["worn_lobes must lie between 0 and 14", "got (3, 15)"]),
        ({"defect_count": 14, "n_lobes": 13}, ValueError, ["defect_count", "at most n_lobes = 13, got 14"]),
        ({"worn_lobes": "04"}, TypeError, ["worn_lobes", "sequence", "'04'"]),
        ({"worn_lobes": (0, 1), "defect_count": 3}, ValueError, ["defect_count", "got 3 and 2 lobes (0, 1)"]),
        ({"speed_rpm": -500}, ValueError, ["speed_rpm", "positive", "-500"]),
        ({"load_nm": np.nan}, ValueError, ["load_nm", "finite", "nan"]),
        ({"quantity": "torque"}, ValueError, ["quantity must be one of 'output_torque', ", "got 'torque'"]),
        ({"meta": [1]}, TypeError, ["meta", "mapping", "[1]"]),
        ({"meta": {1: 2}}, TypeError, ["meta", "text as keys", "1"]),
    ],
)
def test_each_bad_value_gives_its_one_error(change, kind, words):
    with pytest.raises(kind) as caught:
        Recording(**{"torque": [1.0, 2.0, 3.0], "sampling_rate": RATE, **change})
    message = str(caught.value)
    assert "\n" not in message
    for word in words:
        assert word in message


def test_an_angle_must_not_contradict_the_nominal_speed():
    degrees = np.rad2deg(steady_angle(0.1))
    for angle_of, wrong in (("input", degrees), ("disc", steady_angle(0.1)), ("disc", degrees / 15)):
        with pytest.raises(ValueError, match=r"angle must agree with speed_rpm.*in rad"):
            record(0.1, angle=wrong, angle_of=angle_of)
    time = np.arange(2_560) / RATE
    record(0.1, angle=130 * time**2 + 1e-9 * time)  # a start from rest


def test_equality_compares_samples_and_labels():
    recording = record(meta={"rig": 1}, angle=steady_angle(2.0))
    assert recording == record(meta={"rig": 1}, angle=steady_angle(2.0))
    assert len(repr(recording)) < 300
    changes = {
        "torque": noise(51_200, seed=1), "angle": None, "run": "r", "meta": {"rig": 2}, "assembly": 3,
        "quantity": "input_torque",
    }  # fmt: skip
    for change in ({name: value} for name, value in changes.items()):
        assert recording != recording.replace(**change)
    assert recording != "recording"
    assert record(assembly=1) != record(assembly="1")


def test_recordings_travel_between_processes_and_stay_read_only():
    meta = {"gains": np.ones(3), "by": "hand"}
    one = record(angle=steady_angle(2.0), angle_is_absolute=True, worn_lobes=(1,), defect_count=1, meta=meta)
    for other in (copy.copy(one), copy.deepcopy(one), pickle.loads(pickle.dumps(one))):
        assert other == one
        assert other != one.replace(meta={"gains": np.zeros(3), "by": "hand"})
    for values in (other.torque, other.angle):
        with pytest.raises(ValueError, match="read-only"):
            values[0] = 0


def run_of(worn=(), removed=(), n=2_560):
    defects = SimpleNamespace(worn_lobes=worn, removed_lobes=removed, defect_count=len(worn) + len(removed))
    gearbox = SimpleNamespace(input_speed=500 * TURN / 60, load_torque=22.0)
    return SimpleNamespace(
        torque_out=noise(n), sampling_rate=RATE, input_angle=steady_angle(n / RATE), defects=defects,
        gearbox=gearbox,
    )  # fmt: skip


def test_a_run_brings_its_labels():
    recording = Recording.from_run(run_of((0, 4)), assembly="A1", run="r1")
    expected = {
        "worn_lobes": (0, 4), "defect_count": 2, "speed_rpm": 500, "load_nm": 22, "source": "simulated",
        "assembly": "A1", "run": "r1", "angle_is_absolute": True, "angle_of": "input",
    }  # fmt: skip
    assert {name: getattr(recording, name) for name in expected} == expected
    np.testing.assert_array_equal(recording.angle, run_of().input_angle)
    bare = Recording.from_run(run_of((1,)), with_angle=False)  # without a tachometer
    assert (bare.angle, bare.angle_is_absolute) == (None, False)


def test_labels_that_are_given_replace_those_of_the_run():
    run = run_of((0, 4))
    assert Recording.from_run(run, source="surrogate").source == "surrogate"
    assert Recording.from_run(run, speed_rpm=505).speed_rpm == 505
    assert Recording.from_run(run, worn_lobes=(1, 2, 3)).defect_count == 3
    assert Recording.from_run(run, defect_count=5).worn_lobes is None
    assert not Recording.from_run(run, angle_is_absolute=False).angle_is_absolute
    with pytest.raises(TypeError, match="colour"):
        Recording.from_run(run, colour="red")


def test_removed_lobes_count_but_are_not_called_worn():
    recording = Recording.from_run(run_of((1,), removed=(5, 6)), meta={"rig": "R0"})
    assert recording.defect_count == 3
    assert recording.worn_lobes is None
    assert recording.meta == {"rig": "R0", "worn_lobes_from_1": [2], "removed_lobes_from_1": [6, 7]}


def test_each_quantity_of_a_run_is_recorded_with_its_unit():
    run = run_of((1,))
    run.torque_in, run.motor_current = run.torque_out / 15, run.torque_out / 2
    for quantity, factor, unit in (
        ("output_torque", 1, "Nm"), ("input_torque", 1 / 15, "Nm"), ("motor_current", 1 / 2, "A"),
    ):  # fmt: skip
        recording = Recording.from_run(run, quantity=quantity)
        assert (recording.quantity, recording.unit) == (quantity, unit)
        np.testing.assert_allclose(recording.torque, run.torque_out * factor)
        page = recording._repr_html_()
        assert f"Recording of {quantity.replace('_', ' ')}" in page
        assert f"mean {recording.torque.mean():.4g} {unit}" in page
    assert recording.replace(meta={"unit": "Nm"}).unit == "Nm"  # scaled by a torque constant


def test_a_quantity_that_the_run_does_not_hold_is_an_error():
    with pytest.raises(ValueError, match="one that the run holds, got 'input_torque', but torque_in is None"):
        Recording.from_run(run_of(), quantity="input_torque")
    with pytest.raises(ValueError, match="quantity must be one of 'output_torque', .* got 'speed'"):
        Recording.from_run(run_of(), quantity="speed")


def test_recordings_of_two_quantities_do_not_mix():
    assert common_quantity([record(quantity="motor_current")] * 2) == "motor_current"
    assert common_quantity([]) == "output_torque"
    with pytest.raises(ValueError, match=r"quantity must be the same .* got input_torque, output_torque"):
        Windower().windows([record(), record(quantity="input_torque")])


# -- angles


@pytest.mark.parametrize("sign", [1, -1], ids=["theta_1 itself", "counted in the disc's own direction"])
def test_both_counts_of_the_disc_give_the_same_input_angle(sign):
    phi = steady_angle(2.0, start=0.3)
    recording = record(angle=-sign * (phi + np.pi) / 15, angle_of="disc")
    np.testing.assert_allclose(recording.input_angle(), phi, atol=1e-11)
    assert np.all(np.diff(recording.input_angle()) > 0)


def chirp(order, seconds=4.0, slow=4.0, fast=12.0):
    """Torque of one order while the speed rises from slow to fast turns per second."""
    time = np.arange(round(seconds * RATE)) / RATE
    phi = TURN * (slow * time + (fast - slow) / (2 * seconds) * time**2)
    return 22 + np.cos(order * phi), phi


@pytest.mark.slow
@STEADY
@given(
    samples_per_turn=st.sampled_from([64, 100, 512, 3_072, 8_000]),
    share=st.floats(0.01, 0.39),
    slow=st.floats(2.0, 6.0),
    fast=st.floats(6.0, 12.0),
)
def test_an_order_keeps_its_amplitude_while_the_speed_changes(samples_per_turn, share, slow, fast):
    # below 0.4 samples_per_turn by the filter, far below the rate by the spline (at the record's ends too)
    order = min(share * samples_per_turn, 0.05 * RATE / fast)
    torque, phi = chirp(order, slow=slow, fast=fast)
    resampled, grid = resample_by_angle(torque, phi, samples_per_turn, RATE)
    assert np.max(np.abs(resampled - 22 - np.cos(order * grid))) < 1e-3
    assert grid[0] < phi[0] + TURN * 28 / samples_per_turn
    assert grid[-1] > phi[-1] - TURN * 28 / samples_per_turn


@pytest.mark.slow
@STEADY
@given(samples_per_turn=st.sampled_from([64, 100, 256]), share=st.floats(0.5, 1.9))
def test_orders_beyond_the_new_nyquist_do_not_fold_back(samples_per_turn, share):
    torque, phi = chirp(share * samples_per_turn)
    resampled, _ = resample_by_angle(torque, phi, samples_per_turn, RATE)
    assert np.max(np.abs(resampled - 22)) < 2e-4


@pytest.mark.parametrize("samples_per_turn", [64, 512, 3_072, 5_000])
def test_a_constant_stays_constant_up_to_both_ends(samples_per_turn):
    resampled, _ = resample_by_angle(np.full(51_200, 22.0), steady_angle(2.0), samples_per_turn, RATE)
    np.testing.assert_allclose(resampled, 22.0, rtol=1e-13)


def test_the_grid_lies_on_multiples_of_the_step_of_the_absolute_angle():
    _, grid = resample_by_angle(noise(51_200), steady_angle(2.0, start=1.234), 360, RATE)
    steps = grid / (TURN / 360)
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-9)
    np.testing.assert_allclose(np.diff(grid), TURN / 360, rtol=1e-9)


def test_a_start_from_rest_keeps_its_order_too():
    time = np.arange(25_600) / RATE
    phi = np.where(time < 0.2, 130.9 * time**2, 52.36 * (time - 0.1)) + 1e-9 * time
    resampled, grid = resample_by_angle(np.cos(16 * phi), phi, 512, RATE)
    assert np.max(np.abs(resampled - np.cos(16 * grid))) < 1e-3


@pytest.mark.parametrize(
    ("torque", "angle", "samples_per_turn", "words"),
    [
        (np.zeros(4), np.arange(3.0), 64, "angle must have the length of torque"),
        (np.zeros(4), np.array([0, 1, 1, 2.0]), 64, "sample 1"),
        (np.array([0, np.nan, 0, 0]), np.arange(4.0), 64, "torque must be finite"),
        (noise(200), np.arange(200) * TURN / 3_072, 512, "angle covers 0.0648 turns, .* needed are 0.105"),
        (noise(5_000), steady_angle(5_000 / RATE), 1, "samples_per_turn must be at least 2, got 1"),
        (noise(5_000), steady_angle(5_000 / RATE), 2.5, "samples_per_turn must be a whole number"),
    ],
)
def test_resampling_says_what_is_wrong(torque, angle, samples_per_turn, words):
    with pytest.raises((TypeError, ValueError), match=words):
        resample_by_angle(torque, angle, samples_per_turn, RATE)


# -- Windower, by time


def test_a_window_is_one_whole_output_turn():
    # 15 input turns: 1.8 s at 500 RPM, 2.25 s at 400 RPM
    assert Windower().windows(record(2.0)).X.shape == (1, 46_080)
    assert Windower().windows(record(3.0, speed_rpm=400)).X.shape == (1, 57_600)
    assert Windower(2).windows(record(4.0)).X.shape == (1, 92_160)
    fast = Windower(input_speed_hz=10, reduction=13).windows(record(2.0, speed_rpm=None))
    assert fast.X.shape == (1, 33_280)
    assert Windower(duration=0.6).windows(record(2.0)).X.shape == (3, 15_360)


def test_transform_labels_every_window():
    records = [
        record(4.0, assembly="A", worn_lobes=(2,), defect_count=1),
        record(2.0, assembly="B", defect_count=3),
    ]
    X, y, groups = Windower().transform(records)
    assert X.shape == (3, 46_080)
    assert X.dtype == np.float64
    assert y.tolist() == [1, 1, 3]
    assert y.dtype == np.int64
    assert groups.tolist() == ["A", "A", "B"]
    assert Windower().transform(record(assembly=3))[2].dtype == np.int64
    found = Windower().windows(records)
    assert found.recording.tolist() == [0, 0, 1]
    assert found.start_s.tolist() == [0.0, 1.8, 0.0]
    assert found.worn_lobes == ((2,), (2,), None)
    assert found.sampling_rate == RATE
    assert len(found) == 3
    np.testing.assert_array_equal(X[1], records[0].torque[46_080:92_160])


def test_windows_need_no_labels_but_transform_does():
    bare = Recording(noise(51_200), RATE, speed_rpm=500)
    found = Windower().windows(bare)
    assert found.y is None
    assert found.groups is None
    assert found.worn_lobes == (None,)
    assert np.isnan(found.start_angle).all()
    with pytest.raises(ValueError, match=r"recording 0 has no assembly: windows of one .*folds"):
        Windower().transform(bare)
    with pytest.raises(ValueError, match=r"recording 0 \(assembly 'A'\) has no defect_count.*worn_lobes"):
        Windower().transform(bare.replace(assembly="A"))


@STEADY
@given(
    n=st.integers(100, 700), length=st.integers(50, 100), overlap=st.floats(0, 0.95), skip=st.integers(0, 30)
)
def test_windows_are_stretches_of_the_record(n, length, overlap, skip):
    recording = Recording(np.arange(n), 100.0, assembly=0, defect_count=0)
    windower = Windower(duration=length / 100, overlap=overlap, skip_s=skip / 100)
    if n - skip < length:
        with pytest.raises(ValueError, match="too short"):
            windower.windows(recording)
        return
    found = windower.windows(recording)
    starts = np.round(found.start_s * 100).astype(int)
    # torque was the sample's own number, so each window says where it came from
    np.testing.assert_array_equal(found.X, starts[:, None] + np.arange(length))
    assert starts[0] == skip
    hop = max(1, round(length * (1 - overlap)))
    assert np.all(np.diff(starts) == hop)
    assert n - hop < starts[-1] + length <= n


def test_the_error_of_a_short_record_says_what_it_lacks():
    words = (
        r"recording 1 .*'rig.csv'.*'r7'.*too short.*1.5 s.*38400 samples.*1 output turn.*skip_s = 0.3.*2.1 s"
    )
    with pytest.raises(ValueError, match=words):
        Windower(skip_s=0.3).windows([record(3.0), record(1.5, run="r7", meta={"file": "rig.csv"})])


def test_unknown_speed_names_both_remedies():
    with pytest.raises(ValueError, match=r"Windower\(input_speed_hz=...\) or Recording\(speed_rpm=...\)"):
        Windower().windows([record(), record(speed_rpm=None)])


def test_mixed_rates_and_speeds_are_errors():
    slow = Recording(noise(51_200), 12_800, assembly="B", defect_count=0, speed_rpm=500)
    with pytest.raises(ValueError, match=r"got 25600 Hz in .* 12800 Hz in recording 1.*samples_per"):
        Windower().windows([record(), slow])
    with pytest.raises(ValueError, match=r"recording 1 .*rpm = 400, windows are meant for 500 RPM.*samples"):
        Windower().windows([record(3.0), record(3.0, speed_rpm=400)])
    with pytest.raises(ValueError, match=r"speed_rpm = 400, windows are meant for 500 RPM"):
        Windower(input_speed_hz=500 / 60).windows(record(3.0, speed_rpm=400))


def test_assemblies_that_differ_by_a_per_cent_share_the_nominal_speed():
    records = [record(speed_rpm=rpm) for rpm in (495.0, 500.0, 507.0)]
    with pytest.raises(ValueError, match="differ little"):
        Windower().windows(records)
    assert Windower(input_speed_hz=500 / 60).windows(records).X.shape == (3, 46_080)


def test_a_window_without_a_whole_lobe_is_an_error():
    # 15/16 of an input turn: 0.1125 s at 500 RPM
    assert len(Windower(duration=0.113).windows(record()))
    with pytest.raises(ValueError, match=r"duration = 0.11 s is shorter than one lobe period, 0.1125 s"):
        Windower(duration=0.11).windows(record())
    assert len(Windower(duration=0.05).windows(record(speed_rpm=None)))  # any speed may be meant
    with pytest.raises(ValueError, match="duration = 1e-05 s holds 0 samples"):
        Windower(duration=1e-5).windows(record(speed_rpm=None))


def test_a_constant_window_is_an_error_wherever_it_lies():
    torque = noise(100_000)
    torque[46_080:] = 3.5
    broken = Recording(torque, RATE, assembly="A", defect_count=0, speed_rpm=500)
    with pytest.raises(ValueError, match=r"recording 1 \(assembly 'A'\).*constant \(3.5 Nm\).*1.8 s.*sensor"):
        Windower().windows([record(4.0), broken])
    torque[40_000:] = 3.5  # a spline smears the step over some samples
    turned = Recording(torque, RATE, angle=steady_angle(100_000 / RATE))
    for windower in (Windower(samples_per_turn=3072), lobe_windower(15)):
        with pytest.raises(ValueError, match=r"is constant \(3.5 Nm\)"):
            windower.windows(turned)


def test_what_is_no_recording_is_named():
    with pytest.raises(ValueError, match="at least one"):
        Windower().windows([])
    with pytest.raises(TypeError, match="ndarray"):
        Windower().windows(noise(10).reshape(1, -1))
    with pytest.raises(TypeError, match="got int"):
        Windower().windows(3)
    with pytest.raises(TypeError, match=r"all text or all whole numbers"):
        Windower().windows([record(assembly=1), record(assembly="1")])


@pytest.mark.parametrize(
    ("parameters", "kind", "words"),
    [
        ({"output_turns": 0}, ValueError, "output_turns must be positive and finite, got 0"),
        ({"output_turns": 0.3}, ValueError, "at least 0.5, as .* got 0.3: .* as duration="),
        ({"duration": -1}, ValueError, "duration must be positive"),
        ({"duration": 0.6, "output_turns": 2}, ValueError, "exclude each other"),
        ({"duration": 0.6, "samples_per_turn": 64}, ValueError, "exclude each other"),
        ({"reduction": 1}, ValueError, "reduction must be at least 2"),
        ({"skip_s": -0.1}, ValueError, "skip_s must be finite and not negative, got -0.1"),
        ({"overlap": 1.0}, ValueError, r"overlap must lie in \[0, 1\), got 1.0"),
        ({"samples_per_turn": 1}, ValueError, "samples_per_turn must be at least 2"),
        ({"remove_mean": "yes"}, TypeError, "remove_mean must be True or False"),
    ],
)
def test_parameters_are_checked(parameters, kind, words):
    with pytest.raises(kind, match=words):
        Windower(**parameters)


# -- Windower, by angle


def turning(orders, seconds=6.0, start=0.0, wobble=0.03, rate=RATE, speed=500 / 60, **labels):
    """Recording of given orders (order -> phase) under a speed that wobbles, with its absolute angle."""
    time = np.arange(round(seconds * rate)) / rate
    phi = start + TURN * speed * (time + wobble / TURN * np.sin(TURN * time))
    torque = 22 + sum(np.cos(order * phi + phase) for order, phase in orders.items())
    defaults = {"assembly": "A", "defect_count": 0, "angle": phi, "angle_is_absolute": True}
    return Recording(torque, rate, **{**defaults, **labels})


def test_windows_by_angle_hold_whole_turns_whatever_the_speed_does():
    found = Windower(samples_per_turn=512, skip_s=0.1).windows(turning({16: 0.0}))
    assert found.X.shape[1] == 15 * 512
    assert found.sampling_rate == 512
    spectrum = np.abs(np.fft.rfft(found.X - 22, axis=1)) / (15 * 512 / 2)
    # exactly on line 15 * 16, and nowhere else: no leakage
    np.testing.assert_allclose(spectrum[:, 240], 1, atol=2e-4)
    assert np.delete(spectrum, 240, axis=1).max() < 1e-4


@STEADY
@given(start=st.floats(-200, 200), skip=st.floats(0, 0.5))
def test_windows_of_an_absolute_angle_start_at_the_same_lobe(start, skip):
    # Order 1/15 runs once through 15 input turns: its phase tells where in the output turn a window starts.
    recording = turning({1 / 15: 0.4, 16 / 15: 0.0}, start=start)
    found = Windower(samples_per_turn=128, skip_s=skip).windows(recording)
    expected = TURN * np.arange(15 * 128) / 128
    for window in found.X:
        np.testing.assert_allclose(
            window - 22, np.cos(expected / 15 + 0.4) + np.cos(expected * 16 / 15), atol=1e-3
        )
    turns = found.start_angle / (15 * TURN)
    np.testing.assert_allclose(turns, np.round(turns), atol=1e-9)
    assert found.absolute.all()
    assert found.start_s[0] >= skip - 1e-9
    np.testing.assert_allclose(
        np.interp(found.start_s, np.arange(recording.n_samples) / RATE, recording.angle),
        found.start_angle,
        atol=1e-6,
    )
    # and at the first such place: a turn of the output later at most
    assert found.start_angle[0] - np.interp(skip * RATE, np.arange(recording.n_samples), recording.angle) < (
        15 * TURN + TURN * 28 / 128
    )


def test_windows_of_a_relative_angle_start_right_away():
    recording = turning({3: 0.0}, start=2.5, angle_is_absolute=False)
    found = Windower(samples_per_turn=512, skip_s=0.3).windows(recording)
    assert 0.3 <= found.start_s[0] < 0.301
    assert not found.absolute.any()


def test_an_absolute_angle_of_the_disc_gives_the_same_windows():
    recording = turning({1 / 15: 0.4, 16: 0.0}, start=1.0)
    of_disc = recording.replace(angle=-(recording.angle + np.pi) / 15, angle_of="disc")
    windower = Windower(samples_per_turn=256)
    np.testing.assert_allclose(windower.windows(of_disc).X, windower.windows(recording).X, atol=1e-8)


def test_by_angle_rates_and_speeds_may_be_mixed():
    records = [
        turning({16: 0.0}, speed_rpm=500),
        turning({16: 0.0}, rate=12_800, speed=400 / 60, speed_rpm=400),
    ]
    found = Windower(samples_per_turn=256).windows(records)
    assert {0, 1} == set(found.recording.tolist())
    np.testing.assert_allclose(found.X[0], found.X[-1], atol=2e-3)


def test_recordings_that_cannot_be_cut_by_angle_are_named():
    good = turning({3: 0.0})
    with pytest.raises(ValueError, match=r"recording 1 .*'slow'.*sampling_rate must be at least \d+.* Hz"):
        Windower(samples_per_turn=256).windows([good, turning({3: 0.0}, rate=1_000, run="slow")])
    with pytest.raises(ValueError, match=r"recording 1 .* has no angle.*samples_per_turn.*tachometer"):
        Windower(samples_per_turn=64).windows([good, record()])
    with pytest.raises(ValueError, match=r"lasts 6 s, of which skip_s = 7 s leaves nothing"):
        Windower(skip_s=7, samples_per_turn=64).windows(good)


def test_noise_beyond_the_new_nyquist_order_does_not_enter():
    windower = Windower(samples_per_turn=64, skip_s=0.1)
    # order 200: about 1700 Hz, far above 32 per turn
    assert np.std(windower.windows(turning({200: 0.0})).X) < 1e-4


def test_an_absolute_start_is_never_given_up_silently():
    # 2 s hold 16.7 turns, but only 13 of them after the first multiple of 15
    recording = turning({3: 0.0}, seconds=2.0, start=TURN * 11)
    windower = Windower(samples_per_turn=64)
    with pytest.raises(ValueError, match=r"it lasts 2 s .*first whole one of its.*angle_is_absolute=False"):
        windower.windows(recording)
    assert len(windower.windows(recording.replace(angle_is_absolute=False))) == 1


def test_windows_of_an_absolute_angle_hop_by_whole_output_turns():
    recording = turning({3: 0.0}, seconds=12.0)
    with pytest.raises(ValueError, match=r"overlap = 0.5 of 1 output turns .*absolute"):
        Windower(overlap=0.5, samples_per_turn=64).windows(recording)
    halves = Windower(2, overlap=0.5, samples_per_turn=64).windows(recording)
    np.testing.assert_allclose(np.diff(halves.start_angle), 15 * TURN)
    # 12 s are 6.7 output turns: from turn 1 on, two windows of two fit
    two = Windower(2, samples_per_turn=64, skip_s=0.1).windows(recording)
    np.testing.assert_allclose(two.start_angle / (15 * TURN), [1, 3])


def test_errors_of_the_resampling_name_the_recording():
    phi = np.concatenate([np.linspace(0, 1, 50_000), 1 + steady_angle(4.0)[1:]])
    standing = Recording(noise(phi.size), RATE, angle=phi, run="r7")
    windower = Windower(samples_per_turn=64)
    with pytest.raises(ValueError, match=r"recording 1 \(run 'r7'\): the shaft nearly stands still.*skip_s"):
        windower.windows([turning({3: 0.0}), standing])
    skipping = Windower(samples_per_turn=64, skip_s=2.5)
    assert len(skipping.windows(standing)) == 1


def test_windows_and_angles_follow_the_disc_s_own_lobes():
    torque = np.random.default_rng(0).normal(22, 1, 100_000)
    of_13 = Recording(torque, 25_600.0, speed_rpm=500, n_lobes=13)
    assert Windower().windows(of_13).X.shape == (2, 39_936)
    with pytest.raises(ValueError, match="n_lobes must be the same for all recordings, got 13, 15"):
        Windower().windows([of_13, of_13.replace(n_lobes=15)])
    disc = -np.arange(torque.size) / 25_600 * 2 * np.pi * 500 / 60 / 13
    angle = of_13.replace(angle=disc, angle_of="disc").input_angle()
    assert (angle[-1] - angle[0]) / (2 * np.pi) == pytest.approx(500 / 60 * (torque.size - 1) / 25_600)


def test_a_recording_that_is_short_of_a_window_by_a_sample_is_too_short():
    """14.7 turns are 0.98 of an output turn, but half a sample less than the window."""
    angle = 2 * np.pi * np.linspace(0.003, 14.703, 47_040)
    torque = 22 + np.random.default_rng(0).normal(size=angle.size)
    windower = lobe_windower(15)
    with pytest.raises(ValueError, match="the recording is too short: .* holds 0.9797 output turns, too few"):
        windower.windows(Recording(torque, 25_600, angle=angle))
    assert len(windower.windows(Recording(torque, 25_600, angle=angle * (14.71 / 14.7)))) == 1


def test_an_array_is_copied_unless_nobody_writes_to_it():
    torque = np.arange(1000.0)
    assert not np.shares_memory(Recording(torque, 1000).torque, torque)
    view = torque[:500]
    view.flags.writeable = False  # and yet the array below is written to
    assert not np.shares_memory(Recording(view, 1000).torque, torque)
    torque.flags.writeable = False
    recording = Recording(torque, 1000)
    assert recording.torque is torque
    assert recording.replace(speed_rpm=500).torque is torque


def test_a_long_recording_is_cut_with_the_memory_of_three():
    angle = np.linspace(0, 2 * np.pi * 100, 400_000)
    angle.flags.writeable = False
    torque = np.sin(16 * angle) + np.random.default_rng(0).normal(0, 0.1, angle.size)
    recording = Recording(torque, 25_600, angle=angle)
    lobe_windower(15).windows(recording)  # its imports
    with peak_bytes() as peak:
        windows = lobe_windower(15).windows(recording)
    assert len(windows) == 6
    assert peak[0] < 3 * torque.nbytes


@pytest.mark.parametrize("rpm", [100, 730, 1490])
def test_thinned_recording_gives_the_same_windows(rpm):
    """It keeps 2.5 to 5 times the samples of its windows; these hold nothing above half of theirs."""
    seconds = 16 * 60 / rpm
    angle = steady_angle(seconds, start=1.0, speed=rpm / 60)
    torque = 22 + np.sin(16 / 15 * 5 * angle) + 0.3 * np.random.default_rng(3).normal(size=angle.size)
    whole = Recording(torque, RATE, angle=angle, assembly="A", defect_count=2)
    few = lobe_windower(15).at_lowest_rate(whole)
    per_turn = few.sampling_rate / (rpm / 60)
    assert 2.5 * 128 <= per_turn < 5 * 128
    assert (few.assembly, few.defect_count) == ("A", 2)
    expected, found = (lobe_windower(15).windows(one) for one in (whole, few))
    np.testing.assert_allclose(found.start_angle, expected.start_angle, atol=1e-12)
    np.testing.assert_allclose(found.X, expected.X, atol=1e-3 * expected.X.std())


def test_recording_with_few_samples_is_not_thinned():
    angle = steady_angle(2.0, rate=2560.0)
    few = Recording(noise(angle.size), 2560.0, angle=angle)
    assert lobe_windower(15).at_lowest_rate(few) is few
