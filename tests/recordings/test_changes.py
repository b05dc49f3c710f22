"""Recordings are cropped, resampled, filtered and marked; bad samples reach no window."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import signal
from small_model import recording as bursts
from small_model import small_model

from cyclofeat.datasets import read_recording
from cyclofeat.recordings import Recording, Windower
from cyclofeat.recordings.windower import lobe_windower

RATE, SPEED, TURN_S = 6400.0, 500 / 60, 1.8
TIME = np.arange(round(6 * TURN_S * RATE)) / RATE
TONE = np.sin(2 * np.pi * SPEED * 16 / 15 * TIME) + 0.1 * np.random.default_rng(0).normal(size=TIME.size)
WHOLE = Recording(22 + TONE, RATE, angle=2 * np.pi * SPEED * TIME, angle_is_absolute=True, speed_rpm=500)
MARKED = WHOLE.replace(meta={"gaps": [[6400, 64]]}).with_bad_spans([(5.3, 5.5), (2.0, 2.1)])
WINDOWERS = Windower(), Windower(overlap=0.5), lobe_windower(15)


def test_resampling_is_that_of_scipy_and_bends_no_angle():
    lower = MARKED.resample(1000)
    line = np.interp(TIME, TIME[[0, -1]], WHOLE.torque[[0, -1]])
    expected = signal.resample_poly(WHOLE.torque - line, 5, 32) + line[0]
    good = slice(20, 1900)
    np.testing.assert_allclose(lower.torque[good], expected[good], atol=0.1)
    np.testing.assert_allclose(lower.angle, 2 * np.pi * SPEED * np.arange(lower.n_samples) / 1000)
    assert (lower.meta["gaps"], lower.bad_spans) == ([[1000, 10]], MARKED.bad_spans)
    # A tone above the new limit is gone, not folded.
    assert np.abs(Recording(np.sin(5700 * TIME), RATE).resample(1000).torque[20:-20]).max() < 0.01
    for rate in (np.pi, RATE * 1e5):
        with pytest.raises(ValueError, match=r"^sampling_rate must leave 2 samples or more, .* 6400 Hz, got"):
            WHOLE.resample(rate)


@pytest.mark.parametrize("sign", [1, -1])
def test_a_high_pass_takes_no_mean_from_windows(sign):
    """The mean that a filter leaves has any sign, which turns no window over."""
    whole = WHOLE.replace(torque=sign * WHOLE.torque)
    steady = whole.replace(torque=whole.torque + 3 * np.sin(0.6 * TIME)).high_pass(2.0)
    assert abs(steady.torque.mean()) < 0.01
    assert steady.high_pass(2.0).meta["removed_mean"] == pytest.approx(sign * 22, abs=2)
    for windower in WINDOWERS[::2]:
        mine, theirs = windower.windows(steady).X[1:-1], windower.windows(whole).X[1:-1]
        assert np.abs(mine - mine.mean() - theirs + theirs.mean()).max() < 0.05
        assert np.sign(mine.mean()) == np.sign(theirs.mean()) or windower.remove_mean


@pytest.mark.parametrize("windower", WINDOWERS)
def test_no_window_touches_a_bad_span(windower):
    spoiled = MARKED.torque.copy()
    for start, stop in MARKED.bad_spans:
        spoiled[round(start * RATE) : round(stop * RATE)] = -1e9
    whole, cut = windower.windows(WHOLE), windower.windows(MARKED.replace(torque=spoiled))
    length = TURN_S * windower.output_turns
    good = [not any(s < b and s + length > a for a, b in MARKED.bad_spans) for s in whole.start_s]
    assert 0 < sum(good) < len(whole)
    np.testing.assert_allclose(cut.start_s, whole.start_s[good])
    np.testing.assert_allclose(cut.X, whole.X[good], atol=0.02)
    with pytest.raises(ValueError, match="no window outside its bad spans"):
        windower.windows(WHOLE.with_bad_spans([(1, 10)]))


def test_bad_samples_change_no_count():
    model, whole = small_model(), bursts((4, 5, 6), seed=100, turns=5)
    marked = whole.with_bad_spans([(3.8, 4.0)])  # of five windows the third
    answer = model.count(marked.replace(torque=whole.torque + 1e6 * (np.abs(whole.angle - 205) < 2)))
    assert answer == model.count(marked)
    assert [window.start_s for window in answer.windows] == pytest.approx([0, 1.764, 5.292, 7.056], abs=0.01)
    assert answer.lobes == model.count(whole.high_pass(0.5)).lobes == (4, 5, 6)


def test_bad_spans_and_gaps_move_with_the_samples():
    part = MARKED.crop(2.05, 5.4)
    np.testing.assert_allclose(part.bad_spans, [(0, 0.05), (3.25, 3.35)])
    assert part.meta["history"] == ["with_bad_spans", "crop(2.05, 5.4)"]
    assert ("gaps" in part.meta, MARKED.crop(0.25).meta["gaps"]) == (False, [[4800, 64]])
    for span in ((1, 1), (2, 1), (99, 100), (-2, -1)):
        with pytest.raises(ValueError, match=r"^spans must begin before they end, within the 10.8 s"):
            WHOLE.with_bad_spans([span])


def test_a_frame_is_read_again(tmp_path):
    recording = WHOLE.replace(quantity="motor_current").crop(0, 1)
    recording.to_frame().to_csv(tmp_path / "frame.csv")
    again = read_recording(tmp_path / "frame.csv", quantity="motor_current")
    assert (again.sampling_rate, again.unit) == (RATE, "A")
    np.testing.assert_allclose((again.torque, again.angle), (recording.torque, recording.angle))


def test_joined_parts_have_the_windows_of_the_whole():
    joined = Recording.concatenate([WHOLE.crop(0, 2 * TURN_S), WHOLE.crop(2 * TURN_S)])
    np.testing.assert_array_equal(joined.torque, WHOLE.torque)
    np.testing.assert_array_equal(joined.angle, WHOLE.angle)
    np.testing.assert_array_equal(WINDOWERS[0].windows(joined).X, WINDOWERS[0].windows(WHOLE).X)
    assert (joined.gaps, joined.bad_spans) == (((23_040, 0),), ((2 * TURN_S, 2 * TURN_S),))
    # Of another recording whole output turns are left out, so that lobes keep their places.
    other = WHOLE.replace(angle=WHOLE.angle + 2 * np.pi * 15 * 1000.3)
    pair = Recording.concatenate([WHOLE, other])
    assert 0 < pair.angle[WHOLE.n_samples] - WHOLE.angle[-1] <= 2 * np.pi * 15
    turns = (other.angle[0] - pair.angle[WHOLE.n_samples]) / (2 * np.pi * 15)
    assert turns == pytest.approx(round(turns))
    assert pair.mean_input_speed() == pytest.approx(SPEED)
    relative = WHOLE.replace(angle_is_absolute=False)
    for other, words in (
        (WHOLE, "angle_is_absolute must be the same"),
        (relative, "absolute angle, or one that"),
    ):
        with pytest.raises(ValueError, match=words):
            Recording.concatenate([relative, other])
