"""Worn and removed lobes: where and when they act, other geometries, divergence and its remedy."""

from __future__ import annotations

import re

import numpy as np
import pytest
from reference_tools import simulate_with

from cyclofeat.simulators import CycloidalGearbox, LobeDefects, PinErrors, Rig, SimulationRun, simulate
from cyclofeat.simulators.simulation import SimulationDiverged

STEEL = CycloidalGearbox.steel()
STEP_RATE = 100_000
LOBE_PERIOD = 11_250  # steps: 15/16 of an input turn at 500 RPM
SETTLED = slice(40_000, 40_000 + LOBE_PERIOD)


def raw(defects: LobeDefects, gearbox: CycloidalGearbox = STEEL, **options) -> SimulationRun:
    return simulate_with(gearbox, defects, sampling_rate=STEP_RATE, decimation="pick", **options)


def test_equal_lobes_of_both_wheels_act_at_the_same_moment() -> None:
    """On opposite sleeves, so that the output cannot tell the wheels apart."""
    both = raw(LobeDefects.worn(1), duration=0.55, forces=True)
    forces = both.external_forces[SETTLED].max(axis=2)
    assert forces.max(axis=0) == pytest.approx([693, 693], rel=0.01)
    assert abs(np.diff(forces.argmax(axis=0))[0]) <= 1
    sleeves = both.external_forces[SETTLED].max(axis=0).argmax(axis=1)
    assert abs(sleeves[1] - sleeves[0]) == 8
    one, other = (raw(LobeDefects.worn(1, wheels=(wheel,)), duration=0.55) for wheel in (0, 1))
    np.testing.assert_allclose(one.torque_out[SETTLED], other.torque_out[SETTLED], rtol=0, atol=1e-7)
    assert np.ptp(one.torque_out[SETTLED]) > 0.2


def test_lobes_act_one_after_the_other() -> None:
    """Lobe k follows lobe 0 by k fifteenths of the lobe period, 7.5 ms at 500 RPM."""
    first = raw(LobeDefects.worn((0,)), duration=0.65).torque_out
    for lobe in (1, 4, 14):
        torque = raw(LobeDefects.worn((lobe,)), duration=0.65).torque_out
        late = lobe * LOBE_PERIOD // 15
        moved = torque[SETTLED.start + late : SETTLED.stop + late]
        assert np.abs(moved - first[SETTLED]).max() < 0.02
        assert np.ptp(moved) > 1.5


def test_disturbance_is_a_comb_at_16_15_of_the_input_speed() -> None:
    """Its spacing is 8.889 Hz, its first line is tiny, and nothing lies at 8.333 Hz, the input's own."""
    run = raw(LobeDefects.worn(1), duration=0.4 + 15 * 0.1125)
    torque = run.torque_out[40_000:] - 22
    assert torque.size == 15 * LOBE_PERIOD
    power = np.abs(np.fft.rfft(torque)) ** 2
    spacing = STEP_RATE / torque.size * 15
    assert spacing == pytest.approx(16 / 15 * 500 / 60)
    assert power[::15].sum() > (1 - 1e-9) * power.sum()
    assert power[15] < 1e-3 * power.sum()
    assert np.count_nonzero(power[::15] > 1e-3 * power.sum()) > 40


def test_unequal_pins_repeat_after_fifteen_input_turns_only() -> None:
    gearbox = Rig(STEEL, [PinErrors(10e-6)]).draw(3).gearbox
    torque = raw(LobeDefects.worn(1), gearbox, duration=0.4 + 1.8 + 0.2).torque_out
    piece, turns = torque[40_000:60_000], 180_000
    assert torque[40_000 + turns : 60_000 + turns] == pytest.approx(piece, abs=1e-7)
    assert np.abs(torque[40_000 + LOBE_PERIOD : 60_000 + LOBE_PERIOD] - piece).max() > 0.1


def test_effect_grows_with_depth() -> None:
    spread = [
        raw(LobeDefects.worn(3, depth=depth), duration=0.55).torque_out[SETTLED].std()
        for depth in (0.0, 0.25, 0.5, 0.75, 1.0)
    ]
    assert np.all(np.diff(spread) > 0.003)
    healthy = raw(LobeDefects.healthy(), duration=0.55).torque_out[SETTLED].std()
    assert spread[0] == pytest.approx(healthy, rel=1e-6)


