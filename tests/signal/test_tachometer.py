"""Angles from pulses, and from angles that start again at each turn."""

import numpy as np
import pytest
from memory import peak_bytes
from numpy.testing import assert_allclose

from cyclofeat.signal.tachometer import angle_from_pulses, continuous_angle

RATE = 25_600.0
TIME = np.arange(int(2 * RATE)) / RATE


def wandering(rpm=500.0, by=0.05):
    """Angle in rad of a shaft whose speed wanders by a share at 0.7 Hz."""
    hertz = rpm / 60
    return 2 * np.pi * hertz * (TIME + by * np.sin(2 * np.pi * 0.7 * TIME) / (2 * np.pi * 0.7))


def pulses(angle, per_turn, duty=0.3):
    return (((angle / (2 * np.pi) * per_turn) + 0.2) % 1.0 < duty).astype(float)


@pytest.mark.parametrize(("per_turn", "error_deg"), [(1, 1.0), (4, 0.3), (60, 0.3), (360, 0.3)])
def test_pulses_give_the_angle_of_a_wandering_shaft(per_turn, error_deg):
    """The error is that of a sample, 0.12 deg at 500 RPM, and of the curve between few pulses."""
    angle = wandering()
    found = angle_from_pulses(pulses(angle, per_turn), per_turn)
    assert np.all(np.diff(found) > 0)
    off = found - angle
    first = 60 / 500 * RATE / per_turn * 2  # straight lines outside the pulses
    inside = slice(int(first), -int(first))
    assert np.degrees(np.ptp(off[inside])) < error_deg


def test_edges_are_read_between_samples():
    """Slow edges of a filtered index: far better than a sample."""
    angle = wandering(by=0.0)
    signal = 5 * np.exp(-0.5 * (((angle / (2 * np.pi) + 0.5) % 1.0 - 0.5) / 0.02) ** 2)
    found = angle_from_pulses(signal, 1)
    inside = slice(5000, -5000)
    assert np.degrees(np.ptp((found - angle)[inside])) < 0.02


def test_noise_makes_no_edges():
    angle, random = wandering(), np.random.default_rng(0)
    signal = 24 * pulses(angle, 8) + random.normal(0, 0.6, TIME.size)
    assert_allclose(np.ptp(angle_from_pulses(signal, 8)), np.ptp(angle), rtol=1e-3)


def test_a_run_up_misses_no_pulse_and_a_lost_one_is_an_error():
    run_up = 2 * np.pi * (2 * TIME + 3 * TIME**2)
    assert_allclose(np.ptp(angle_from_pulses(pulses(run_up, 16), 16)), np.ptp(run_up), rtol=2e-3)
    lost = pulses(wandering(), 16)
    lost[10_000:10_200] = 0
    with pytest.raises(ValueError, match=r"hold each pulse once, got 38\d.* samples between two at"):
        angle_from_pulses(lost, 16)


@pytest.mark.parametrize(
    ("signal", "per_turn", "message"),
    [
        (np.ones(100), 1, "must hold pulses, got 1 throughout"),
        (np.r_[np.zeros(50), np.ones(50)], 1, "at least 3 pulses, got 1 in its range, 0 to 1$"),
        (
            pulses(wandering(), 60) + 50 * (np.arange(wandering().size) == 700),
            60,
            "pulses, got 1 .* a spike at sample 700 hides them",
        ),
        (np.r_[0.0, np.nan, 1.0], 1, "signal must be finite, got nan at sample 1"),
        (pulses(wandering(), 2048), 2048, "at least 4 samples per pulse, got 3"),
        (np.ones(100), 0, "pulses_per_turn must be at least 1, got 0"),
    ],
)
def test_what_holds_no_pulses_is_said(signal, per_turn, message):
    with pytest.raises(ValueError, match=message):
        angle_from_pulses(signal, per_turn)


def test_a_shaft_that_stops_or_starts_has_not_turned_by_another_pulse_or_step():
    stops = np.minimum(wandering(), 30.0)
    for found, step in (
        (angle_from_pulses(pulses(stops, 60), 60), 2 * np.pi / 60),
        (angle_from_pulses(pulses(-stops[::-1], 60), 60), 2 * np.pi / 60),
        (continuous_angle(stops % (2 * np.pi)), 0.01),
        (continuous_angle(np.floor(stops * 60 / (2 * np.pi)) % 60 * 2 * np.pi / 60), 2 * np.pi / 60),
    ):
        assert np.all(np.diff(found) > 0)
        assert np.ptp(found) == pytest.approx(30.0, abs=2 * step)


def test_the_first_step_may_have_begun_before_the_recording():
    angle = wandering() + 2.5 * np.pi / 60  # starts late within a step of 12 deg
    told = np.floor(angle * 30 / (2 * np.pi)) % 30 * 2 * np.pi / 30
    assert np.ptp(continuous_angle(told) - angle) < 0.02


def test_a_continuous_angle_is_unchanged():
    angle = wandering()
    assert continuous_angle(angle) is angle
    assert continuous_angle(-angle)[5] == -angle[5]


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("counts", [None, 4096, 360])
def test_an_angle_that_starts_again_and_steps_becomes_continuous(sign, counts):
    angle = sign * wandering()
    told = angle % (2 * np.pi)
    step = 0.0
    if counts is not None:
        step = 2 * np.pi / counts
        told = np.floor(told / step) * step
    found = continuous_angle(told)
    assert np.all(sign * np.diff(found) > 0)
    assert np.ptp(found - angle) < 1.5 * step + 2 * np.median(np.abs(np.diff(angle))) + 1e-9


def test_samples_on_the_way_down_are_passed_over():
    """A converter's filter draws the fall out over a few samples."""
    angle = wandering()
    told = np.convolve(angle % (2 * np.pi), [0.25, 0.5, 0.25], mode="same")[1:-1]
    assert np.abs(np.ptp(continuous_angle(told)) - np.ptp(angle[1:-1])) < 0.01


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("noise", [0.002, 0.02])
@pytest.mark.parametrize("start", [0.0, 3.0])
def test_an_analog_angle_with_noise_is_averaged(sign, noise, start):
    """Noise carries the angle back and forth over its start, and past the samples beside it."""
    angle = start + sign * wandering()
    random = np.random.default_rng(3)
    of_shaft = (angle + random.normal(0, noise, angle.size)) % (2 * np.pi)
    of_signal = angle % (2 * np.pi) + random.normal(0, noise, angle.size)
    for told in (of_shaft, of_signal):
        found = continuous_angle(told)
        assert np.all(sign * np.diff(found) > 0)
        error = found - angle
        assert np.abs(error - np.median(error)).max() < max(0.01, 4 * noise)
        if noise > 0.01:  # averaged: below a quarter of the noise
            assert error.std() < 0.25 * noise


@pytest.mark.parametrize(
    "wrong",
    [
        np.random.default_rng(1).normal(size=5000),
        np.sin(wandering()),
        np.zeros(100),
        np.where(np.arange(5000) % 50 < 10, 0.0, wandering()[:5000]),
    ],
    ids=["noise", "a wave", "constant", "zeros between"],
)
def test_what_is_no_angle_is_an_error(wrong):
    with pytest.raises(ValueError, match="angle must rise or fall"):
        continuous_angle(wrong)


def test_a_long_angle_takes_little_memory():
    """Before, 13 times its own."""
    angle = np.linspace(0, 2 * np.pi * 1000, 1_000_000) % (2 * np.pi)
    with peak_bytes() as peak:
        continuous_angle(angle)
    assert peak[0] < 6 * angle.nbytes
