"""Measured loops: what the file says reaches the user in SI units, with licence and attribution."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

from cyclofeat.datasets import load_jelmerv_cycloidal, load_oedi_gearbox, load_published_tables
from cyclofeat.simulators import CycloidalGearbox

ROOT = Path(__file__).parents[2]
FILE = ROOT / "datasets" / "jelmerv_cycloidal" / "jelmerv_cycloidal_curves.npz"


@pytest.fixture(scope="module")
def data():
    return load_jelmerv_cycloidal()


def test_every_array_of_the_file_is_handed_over_once_in_si_units(data):
    with np.load(FILE) as archive:
        arrays = dict(archive)
    assert len(data.loops) + len(data.run_in) == len(arrays) == 31
    for loop in data.loops:
        raw = arrays[loop.name]
        assert loop.name == f"{loop.kind}_{loop.design}_{loop.state}"
        np.testing.assert_array_equal(loop.torque, raw[:, 0].astype(float))
        np.testing.assert_allclose(np.rad2deg(loop.deflection), raw[:, 1], rtol=1e-12)
    for record in data.run_in:
        raw = arrays[f"runin_torque_{record.design}"]
        np.testing.assert_allclose(record.time / 60, raw[:, 0], rtol=1e-12)
        np.testing.assert_array_equal(record.torque, raw[:, 1].astype(float))


def test_loops_are_of_the_size_that_the_source_states(data):
    assert {loop.kind for loop in data.loops} == {"play", "stiffness"}
    assert {loop.design for loop in data.loops} == {"baseline", "split_pinwheel", "conic_disk"}
    for loop in data.loops:
        peak = np.abs(loop.torque).max()
        assert (3 < peak < 5) if loop.kind == "play" else (24 < peak < 41)
        if loop.kind == "stiffness":
            assert np.corrcoef(loop.torque, loop.deflection)[0, 1] > 0.9
    width = {loop.name: np.ptp(loop.deflection) for loop in data.loops}
    for design in ("baseline", "split_pinwheel", "conic_disk"):  # run-in wears the drive: more play
        assert width[f"play_{design}_after_runin"] > width[f"play_{design}_initial"]
    # 25 Nm give about 4.5 deg
    loop = next(loop for loop in data.loops if loop.name == "stiffness_baseline_initial")
    near = np.abs(loop.torque - 24.5) < 0.5
    assert np.rad2deg(loop.deflection[near]).mean() == pytest.approx(4.5, abs=1.0)
    assert all(80 * 60 < record.time[-1] < 93 * 60 for record in data.run_in)


def test_the_geometry_is_that_of_the_simulators_printed_drive(data):
    gearbox = CycloidalGearbox.printed_14_pin()
    geometry = data.geometry
    assert (gearbox.n_pins, gearbox.n_pins - 1) == (geometry.n_pins, geometry.n_lobes)
    assert gearbox.eccentricity == geometry.eccentricity
    # shortening m = e z_k / R
    assert gearbox.shortening == pytest.approx(
        geometry.eccentricity * geometry.n_pins / geometry.pin_circle_radius
    )


def test_licence_and_attribution_lie_beside_the_file_and_in_the_wheel(data):
    licence = (FILE.parent / "LICENSE.md").read_text(encoding="utf-8")
    for words in ("CC BY-SA 4.0", "JelmerV", "Anti-Backlash-Cycloidal-Actuator", "78d6dacc"):
        assert words in licence
        assert words in data.DESCR
    patterns = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["setuptools"][
        "package-data"
    ]
    assert "jelmerv_cycloidal/*" in patterns["cyclofeat.datasets"]


@pytest.mark.parametrize("load", [load_jelmerv_cycloidal, load_oedi_gearbox, load_published_tables])
def test_all_data_sets_describe_themselves_in_one_form(load):
    heads = re.findall(r"^(Origin|Licence|Units|Inferred): ", load().DESCR, flags=re.MULTILINE)
    assert heads == ["Origin", "Licence", "Units", "Inferred"]
