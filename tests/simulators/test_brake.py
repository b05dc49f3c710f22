"""A brake's rotor behind a compliant torque meter."""

from __future__ import annotations

import math

import numpy as np
import pytest
from reference_tools import Kernel, simulate_with

from cyclofeat.simulators import CycloidalGearbox, LobeDefects, SimulationRun

STEEL = CycloidalGearbox.steel()


def run(gearbox: CycloidalGearbox, defects: LobeDefects | None = None, **options) -> SimulationRun:
    return simulate_with(gearbox, defects, sampling_rate=10_000, decimation="pick", **options)


def test_torque_out_is_the_meters() -> None:
    """Spring and damper between output shaft and rotor; it drives the rotor against the load."""
    gearbox = STEEL.replace(brake_inertia=0.02, meter_stiffness=1e4, meter_damping=0.6)
    state = np.array([1e-3, 1e-3, 2e-3, 5e-3, 0.1, 0.2, 0.3, 0.7])
    kernel, free = Kernel(gearbox, LobeDefects.healthy()), Kernel(STEEL, LobeDefects.healthy())
    found = kernel(state, 0.3, omega=52.0, load=22.0)
    meter = 1e4 * (5e-3 - 2e-3) + 0.6 * (0.7 - 0.3)
    assert found["output_torque"] == pytest.approx(meter, rel=1e-12)
    assert found["brake_acceleration"] == pytest.approx((22.0 - meter) / 0.02, rel=1e-12)
    # The output shaft feels the meter instead of the load, all else is as without a brake.
    bare = free(state, 0.3, omega=52.0, load=meter)
    assert found["psi_acceleration"] == pytest.approx(bare["psi_acceleration"], rel=1e-9)
    for name in ("theta_acceleration", "input_torque", "external_force", "internal_force"):
        assert np.array_equal(found[name], bare[name]), name


@pytest.mark.parametrize(("inertia", "stiffness"), [(0.02, 1e4), (0.01, 2e4)])
def test_mean_of_the_meter_is_the_load(inertia: float, stiffness: float) -> None:
    """And wear makes many times the ripple of 0.155 Nm on a free output."""
    gearbox = STEEL.with_brake(inertia, stiffness, 0.2)
    torque = run(gearbox, LobeDefects.worn(3), duration=1.325).torque_out[-4 * 1125 :]
    assert torque.mean() == pytest.approx(22, abs=0.005)
    assert torque.std() > 5 * 0.155


def gear_stiffness(load: float) -> float:
    """Torsional stiffness of the healthy gear about a load, by static deflection, in Nm/rad."""
    low, high = (run(STEEL.replace(load_torque=load + change), duration=0.425) for change in (-1.0, 1.0))
    settled = slice(2000, None)
    return 2.0 / float(np.mean(high.output_angle[settled] - low.output_angle[settled]))


@pytest.mark.parametrize(("inertia", "stiffness"), [(0.02, 1e4), (0.005, 3e3), (0.05, 3e4), (0.02, 1e3)])
def test_resonance_lies_where_gear_and_meter_in_series_put_it(inertia: float, stiffness: float) -> None:
    """Free decay after a small step of the load, against two inertias on two springs."""
    gearbox = STEEL.with_brake(inertia, stiffness, 0.01)
    still = run(gearbox, duration=1.1)
    kicked = run(gearbox, duration=1.1, load_fluctuation=lambda t: np.where(t > 0.5, 0.5, 0.0))
    decay = (kicked.torque_out - still.torque_out)[5000:]
    decay -= decay[-1000:].mean()
    spectrum = np.abs(np.fft.rfft(decay, 1 << 17))
    found = np.fft.rfftfreq(1 << 17, 1e-4)[spectrum.argmax()]
    gear = gear_stiffness(22.0)
    assert gear == pytest.approx(8040, rel=0.02)
    springs = np.array([[gear + stiffness, -stiffness], [-stiffness, stiffness]])
    modes = np.sqrt(np.linalg.eigvals(springs / [[gearbox.output_inertia], [inertia]])) / (2 * np.pi)
    assert found == pytest.approx(modes.min(), rel=0.01)
    in_series = math.sqrt(1 / (1 / gear + 1 / stiffness) / inertia) / (2 * math.pi)
    assert found == pytest.approx(in_series, rel=0.015)


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ((-0.1, 1e3, 0.1), ValueError, "inertia must be finite and not negative, got -0.1"),
        ((0.1, float("nan"), 0.1), ValueError, "stiffness must be finite and not negative, got nan"),
        ((0.1, 1e3, 1.0), ValueError, r"damping_ratio must lie in \[0, 1\), got 1.0"),
        ((0.1, 0.0, 0.1), ValueError, "brake_inertia needs a meter_stiffness above 0"),
        (("a", 1e4, 0.1), TypeError, "inertia must be a number, got 'a'"),
    ],
)
def test_impossible_brakes_are_refused(arguments: tuple, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        STEEL.with_brake(*arguments)
