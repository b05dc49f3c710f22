"""Published tables and measured data reach the user in SI units, with origin and licence."""

from __future__ import annotations

import csv
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

from cyclofeat.datasets import load_jelmerv_cycloidal, load_oedi_gearbox, load_published_tables
from cyclofeat.simulators import CycloidalGearbox

ROOT = Path(__file__).parents[2]
CURVES = ROOT / "datasets" / "jelmerv_cycloidal" / "jelmerv_cycloidal_curves.npz"
MINI = ROOT / "datasets" / "oedi_gearbox" / "oedi_gearbox_mini_8192.npz"


# -- Published tables


def test_tables_have_one_row_per_disc_and_agree_with_each_other():
    tables = load_published_tables()
    names = {"signal_statistics", "spectral_centroid", "spectral_entropy"}
    assert set(tables) == names | {"DESCR"}
    assert all(tables[name]["defect_count"].tolist() == list(range(8)) for name in names)
    found = tables.signal_statistics
    assert found.dtype.names == ("defect_count", "min_nm", "max_nm", "mean_nm", "std_nm", "range_nm")
    # printed to four digits
    np.testing.assert_allclose(found["range_nm"], found["max_nm"] - found["min_nm"], atol=0.011)
    assert np.all((found["min_nm"] < found["mean_nm"]) & (found["mean_nm"] < found["max_nm"]))
    assert np.all(found["std_nm"] < found["range_nm"] / 2)
    entropy = tables.spectral_entropy["entropy_bits"]
    assert np.all(np.diff(entropy[1:]) < 0)  # falls from one to seven worn lobes
    assert found["std_nm"].argmin() == entropy.argmin() == 0  # the healthy disc
    assert entropy[[0, 7]].tolist() == [1.6838, 1.7241]


# -- Loops of printed drives


@pytest.fixture(scope="module")
def jelmerv():
    return load_jelmerv_cycloidal()


def test_every_array_of_the_file_is_handed_over_once_in_si_units(jelmerv):
    with np.load(CURVES) as archive:
        arrays = dict(archive)
    assert len(jelmerv.loops) + len(jelmerv.run_in) == len(arrays) == 31
    for loop in jelmerv.loops:
        raw = arrays[loop.name]
        assert loop.name == f"{loop.kind}_{loop.design}_{loop.state}"
        np.testing.assert_array_equal(loop.torque, raw[:, 0].astype(float))
        np.testing.assert_allclose(np.rad2deg(loop.deflection), raw[:, 1], rtol=1e-12)
    for record in jelmerv.run_in:
        raw = arrays[f"runin_torque_{record.design}"]
        np.testing.assert_allclose(record.time / 60, raw[:, 0], rtol=1e-12)
        np.testing.assert_array_equal(record.torque, raw[:, 1].astype(float))


def test_loops_are_of_the_size_that_the_source_states(jelmerv):
    assert {loop.kind for loop in jelmerv.loops} == {"play", "stiffness"}
    assert {loop.design for loop in jelmerv.loops} == {"baseline", "split_pinwheel", "conic_disk"}
    for loop in jelmerv.loops:
        peak = np.abs(loop.torque).max()
        assert (3 < peak < 5) if loop.kind == "play" else (24 < peak < 41)
        if loop.kind == "stiffness":
            assert np.corrcoef(loop.torque, loop.deflection)[0, 1] > 0.9
    width = {loop.name: np.ptp(loop.deflection) for loop in jelmerv.loops}
    for design in ("baseline", "split_pinwheel", "conic_disk"):  # run-in wears the drive: more play
        assert width[f"play_{design}_after_runin"] > width[f"play_{design}_initial"]
    # 25 Nm give about 4.5 deg
    loop = next(loop for loop in jelmerv.loops if loop.name == "stiffness_baseline_initial")
    near = np.abs(loop.torque - 24.5) < 0.5
    assert np.rad2deg(loop.deflection[near]).mean() == pytest.approx(4.5, abs=1.0)
    assert all(80 * 60 < record.time[-1] < 93 * 60 for record in jelmerv.run_in)


def test_the_geometry_is_that_of_the_simulators_printed_drive(jelmerv):
    gearbox = CycloidalGearbox.printed_14_pin()
    geometry = jelmerv.geometry
    assert (gearbox.n_pins, gearbox.n_pins - 1) == (geometry.n_pins, geometry.n_lobes)
    assert gearbox.eccentricity == geometry.eccentricity
    # shortening m = e z_k / R
    assert gearbox.shortening == pytest.approx(
        geometry.eccentricity * geometry.n_pins / geometry.pin_circle_radius
    )


# -- Vibration of another gearbox


@pytest.fixture(scope="module")
def oedi():
    return load_oedi_gearbox()