@pytest.mark.parametrize("worn", [0, 3])
def test_fourteen_pins(worn: int) -> None:
    """A printed drive of 13 lobes."""
    gearbox = CycloidalGearbox.printed_14_pin(load_torque=5.0)
    assert (gearbox.n_lobes, gearbox.pin_circle_radius) == (13, pytest.approx(34e-3))
    run = raw(LobeDefects.worn(worn), gearbox, duration=0.6, forces=True)
    period = round(13 / 14 * 0.12 * STEP_RATE)
    assert run.torque_out[-2 * period :].mean() == pytest.approx(5.0, rel=1e-3)
    assert run.torque_in[-2 * period :].mean() == pytest.approx(5.0 / 13, rel=0.05)
    turned = run.output_angle[-1] - run.output_angle[-2 * period]
    assert turned == pytest.approx(-STEEL.input_speed * (2 * period - 1) / STEP_RATE / 13, rel=1e-3)
    assert run.external_forces.shape == (60_000, 2, 14)
    if worn == 0:
        assert run.torque_out[-2 * period :].std() < 0.1
        assert np.abs(run.torque_out[-2 * period :] - 5).max() < 0.3


@pytest.mark.parametrize("n_pins", [5, 10, 15, 40])
def test_other_numbers_of_pins(n_pins: int) -> None:
    """Also with an even number of lobes, whose wheels are half a lobe from facing each other."""
    gearbox = STEEL.replace(n_pins=n_pins, eccentricity=0.064 * 0.7 / n_pins, pin_radius=2e-3)
    run = raw(LobeDefects.healthy(), gearbox, duration=0.5)
    assert run.torque_out[30_000:].mean() == pytest.approx(22, rel=0.01)
    assert run.torque_in[30_000:].mean() == pytest.approx(22 / (n_pins - 1), rel=0.06)


@pytest.mark.parametrize("n_pins", [5, 15])
def test_worn_lobes_of_even_numbers_of_lobes(n_pins: int) -> None:
    """Worn on the one wheel or on the other, a lobe does the same to its own wheel."""
    gearbox = STEEL.replace(n_pins=n_pins, eccentricity=0.064 * 0.7 / n_pins, pin_radius=2e-3)
    largest = []
    for wheel in (0, 1):
        run = raw(LobeDefects.worn(1, wheels=(wheel,)), gearbox, duration=0.5, forces=True)
        forces = run.external_forces[30_000:].max(axis=(0, 2))
        largest.append((forces[wheel], forces[1 - wheel]))
    assert largest[0] == pytest.approx(largest[1], rel=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_slips_far_without_lobes(seed: int) -> None:
    """Seven lobes of both wheels removed: pins leave the profile's neighbourhood, and steps do not matter."""
    gearbox = Rig(STEEL, [PinErrors(5e-6)]).draw(seed).gearbox
    runs = [
        simulate_with(
            gearbox, LobeDefects.removed(7), duration=0.35, dt=dt, sampling_rate=5000, decimation="pick"
        )
        for dt in (1e-5, 5e-6)
    ]
    coarse, fine = (run.output_angle + run.input_angle / 15 for run in runs)
    assert coarse.max() > 0.03
    assert np.abs(coarse - fine).max() < 1e-3


def test_divergence_says_when_where_and_what_helps() -> None:
    stiff = STEEL.replace(stiffness_scale=1.0)
    with pytest.raises(SimulationDiverged) as caught:
        simulate(stiff, LobeDefects.worn(1), duration=0.05)
    error = caught.value
    assert 0 <= error.time < 0.01
    # At the start lobe 0 of either wheel is pressed against a sleeve, equally.
    assert re.fullmatch(
        r"the contact of wheel [12] with external sleeve [19] \(counted from 1\)", error.contact
    )
    for part in (
        f"t = {error.time:.6f} s",
        error.contact,
        "dt = 1e-05 s",
        "try 2.5e-06 s",
        "stiffness_scale",
    ):
        assert part in str(error)
    # The remedies do help.
    run = simulate_with(stiff, LobeDefects.worn(1), duration=0.4, dt=2.5e-6)
    assert run.torque_out[run.time > 0.25].mean() == pytest.approx(22, abs=0.5)
    run = simulate(STEEL.replace(stiffness_scale=0.25), LobeDefects.worn(1), duration=0.4)
    assert run.torque_out[run.time > 0.25].mean() == pytest.approx(22, abs=0.5)


def test_divergence_beyond_numbers_is_found() -> None:
    """Angles that are not numbers must not end up as an index."""
    for defects in (LobeDefects.healthy(), LobeDefects.worn(7), LobeDefects.removed(7)):
        with pytest.raises(SimulationDiverged, match="inf N"):
            simulate_with(
                STEEL.replace(wheel_inertia=1e-300), defects, duration=0.05, dt=1e-3, sampling_rate=1000
            )
