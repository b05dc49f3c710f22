"""What ``simulate`` records: steps, decimation, drive, load, seeds."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from reference_tools import simulate_with

from cyclofeat.simulators import CycloidalGearbox, LobeDefects, Rig, SimulationRun, simulate

STEEL = CycloidalGearbox.steel()


def raw(defects: LobeDefects | None = None, gearbox: CycloidalGearbox = STEEL, **options) -> SimulationRun:
    """Every step of the integration."""
    return simulate_with(gearbox, defects, sampling_rate=100_000, decimation="pick", **options)


def same(a: SimulationRun, b: SimulationRun) -> bool:
    names = ("torque_out", "torque_in", "input_angle", "output_angle")
    return all(np.array_equal(getattr(a, name), getattr(b, name)) for name in names)


@pytest.mark.parametrize(
    ("integrator", "steps", "error"),
    [("midpoint", (4e-5, 2e-5, 1e-5, 5e-6), 2e-3), ("adams_bashforth", (2e-5, 1e-5, 5e-6, 2.5e-6), 6e-3)],
)
def test_integration_is_of_second_order(integrator: str, steps: tuple[float, ...], error: float) -> None:
    """Before the first impact, over the first 4 ms of load and the ringing after them."""
    quick = STEEL.replace(ramp_time=0.004)

    def end(dt: float, rule: str = "midpoint") -> np.ndarray:
        run = simulate_with(
            quick, duration=0.02, dt=dt, sampling_rate=5000, decimation="pick", integrator=rule
        )
        return np.stack([1e3 * run.output_angle, run.torque_out, run.torque_in])

    exact = end(6.25e-7)
    errors = [np.abs(end(dt, integrator) - exact).max(axis=1) for dt in steps]
    for coarse, fine in pairwise(errors):
        assert np.all(coarse / fine > 3.5)
        assert np.all(coarse / fine < 4.5)
    assert errors[steps.index(1e-5)] == pytest.approx(np.zeros(3), abs=error)  # Nm at the papers' step


@pytest.mark.parametrize("sampling_rate", [10_000, 20_000, 1000])
def test_picked_samples_are_those_of_the_integration(sampling_rate: int) -> None:
    every = 100_000 // sampling_rate
    full = raw(LobeDefects.worn(2), duration=0.25, forces=True)
    picked = simulate_with(
        STEEL, LobeDefects.worn(2), duration=0.25, sampling_rate=sampling_rate, decimation="pick", forces=True
    )
    assert picked.torque_out.size == 0.25 * sampling_rate
    for name in ("torque_out", "torque_in", "output_angle", "external_forces", "internal_forces"):
        assert np.array_equal(getattr(picked, name), getattr(full, name)[::every]), name
    assert picked.input_angle == pytest.approx(full.input_angle[::every], abs=1e-12)
    assert picked.time == pytest.approx(full.time[::every])


def test_channels_are_kept_on_request_only() -> None:
    bare, run = simulate(duration=0.01, torque_in=False, motion=False), simulate(duration=0.01, forces=True)
    channels = [name for name, values in vars(bare).items() if values is not None and np.ndim(values)]
    assert channels == ["torque_out", "input_angle"]
    np.testing.assert_array_equal(bare.torque_out, run.torque_out)
    assert (run.external_forces.shape, run.internal_forces.shape) == ((256, 2, 16), (256, 2, 8))
    assert run.external_points is run.internal_points is None


def test_filtered_samples_lie_where_the_integration_does() -> None:
    """At 25.6 kHz every 32nd sample falls on a step of the integration: no delay, a scale of 1 to 3e-5."""
    full, filtered = raw(duration=0.4), simulate(duration=0.4)
    assert filtered.torque_out.size == 10_240
    for name in ("torque_out", "torque_in"):
        steps, samples = getattr(full, name)[::125], getattr(filtered, name)[::32]
        assert samples[250:] == pytest.approx(steps[250:], abs=1e-3)


@pytest.mark.parametrize("sampling_rate", [25_600, 6400, 1000, 441.0])
def test_constant_torque_stays_constant_to_the_very_end(sampling_rate: float) -> None:
    """A filter that pads with zeros would end at 13.8 Nm."""
    run = simulate(duration=0.45, sampling_rate=sampling_rate)
    late = run.time > 0.3
    assert np.abs(run.torque_out[late] - 22).max() < 0.05
    assert np.abs(run.torque_in[late] - 1.454).max() < 0.02


def test_load_beyond_nyquist_is_suppressed() -> None:
    """700 Hz at 1 kHz would appear at 300 Hz; picking lets it through, as the papers' every 10th may."""

    def at_300_hz(decimation: str) -> float:
        run = simulate_with(
            duration=0.8,
            sampling_rate=1000,
            decimation=decimation,
            load_fluctuation=lambda t: 2 * np.sin(2 * np.pi * 700 * t),
        )
        torque, window = run.torque_out[300:] - 22, np.hanning(500)
        return 2 * float(np.abs(np.fft.rfft(torque * window))[150]) / window.sum()

    assert at_300_hz("pick") > 1
    assert at_300_hz("antialias") < 1e-3 * at_300_hz("pick")


def test_duration_includes_the_ramp() -> None:
    run = raw(duration=0.3)
    assert run.time[-1] == pytest.approx(0.3 - 1e-5)
    assert run.torque_out[0] == 0
    half = run.torque_out[9_000:11_000]
    assert half.mean() == pytest.approx(11, abs=0.05)
    assert run.input_angle[20_000] == pytest.approx(STEEL.input_speed * 0.1)  # half of a steady drive's
    assert np.diff(run.input_angle[-2:]) == pytest.approx(STEEL.input_speed * 1e-5)
    assert run.torque_out[25_000:].mean() == pytest.approx(22, abs=0.01)
    # The inertia of the wheels on their cams: 2 m e^2 alpha.
    assert run.torque_in[0] == pytest.approx(2.462e-3, rel=1e-3)


