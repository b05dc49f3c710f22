"""Rigs whose errors vary between assemblies."""

from __future__ import annotations

import numpy as np
import pytest

from cyclofeat.simulators import BrakeRotor, Clearance, CycloidalGearbox, Drift, Noise, PinErrors, Rig, Scale
from cyclofeat.simulators.variation import vary_errors


def test_errors_reach_from_none_to_half_as_much_again_and_the_rest_stays() -> None:
    brake, load = BrakeRotor(0.02, 1e4, 0.02), Scale("load", (0.97, 1.03))
    rig = Rig(effects=[PinErrors(10e-6), Clearance((1e-5, 2e-5)), Drift(3.0, 1.5), Noise(0.2), brake, load])
    random = np.random.default_rng(0)
    of = [{one.effect_id: one for one in vary_errors(rig, random, 25_600).effects} for _ in range(400)]
    pins = np.array([effects["pin_errors"].rms for effects in of])
    noise = np.array([effects["noise"].rms_nm for effects in of])
    drift = np.array([effects["load_drift"].rms_nm for effects in of])
    assert (pins.min(), pins.max()) == (pytest.approx(0, abs=2e-7), pytest.approx(15e-6, rel=0.02))
    assert (noise.min(), noise.max()) == (pytest.approx(0.02, rel=0.05), pytest.approx(0.3, rel=0.05))
    assert (drift.min(), drift.max()) == (pytest.approx(0, abs=0.05), pytest.approx(4.5, rel=0.02))
    # One factor for all errors of the geometry, another one for drift.
    clearance = np.array([effects["clearance"].clearance for effects in of])
    np.testing.assert_allclose(clearance, np.outer(pins, [1, 2]))
    assert abs(np.corrcoef(pins, drift)[0, 1]) < 0.2
    assert all(effects["brake_rotor"] == brake and effects["load_scale"] == load for effects in of)
    for name in ("hum", "sensor_drift", "offset", "gain", "torque_meter_low_pass"):
        assert np.mean([name in effects for effects in of]) == pytest.approx(1 / 8, abs=0.05)


def test_distributions_and_variants_are_scaled_and_sizes_follow_the_load() -> None:
    gearbox = CycloidalGearbox.steel().replace(load_torque=44.0)
    rig = Rig.r0().replace(gearbox=gearbox, variants=[[Noise(0.1)], [PinErrors(1e-6)]])
    hums, ratios = [], []
    for seed in range(200):
        varied = vary_errors(rig, np.random.default_rng(seed), 1000)
        of = {one.effect_id: one for one in varied.effects}
        factor = of["pin_errors"].rms / 10e-6
        assert of["run_out"].runout.mean() == pytest.approx(5e-6 * factor * np.sqrt(np.pi / 2))
        assert varied.variants[1][0].rms == pytest.approx(factor * 1e-6)
        ratios.append(varied.variants[0][0].rms_nm / of["noise"].rms_nm)
        hums += [of["hum"].amplitude_nm] if "hum" in of else []
        assert "torque_meter_low_pass" not in of or of["torque_meter_low_pass"].cutoff_hz <= 450
    np.testing.assert_allclose(ratios, 0.5)
    assert 0.014 * 44 / 15 <= min(hums) < max(hums) <= 0.014 * 44