def test_two_states_at_ten_load_levels(oedi):
    assert oedi.signals.shape == (20, 8_192, 4)
    assert oedi.signals.dtype == np.float64
    assert oedi.channel_names == ["a1", "a2", "a3", "a4"]
    states = zip(oedi.broken_tooth.tolist(), oedi.load_percent.tolist(), strict=True)
    named = [(name, *state) for name, state in zip(oedi.recording_names, states, strict=True)]
    both = [(f"{'hb'[broken]}30hz{load}", broken, load) for broken in (0, 1) for load in range(0, 100, 10)]
    assert sorted(named) == sorted(both)
    with (MINI.parent / "recordings.csv").open(encoding="utf-8", newline="") as file:
        listed = csv.DictReader(file)
        assert named == [(x["recording"], int(x["broken_tooth"]), int(x["load_percent"])) for x in listed]


def test_signals_are_scaled_to_the_unit_supplied(oedi):
    steps = oedi.signals / 0.004
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-6)
    assert 40 < np.abs(oedi.signals).max() < 60
    assert np.all(oedi.signals.std(axis=1) > 0.5)


def test_the_mesh_line_bears_out_the_inferred_rate(oedi):
    # 32 teeth at the shaft's nominal 30 Hz, less the motor's slip
    assert oedi.sampling_rate == 12_800.0
    assert oedi.sampling_rate_inferred
    assert oedi.shaft_hz == 30.0
    spectrum = np.abs(np.fft.rfft(oedi.signals[..., 0] * np.hanning(8_192), axis=1))
    hertz = np.fft.rfftfreq(8_192, 1 / oedi.sampling_rate)
    near = (hertz > 32 * 28) & (hertz < 32 * 31)
    shaft = hertz[near][spectrum[:, near].argmax(axis=1)] / 32
    assert np.all((shaft > 29.4) & (shaft < 29.9))


def test_plain_signals_of_any_length_are_read_too(tmp_path, oedi):
    with np.load(MINI) as archive:
        arrays = {name: archive[name] for name in archive.files if name not in ("signals_i16", "scale")}
    arrays["signals"] = np.repeat(oedi.signals.astype(np.float32), 2, axis=1)
    np.savez(tmp_path / "long.npz", **arrays)
    found = load_oedi_gearbox(path=str(tmp_path / "long.npz"))
    assert found.signals.shape == (20, 16_384, 4)
    assert found.signals.dtype == np.float64
    np.testing.assert_allclose(found.signals[:, ::2], oedi.signals, rtol=1e-6)
    assert "Pandya" in found.DESCR


def test_other_files_are_errors(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"no such file: .*missing.npz.*submissions/623"):
        load_oedi_gearbox(tmp_path / "missing.npz")
    with pytest.raises(ValueError, match="is a directory"):
        load_oedi_gearbox(tmp_path)
    with pytest.raises(TypeError, match="path must be a file name, got 3"):
        load_oedi_gearbox(3)
    (tmp_path / "half.npz").write_bytes(MINI.read_bytes()[:500_000])
    with pytest.raises(ValueError, match=r"half.npz is damaged"):
        load_oedi_gearbox(tmp_path / "half.npz")
    with (tmp_path / "array.npz").open("wb") as file:
        np.save(file, np.zeros(3))
    with pytest.raises(ValueError, match=r"array.npz is a single array"):
        load_oedi_gearbox(tmp_path / "array.npz")
    np.savez(tmp_path / "other.npz", signals=np.zeros((2, 10, 4)))
    with pytest.raises(ValueError, match=r"other.npz must hold the arrays.*missing: broken_tooth, channels"):
        load_oedi_gearbox(tmp_path / "other.npz")
    with np.load(MINI) as archive:
        arrays = dict(archive)
    np.savez(tmp_path / "flat.npz", **(arrays | {"signals_i16": arrays["signals_i16"][0]}))
    with pytest.raises(ValueError, match=r"shape \(20, n_samples, 4\).*got \(8192, 4\)"):
        load_oedi_gearbox(tmp_path / "flat.npz")


# -- All


def test_data_sets_describe_themselves_in_one_form_and_wheels_leave_the_vibration_out():
    words = {
        load_published_tables: (
            "Verification of the cycloidal gear train fault diagnosis methods", "recording per disc", "Nm",
        ),
        load_jelmerv_cycloidal: (
            "CC BY-SA 4.0", "JelmerV", "Anti-Backlash-Cycloidal-Actuator", "78d6dacc",
        ),
        load_oedi_gearbox: (
            "Pandya", "submissions/623", "CC BY 4.0", "not confirmed", "nferred", "no torque channel",
        ),
    }  # fmt: skip
    for load, expected in words.items():
        text = " ".join(load().DESCR.split())
        assert [word for word in expected if word not in text] == []
        heads = re.findall(r"^(Origin|Licence|Units|Inferred): ", load().DESCR, flags=re.MULTILINE)
        assert heads == ["Origin", "Licence", "Units", "Inferred"]
    licence = (CURVES.parent / "LICENSE.md").read_text(encoding="utf-8")
    assert all(word in licence for word in words[load_jelmerv_cycloidal])
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["setuptools"]
    patterns = settings["package-data"]["cyclofeat.datasets"]
    assert "jelmerv_cycloidal/*" in patterns
    assert [pattern for pattern in patterns if "oedi" in pattern] == ["oedi_gearbox/README.md"]