def test_start_angle_shifts_the_record() -> None:
    """Once the start has died away; a whole number of pin pitches and turns changes nothing at all."""
    steps = 3000
    ahead = STEEL.input_speed * 1e-5 * steps
    plain = raw(LobeDefects.worn(1), duration=0.6)
    shifted = raw(LobeDefects.worn(1), duration=0.5, start_angle=ahead)
    assert shifted.input_angle[0] == ahead
    settled = slice(30_000, 45_000)
    later = slice(30_000 + steps, 45_000 + steps)
    np.testing.assert_allclose(shifted.torque_out[settled], plain.torque_out[later], rtol=0, atol=1e-8)
    assert np.ptp(plain.torque_out[later]) > 1
    around = raw(LobeDefects.worn(1), duration=0.3, start_angle=30 * np.pi)
    np.testing.assert_allclose(around.torque_out, plain.torque_out[:30_000], rtol=0, atol=1e-8)


def test_load_fluctuation_is_a_number_or_a_function() -> None:
    number = raw(duration=0.3, load_fluctuation=2.0)
    assert same(number, raw(gearbox=STEEL.replace(load_torque=24.0), duration=0.3))
    assert same(number, raw(duration=0.3, load_fluctuation=lambda t: 2.0))
    assert same(number, raw(duration=0.3, load_fluctuation=lambda t: np.full_like(t, 2.0)))
    swell = raw(duration=0.5, load_fluctuation=lambda t: 3 * np.sin(2 * np.pi * 5 * t))
    expected = 22 + 3 * np.sin(2 * np.pi * 5 * swell.time)
    np.testing.assert_allclose(swell.torque_out[22_000:], expected[22_000:], rtol=0, atol=0.06)
    # Under the ramp, like the load.
    ramped = expected[5000:20_000] * swell.time[5000:20_000] / 0.2
    np.testing.assert_allclose(swell.torque_out[5000:20_000], ramped, rtol=0, atol=0.1)


def test_runs_are_the_same_bit_for_bit() -> None:
    def run(worn: int = 3) -> SimulationRun:
        return simulate(STEEL.replace(wheel_runouts=(1e-5j, 0j)), LobeDefects.worn(worn), duration=0.25)

    first = run()
    simulate(STEEL, LobeDefects.removed(2), duration=0.05, start_angle=1.0)  # leaves nothing behind
    assert not same(first, run(7))
    assert same(first, run())


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"duration": 0.0}, "duration must be positive and finite, got 0.0"),
        ({"duration": 1e-9}, "duration 1e-09 s is shorter than one sample at 25600 Hz"),
        ({"dt": -1e-5}, "dt must be positive and finite, got -1e-05"),
        ({"sampling_rate": 2e5}, "sampling_rate must not exceed 1/dt = 100000 Hz, got 200000 Hz"),
        ({"start_angle": float("nan")}, "start_angle must be finite, got nan"),
        ({"decimation": "mean"}, "decimation must be 'antialias' or 'pick', got 'mean'"),
        ({"decimation": "pick"}, "sampling_rate must divide 1/dt = 100000 Hz to pick, got 25600"),
        (
            {"load_fluctuation": lambda t: np.zeros(3)},
            r"load_fluctuation must give one number per time, got shape \(3,\)",
        ),
        ({"speed": lambda t: np.full_like(t, np.nan)}, "speed must be finite, it gave NaN or infinity"),
        ({"integrator": "euler"}, "integrator must be one of 'midpoint', 'adams_bashforth', 'leapfrog', got"),
        ({"defects": LobeDefects.worn((15,))}, r"name lobe 15 \(from 0\), but the wheel has 15 lobes"),
    ],
)
def test_errors_name_what_is_wrong_and_what_is_right(options: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        simulate_with(**{"duration": 0.01, **options})


def test_a_solver_is_more_than_its_integrators_name() -> None:
    with pytest.raises(TypeError, match="solver must be of type Solver, got 'midpoint'"):
        simulate(solver="midpoint")  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"gearbox": Rig.r1()}, "gearbox must be of type CycloidalGearbox, got <Rig"),
        ({"defects": 3}, "defects must be of type LobeDefects, got 3"),
        ({"duration": "1"}, "duration must be a number, got '1'"),
        ({"start_angle": [0.0]}, r"start_angle must be a number, got \[0.0\]"),
        ({"load": np.full(300, 22.0)}, "load must be a number or a function of time that .* got array"),
        ({"speed": lambda t: "fast"}, "speed must be a number .* returns numbers, got 'fast'"),
    ],
)
def test_arguments_of_another_type_are_refused(options: dict, message: str) -> None:
    with pytest.raises(TypeError, match=message):
        simulate_with(**{"duration": 0.01, **options})


@pytest.mark.parametrize(("up", "down"), [(32, 125), (1, 4), (8, 25)])
def test_resampling_leaves_a_constant_torque_constant(up: int, down: int) -> None:
    """Without equal gains of the filter's phases 22 Nm carry a comb of 0.4 mNm at multiples of 800 Hz."""
    from scipy.signal import resample_poly

    from cyclofeat.simulators.simulation import anti_alias_filter

    constant = np.full(400 * max(up, down), 22.0)
    found = resample_poly(constant, up, down, window=anti_alias_filter(up, down))
    inside = found[40:-40]  # away from the ends
    assert np.ptp(inside) < 1e-11
    if up > 1:
        assert np.ptp(resample_poly(constant, up, down)[40:-40]) > 1e-4
