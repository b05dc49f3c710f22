"""The product says what it said when the golden data were recorded; what they are says ``README.md``."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import golden_cases as cases
import numpy as np
import pytest
from scipy import stats

MEASURED = ("n", "mean", "std", "kurtosis", "min", "max")


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


@pytest.fixture(scope="module")
def counted(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    return cases.counted(tmp_path_factory.mktemp("golden"))


@pytest.mark.parametrize("part", ["exit_codes", "counts", "without the first turn", "for people"])
def test_counts_and_refusals_of_stored_recordings(counted: dict[str, Any], part: str) -> None:
    found, expected = leaves(counted[part]), leaves(stored("counts.json")[part])
    numbers = {place: leaf for place, leaf in expected.items() if isinstance(leaf, float)}
    assert {place: found.get(place) for place in numbers} == pytest.approx(numbers, rel=1e-6, abs=1e-12)
    assert found | numbers == expected


def test_the_stored_counts_are_worth_comparing() -> None:
    counts = stored("counts.json")["counts"]
    known = {name: row for name, row in counts.items() if name.startswith("R") and "no-angle" not in name}
    assert len(known) == 64
    assert sum(row["defect_count"] == int(name.split("-")[1]) for name, row in known.items()) >= 56
    assert sum(bool(row.get("refused")) for row in counts.values()) >= 6
    assert sum("error" in row for row in counts.values()) >= 3


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


def unlike(found: dict[str, Any], expected: dict[str, Any]) -> list[str]:
    """What differs between a column's distribution and the recorded one by more than chance would have it.

    Random numbers may be drawn in another order: means and standard deviations may differ by four standard
    errors, the shares of texts too.
    """
    if found.keys() != expected.keys():
        return [f"{found} for {expected}"]
    if "texts" in expected:
        return _unlike_texts(found["texts"], expected["texts"])
    if found.get("n") != expected.get("n") or not expected["n"]:
        return [f"n {found['n']} for {expected['n']}"] if found["n"] != expected["n"] else []
    n, least = expected["n"], 1e-9 * max(abs(expected["max"]), abs(expected["min"]))
    of_mean = math.sqrt((found["std"] ** 2 + expected["std"] ** 2) / n)
    # The fourth moment tells how much a standard deviation scatters.
    scatter = [one["std"] ** 2 * ((one["kurtosis"] or 1.0) - 1) / (4 * n) for one in (found, expected)]
    of_std = math.sqrt(max(sum(scatter), 0.0))
    return [
        f"{key} {found[key]:.6g} for {expected[key]:.6g}, standard error {error:.3g}"
        for key, error in (("mean", of_mean), ("std", of_std))
        if abs(found[key] - expected[key]) > 4 * error + least
    ]


def _unlike_texts(found: Any, expected: Any) -> list[str]:
    if isinstance(expected, str) or isinstance(found, str):
        return [] if found == expected else [f"{found} for {expected}"]
    if found.keys() != expected.keys():
        return [f"{sorted(found)} for {sorted(expected)}"]
    n = sum(expected.values())
    if sum(found.values()) != n:
        return [f"{sum(found.values())} texts for {n}"]
    shares = {key: (found[key] + expected[key]) / (2 * n) for key in expected}
    return [
        f"{key!r} {found[key]} times for {expected[key]}"
        for key, share in shares.items()
        if abs(found[key] - expected[key]) > 4 * math.sqrt(2 * n * share * (1 - share))
    ]


@pytest.mark.slow
def test_a_campaigns_columns_and_distributions(tmp_path: Path) -> None:
    said, columns = cases.campaign(tmp_path)
    expected = stored("campaign.json")
    assert said == expected["said"]
    assert list(columns) == list(expected["columns"])
    found = {
        name: unlike(cases.described(values), expected["columns"][name]) for name, values in columns.items()
    }
    assert not any(found.values()), {name: texts for name, texts in found.items() if texts}


def test_distributions_that_differ_are_found() -> None:
    random = np.random.default_rng(1)
    values = random.uniform(1.0, 2.0, 32)
    recorded = cases.described(values)
    assert set(recorded) == set(MEASURED)
    assert unlike(cases.described(random.uniform(1.0, 2.0, 32)), recorded) == []
    for other in (values + 0.5, 2 * values - 1.5, values[:31]):
        assert len(unlike(cases.described(other), recorded)) == 1
    constant = cases.described(np.full(32, 3.0))
    assert unlike(constant, constant) == []
    assert len(unlike(cases.described(np.full(32, 3.001)), constant)) == 1
    texts = cases.described(np.array(["ok"] * 16 + ["worn"] * 16))
    assert unlike(cases.described(np.array(["ok"] * 20 + ["worn"] * 12)), texts) == []
    for some in (["ok"] * 32, ["ok"] * 31 + ["worn"], ["ok"] * 16 + ["new"] * 16):
        assert unlike(cases.described(np.array(some)), texts) != []


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


def as_often(right: int, recorded: int, n: int) -> bool:
    """Whether two shares of n may come from one probability: Fisher's exact test at 0.1 %.

    Both are samples: the one recorded, and the one of assemblies drawn anew.
    """
    table = [[right, n - right], [recorded, n - recorded]]
    return bool(stats.fisher_exact(table).pvalue > 1e-3)


def test_shares_that_differ_are_found() -> None:
    assert as_often(31, 32, 32)
    assert as_often(60, 50, 192)
    assert not as_often(20, 32, 32)
    assert not as_often(20, 50, 192)
    assert not as_often(180, 192, 192)


@pytest.mark.slow
def test_the_demonstration_is_right_as_often(tmp_path: Path) -> None:
    found, expected = cases.demo(tmp_path / "demo"), stored("demo.json")
    for key in ("n_files", "n_assemblies"):
        assert found[key] == expected[key]
    for key in ("counts_right", "lobes_right"):
        assert as_often(found[key], expected[key], expected["n_files"]), (key, found[key], expected[key])
    assert found["accuracy"].keys() == expected["accuracy"].keys()
    n = expected["n_assemblies"]
    for name, accuracy in expected["accuracy"].items():
        here = found["accuracy"][name]
        assert as_often(round(here * n), round(accuracy * n), n), (name, here, accuracy)
