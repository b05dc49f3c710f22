"""Samples in pieces are counted as the whole recording is."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from small_model import RATE, recording, shaft_model, small_model

from cyclofeat.counting import LobeStream


def resampled(record, factor):
    """The same at a multiple of the sampling rate, with the noise of a meter of that rate."""
    old, new = np.arange(record.n_samples), np.arange((record.n_samples - 1) * factor) / factor
    noise = np.random.default_rng(1).normal(0, 0.02, new.size)
    return record.replace(
        torque=np.interp(new, old, record.torque) + noise, angle=np.interp(new, old, record.angle),
        sampling_rate=record.sampling_rate * factor,
    )  # fmt: skip


def streamed(record, cuts=()):
    """Push a recording in pieces; return the windows and the result."""
    stream = LobeStream(shaft_model(), record.sampling_rate, angle_is_absolute=record.angle_is_absolute)
    windows = []
    for torque, angle in zip(np.split(record.torque, cuts), np.split(record.angle, cuts), strict=True):
        windows += stream.push(torque, angle)
    return windows, stream.result()


def random_cuts(n, seed, pieces=400):
    """Many pieces of a few samples, some empty, and large ones."""
    random = np.random.default_rng(seed)
    return np.sort(np.concatenate([random.integers(0, n, pieces), n // 3 + np.arange(50) // 2]))


@pytest.mark.parametrize(
    ("factor", "labels"),
    [(1, {}), (8, {}), (8, {"slowing": 0.02}), (1, {"angle_is_absolute": False, "slowing": 0.01})],
)
def test_a_stream_with_angle_is_counted_as_the_file(factor, labels):
    record = resampled(recording((4, 5, 6), seed=70, turns=4, **labels), factor)
    end = np.searchsorted(record.angle, 2 * np.pi * 59)  # 0.2 turns behind the fourth window
    record = record.replace(torque=record.torque[:end], angle=record.angle[:end])
    windows, count = streamed(record)
    whole = shaft_model().count(record)
    assert len(whole.windows) == 4
    assert len(windows) == 3  # the last lies too close to the end, and comes with the result
    for mine, theirs in zip(count.windows, whole.windows, strict=True):
        assert_allclose((mine.start_s, mine.stop_s), (theirs.start_s, theirs.stop_s), atol=1e-9)
        assert_allclose(mine.distance, theirs.distance, rtol=1e-6)
        assert (mine.defect_count, mine.reason) == (theirs.defect_count, theirs.reason)
    assert (count.defect_count, count.lobes, count.absolute) == (3, whole.lobes, whole.absolute)
    assert_allclose(list(count.probability.values()), list(whole.probability.values()), atol=1e-9)
    assert_allclose(count.lobe_probability, whole.lobe_probability, atol=1e-9)
    assert count.warnings == whole.warnings


@pytest.mark.parametrize("seed", range(3))
def test_the_sizes_of_the_pieces_change_no_bit(seed):
    record = resampled(recording((1,), seed=71, turns=3, slowing=0.02), 4)
    alone = streamed(record)
    assert streamed(record, random_cuts(record.n_samples, seed)) == alone
    assert alone[0] == list(alone[1].windows[:2])


def test_a_stream_keeps_a_window_and_begins_anew():
    record = recording((2, 3, 4), seed=72, turns=9)
    stream = LobeStream(shaft_model(), RATE)
    counts, kept = [], []
    for k in range(0, record.n_samples, 100):
        stream.push(record.torque[k : k + 100], record.angle[k : k + 100])
        kept.append(sum(torque.size for torque, _ in stream._windows._pieces))
        if k in (12_000, 24_000):
            counts.append(stream.result())
    assert max(kept) <= 240 * 16 + 100  # samples of sixteen input turns and a piece
    assert [len(one.windows) for one in counts] == [3, 3]
    assert all(one.defect_count == 3 for one in counts)
    assert counts[1].windows[0].start_s < 0.01  # times begin anew too


def test_a_speed_that_training_did_not_see_is_refused():
    record = recording((), seed=73, turns=2)
    fast = record.replace(angle=record.angle * 1.2, speed_rpm=None)
    windows, count = streamed(fast)
    assert not any(one.reason for one in windows)
    assert "but the model was trained at" in count.reason


def test_blocks_are_counted_as_recordings():
    record = recording((2, 3, 4), seed=74, turns=4).replace(angle=None, angle_is_absolute=False)
    for model in (shaft_model(), small_model()):
        stream = LobeStream(model, RATE, speed_rpm=500, block_turns=2)
        cuts = random_cuts(record.n_samples, 5)
        windows = [one for piece in np.split(record.torque, cuts) for one in stream.push(piece)]
        halves = [model.count(record.crop(*ends)) for ends in ((0.0, 3.6), (3.6, 7.2))]
        alone = [one for half in halves for one in half.windows]
        assert [one.defect_count for one in windows] == [one.defect_count for one in alone]
        assert_allclose([one.distance for one in windows], [one.distance for one in alone])
        assert_allclose([one.start_s for one in windows[2:]], [3.6 + one.start_s for one in alone[2:]])
        count = stream.result()
        assert (count.defect_count, count.lobes, count.refused) == (3, (), False)
        assert "counted in blocks of 2 output turns, without positions" in count.warnings[0]


def test_what_is_wrong_with_a_stream_is_said():
    model, record = shaft_model(), recording((), turns=2)
    with pytest.raises(TypeError, match="model must be of type LobeModel, got 'model.skops'"):
        LobeStream("model.skops", RATE)
    for options, message in (
        ({}, "speed_rpm must be given"),
        ({"speed_rpm": 500, "angle_is_absolute": True}, "angle_is_absolute must be False with block_turns"),
    ):
        with pytest.raises(ValueError, match=message):
            LobeStream(model, RATE, block_turns=1, **options)
    stream, (torque, angle) = LobeStream(model, RATE), (record.torque, record.angle)
    stream.push(torque[:100], angle[:100])
    for samples, at, error, message in (
        (torque, None, ValueError, "angle must be given .input shaft, rad."),
        (torque[:3600], angle[:7], ValueError, "angle must have the length of samples, 3600, got 7"),
        (torque[100:140], angle[50:90], ValueError, "angle must increase strictly"),
        (torque[100:140], angle[140:100:-1], ValueError, "angle must increase strictly"),
        ([np.nan], [1e3], ValueError, "samples must be finite, got nan"),
        (
            torque[100:],
            1e3 + angle[100:],
            ValueError,
            "less than an output turn .15 of .* got 1.+ call result",
        ),
        (torque[100:] * 1j, angle[100:], TypeError, "samples must be an array of real numbers"),
        (["a"] * 8, angle[100:], TypeError, "samples must be an array of real numbers"),
    ):
        with pytest.raises(error, match=message):
            stream.push(samples, at)
    with pytest.raises(ValueError, match="holds no complete window: 0.05 s have .* takes 1 output"):
        stream.result()
    stream.push(torque[100:], angle[100:])  # none of it has harmed the stream
    assert len(stream.result().windows) == 2
    with pytest.raises(ValueError, match="angle has no effect with block_turns"):
        LobeStream(model, RATE, block_turns=1, speed_rpm=500).push([22.0], [0.0])


@pytest.mark.parametrize("with_angle", [True, False])
def test_a_dead_sensor_within_a_piece_costs_no_answer_before_or_behind_it(with_angle):
    record = recording((2, 3, 4), seed=75, turns=5)
    turn = record.n_samples // 5
    torque = np.where(np.abs(np.arange(record.n_samples) - 2.5 * turn) < 0.7 * turn, 22.0, record.torque)
    ways = {} if with_angle else {"block_turns": 1, "speed_rpm": 500}
    stream = LobeStream(shaft_model(), RATE, **ways)
    with pytest.raises(ValueError, match="constant .22 Nm. over a whole window"):
        stream.push(torque, record.angle if with_angle else None)
    returned = stream.push([], [] if with_angle else None)
    if not with_angle:
        assert len(returned) == 4
    assert returned[0].start_s < 0.1
    assert len(stream.result().windows) == 4
