"""The measured vibration lies in the source tree only, is labelled, and says what is not known of it."""

from __future__ import annotations

import csv
import tomllib
from pathlib import Path

import numpy as np
import pytest

from cyclofeat.datasets import load_oedi_gearbox

ROOT = Path(__file__).parents[2]
MINI = ROOT / "datasets" / "oedi_gearbox" / "oedi_gearbox_mini_8192.npz"


@pytest.fixture(scope="module")
def data():
    return load_oedi_gearbox()


def test_two_states_at_ten_load_levels(data):
    assert data.signals.shape == (20, 8_192, 4)
    assert data.signals.dtype == np.float64
    pairs = set(zip(data.broken_tooth.tolist(), data.load_percent.tolist(), strict=True))
    assert pairs == {(broken, load) for broken in (0, 1) for load in range(0, 100, 10)}
    assert data.channel_names == ["a1", "a2", "a3", "a4"]
    for name, broken, load in zip(data.recording_names, data.broken_tooth, data.load_percent, strict=True):
        assert name == f"{'hb'[broken]}30hz{load}"


def test_labels_agree_with_the_list_of_recordings(data):
    with (MINI.parent / "recordings.csv").open(encoding="utf-8", newline="") as file:
        listed = list(csv.DictReader(file))
    assert [row["recording"] for row in listed] == data.recording_names
    assert [int(row["broken_tooth"]) for row in listed] == data.broken_tooth.tolist()
    assert [int(row["load_percent"]) for row in listed] == data.load_percent.tolist()


def test_signals_are_scaled_to_the_unit_supplied(data):
    steps = data.signals / 0.004
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-6)
    assert 40 < np.abs(data.signals).max() < 60
    assert np.all(data.signals.std(axis=1) > 0.5)


def test_the_mesh_line_bears_out_the_inferred_rate(data):
    # 32 teeth at the shaft's nominal 30 Hz, less the motor's slip
    assert data.sampling_rate == 12_800.0
    assert data.sampling_rate_inferred
    assert data.shaft_hz == 30.0
    spectrum = np.abs(np.fft.rfft(data.signals[..., 0] * np.hanning(8_192), axis=1))
    hertz = np.fft.rfftfreq(8_192, 1 / data.sampling_rate)
    near = (hertz > 32 * 28) & (hertz < 32 * 31)
    shaft = hertz[near][spectrum[:, near].argmax(axis=1)] / 32
    assert np.all((shaft > 29.4) & (shaft < 29.9))


def test_the_description_gives_origin_licence_and_caveats(data):
    for words in ("Pandya", "submissions/623", "CC BY 4.0", "not confirmed", "inferred", "no torque channel"):
        assert words in data.DESCR


def test_a_wheel_leaves_the_recordings_out():
    package_data = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["setuptools"][
        "package-data"
    ]
    assert [name for name in package_data["cyclofeat.datasets"] if "oedi" in name] == [
        "oedi_gearbox/README.md"
    ]


def test_a_file_can_be_named(data):
    np.testing.assert_array_equal(load_oedi_gearbox(MINI).signals, data.signals)


def test_plain_signals_of_any_length_are_read_too(tmp_path, data):
    with np.load(MINI) as archive:
        arrays = {name: archive[name] for name in archive.files if name not in ("signals_i16", "scale")}
    arrays["signals"] = np.repeat(data.signals.astype(np.float32), 2, axis=1)
    np.savez(tmp_path / "long.npz", **arrays)
    found = load_oedi_gearbox(path=str(tmp_path / "long.npz"))
    assert found.signals.shape == (20, 16_384, 4)
    assert found.signals.dtype == np.float64
    np.testing.assert_allclose(found.signals[:, ::2], data.signals, rtol=1e-6)
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
