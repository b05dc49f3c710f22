"""Drawn recordings follow from their seeds alone, and share what their seeds share."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from cyclofeat.simulators import (
    BrakeRotor,
    Clearance,
    CycloidalGearbox,
    Drift,
    LobeDefects,
    Noise,
    PinErrors,
    Rig,
    RunOut,
    Scale,
)
from cyclofeat.simulators.machine import MachineRun
from cyclofeat.simulators.sampling import (
    Sample,
    Wear,
    draw_conditions,
    recording_seed,
    sample_each,
    sample_runs,
    vary_errors,
)

RIG = Rig(CycloidalGearbox.steel(ramp_time=0.02), [PinErrors((1e-6, 1e-5)), Noise(0.1)], name="mine")
SEEDS = [recording_seed(3, RIG.name, index) for index in range(3)]
SAMPLE = Sample(
    rig=RIG, defects=LobeDefects.worn(2), duration=0.02, sampling_rate=12_800.0, random_state=SEEDS[0]
)


def test_a_sample_is_what_the_rig_simulates_alone_or_with_others() -> None:
    samples = [dataclasses.replace(SAMPLE, random_state=seed) for seed in SEEDS]
    runs = sample_runs(samples, kernel="exact")
    each = dict(sample_each(samples, lambda place, drawn: drawn.run, kernel="exact", n_jobs=2))
    for place, (run, seed) in enumerate(zip(runs, SEEDS, strict=True)):
        alone = RIG.simulate(SAMPLE.defects, duration=0.02, sampling_rate=12_800.0, random_state=seed)
        for drawn in (run, each[place]):
            assert isinstance(drawn, MachineRun)
            np.testing.assert_array_equal(drawn.record().torque_out, alone.torque_out)


def test_recordings_share_what_their_seeds_share() -> None:
    assembly = recording_seed(4, RIG.name, 0)
    one, other = (dataclasses.replace(SAMPLE, random_state=s, assembly=assembly).plan() for s in SEEDS[:2])
    assert one.machine == other.machine
    assert one.arguments["start_angle"] != other.arguments["start_angle"]
    healthy = dataclasses.replace(SAMPLE, defects=LobeDefects.healthy(), rig=RIG.at(load_nm=11.0)).plan()
    worn = SAMPLE.plan()
    assert healthy.machine.effects == worn.machine.effects
    assert healthy.arguments["start_angle"] == worn.arguments["start_angle"]
    quiet = dataclasses.replace(SAMPLE, rig=RIG.with_effects(Noise(0.0)))
    noisy, still = (run.record().torque_out for run in sample_runs([SAMPLE, quiet], kernel="exact"))
    louder = sample_runs([dataclasses.replace(SAMPLE, rig=RIG.with_effects(Noise(0.2)))], kernel="exact")[0]
    np.testing.assert_allclose(louder.record().torque_out - still, 2 * (noisy - still), atol=1e-9)


def test_a_failure_is_a_result_and_costs_no_other() -> None:
    ringing = RIG.with_added(BrakeRotor(0.02, 1e4, 1e-9)).with_parameters({"gearbox.contact_damping": 0.0})
    samples = [SAMPLE, dataclasses.replace(SAMPLE, rig=ringing), ValueError("no such rig"), SAMPLE]
    first, failed, given, last = sample_runs(samples, kernel="exact")
    assert "must have more damping" in str(failed)
    assert given is samples[2]
    np.testing.assert_array_equal(first.record().torque_out, last.record().torque_out)
    with pytest.raises(ValueError, match="assembly A: .* more damping"):
        dataclasses.replace(samples[1], name="A").plan()


def test_worn_lobes_do_not_depend_on_their_wear() -> None:
    chord, radial = (Wear(lobes="mixed", wear_um=wear).draw(4, 15, SEEDS[0]) for wear in (None, (5.0, 50.0)))
    assert (chord.worn_lobes, chord.wheels) == (radial.worn_lobes, radial.wheels)
    assert 5 <= radial.wear_um <= 50
    assert Wear(wear_um=(20.0, 20.0)).draw(1, 15, SEEDS[0]).wear_um == 20


def test_conditions_are_drawn_and_without_ranges_the_rig_is_itself() -> None:
    assert draw_conditions(RIG, None, None, SEEDS[0]) is RIG
    at = draw_conditions(RIG, (300.0, 600.0), None, SEEDS[0]).gearbox
    assert 300 <= 60 * at.input_speed_hz <= 600
    assert at.load_torque == RIG.gearbox.load_torque


def test_mixed_lobes_are_neighbours_in_half_of_the_assemblies() -> None:
    wear, neighbours = Wear(lobes="mixed"), 0
    for index in range(200):
        worn = set(wear.draw(4, 15, recording_seed(3, "mine", index)).worn_lobes)
        neighbours += any(worn == {(first + k) % 15 for k in range(4)} for first in range(15))
    # one set of four in 91 is a row by chance
    assert 80 <= neighbours <= 122  # 101 +- 7


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
    rig = Rig.r0().replace(gearbox=gearbox, variants=[[Noise(0.1)], [PinErrors(1e-6)], [RunOut(1.8e-4)]])
    hums, ratios = [], []
    for seed in range(200):
        varied = vary_errors(rig, np.random.default_rng(seed), 1000)
        of = {one.effect_id: one for one in varied.effects}
        factor = of["pin_errors"].rms / 10e-6
        assert of["run_out"].runout.mean() == pytest.approx(5e-6 * factor * np.sqrt(np.pi / 2))
        assert varied.variants[1][0].rms == pytest.approx(factor * 1e-6)
        assert varied.variants[2][0].runout == pytest.approx(
            min(factor * 1.8e-4, 2e-4)
        )  # the largest allowed
        ratios.append(varied.variants[0][0].rms_nm / of["noise"].rms_nm)
        hums += [of["hum"].amplitude_nm] if "hum" in of else []
        assert "torque_meter_low_pass" not in of or of["torque_meter_low_pass"].cutoff_hz <= 450
    np.testing.assert_allclose(ratios, 0.5)
    assert 0.014 * 44 / 15 <= min(hums) < max(hums) <= 0.014 * 44
