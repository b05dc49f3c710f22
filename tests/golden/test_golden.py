"""The product says what it said when the golden data were recorded; what they are says ``README.md``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import golden_cases as cases
import numpy as np
import pytest


def stored(name: str) -> Any:
    return json.loads((cases.HERE / name).read_text(encoding="utf-8"))


def leaves(value: Any, at: str = "") -> dict[str, Any]:
    """Numbers and texts of nested dicts and lists, by their places."""
    if not isinstance(value, (dict, list)):
        return {at: value}
    if not value:
        return {at: repr(value)}
    parts = value.items() if isinstance(value, dict) else enumerate(value)
    return {place: leaf for key, part in parts for place, leaf in leaves(part, f"{at}/{key}").items()}


def assert_alike(value: Any, recorded: Any) -> None:
    """Texts and whole numbers are equal, other numbers to rounding."""
    found, expected = leaves(value), leaves(recorded)
    numbers = {place: leaf for place, leaf in expected.items() if isinstance(leaf, float)}
    assert {place: found.get(place) for place in numbers} == pytest.approx(numbers, rel=1e-6, abs=1e-12)
    assert found | numbers == expected


@pytest.fixture(scope="module")
def counted(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    return cases.counted(tmp_path_factory.mktemp("golden"))


@pytest.mark.parametrize("part", ["exit_codes", "counts", "without the first turn", "for people"])
def test_counts_and_refusals_of_stored_recordings(counted: dict[str, Any], part: str) -> None:
    assert_alike(counted[part], stored("counts.json")[part])


@pytest.fixture(scope="module")
def feature_values() -> dict[str, np.ndarray]:
    return cases.feature_values()


@pytest.mark.parametrize("name", cases.features.__all__)
def test_feature_values(feature_values: dict[str, np.ndarray], name: str) -> None:
    with np.load(cases.HERE / "features.npz") as recorded:
        assert feature_values[f"{name}.names"].tolist() == recorded[f"{name}.names"].tolist()
        expected = recorded[name]
    assert feature_values[name].shape == expected.shape
    # Numbers near zero are what is left of large ones: held against the largest of their column.
    largest = np.abs(expected).max(axis=0)
    assert (np.abs(feature_values[name] - expected) <= 1e-9 * (np.abs(expected) + largest)).all()


def test_every_stored_feature_still_exists() -> None:
    with np.load(cases.HERE / "features.npz") as recorded:
        assert {name.removesuffix(".names") for name in recorded.files} == set(cases.features.__all__)


@pytest.fixture(scope="module")
def simulated() -> dict[str, np.ndarray]:
    return cases.simulated()


@pytest.mark.parametrize("machine", list(cases.machines()))
@pytest.mark.parametrize("kind", ["torque_out", "torque_in"])
def test_simulated_torque(simulated: dict[str, np.ndarray], machine: str, kind: str) -> None:
    with np.load(cases.HERE / "simulation.npz") as recorded:
        expected = recorded[f"{machine}.{kind}"]
    # In single precision; of torque that passes through zero against its largest value.
    largest = float(np.abs(expected).max())
    assert largest > 1.0
    np.testing.assert_allclose(simulated[f"{machine}.{kind}"], expected, rtol=1e-5, atol=1e-6 * largest)


@pytest.mark.slow
def test_a_campaigns_columns(tmp_path: Path) -> None:
    said, columns = cases.campaign(tmp_path)
    described = {name: cases.described(values) for name, values in columns.items()}
    assert_alike({"said": said, "columns": described}, stored("campaign.json"))


@pytest.mark.slow
def test_what_is_trained_on_the_stored_recordings(tmp_path: Path) -> None:
    """Trees are grown from random numbers of scikit-learn, which differ between its versions."""
    found, expected = cases.trained(tmp_path), stored("training.json")
    assert found["card"] == expected["card"]
    assert found["counts"].keys() == expected["counts"].keys()
    names = list(expected["counts"])
    here, there = (
        np.array([list(one["counts"][name].values()) for name in names]) for one in (found, expected)
    )
    assert np.abs(here - there).max() < 0.3
    assert np.abs(here - there).mean() < 0.03
    assert np.mean(here.argmax(axis=1) == there.argmax(axis=1)) >= 0.9
    assert found["evaluated"].keys() == expected["evaluated"].keys()
    for name, scores in expected["evaluated"].items():
        assert found["evaluated"][name]["accuracy"] == pytest.approx(scores["accuracy"], abs=0.08), name
        error = scores["mean_absolute_error"]
        assert found["evaluated"][name]["mean_absolute_error"] == pytest.approx(error, abs=0.25), name
