"""Which posterior a model gets: the packaged one, or one that is learned once and kept."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cyclofeat.gap import EffectPosterior, World, find_gap, load_posterior
from cyclofeat.gap.posterior import of_model
from cyclofeat.gap.posterior.of_model import covers_world, posterior_of_world
from cyclofeat.recordings import Recording
from cyclofeat.simulators import Hum, Noise, Rig

GEARBOX = Rig().gearbox


def test_the_packaged_posterior_serves_the_default_model_where_it_has_learned() -> None:
    assert covers_world(load_posterior(), World())
    # Recordings at 350 RPM make a world from 315 RPM on, at 350 / 0.9 RPM one from 350 RPM on.
    assert covers_world(load_posterior(), World(speeds_rpm=(315, 770), loads_nm=(9, 33)))
    assert posterior_of_world(World(speeds_rpm=(450, 550))).n_rigs_ == load_posterior().n_rigs_


OTHERS = {
    "rig": Rig(effects=[Hum(0.1)]),
    "quantity": "input_torque",
    "sampling_rate": 10_000.0,
    "speeds_rpm": (200.0, 500.0),
    "loads_nm": (20.0, 60.0),
    "defect_counts": range(10),
}


@pytest.mark.parametrize("name", OTHERS)
def test_it_serves_no_other_world(name: str) -> None:
    assert not covers_world(
        load_posterior(), dataclasses.replace(World(), effects=None, **{name: OTHERS[name]})
    )


@pytest.fixture
def learned(monkeypatch: pytest.MonkeyPatch) -> list[dict[str, Any]]:
    """What is simulated and learned, instead of doing so."""
    calls: list[dict[str, Any]] = []

    def prepare(world: World, folder: Path, n_machines: int, **options: Any) -> World:
        Path(folder).mkdir(parents=True)
        return world

    def fit(self: EffectPosterior, rigs: World, **options: Any) -> EffectPosterior:
        calls.append({"world": rigs, "start": options["start"]})
        return load_posterior()

    monkeypatch.setattr(of_model, "prepare_world", prepare)
    monkeypatch.setattr(EffectPosterior, "fit", fit)
    return calls


def test_another_posterior_is_learned_once_and_kept(learned: list[dict[str, Any]], tmp_path: Path) -> None:
    told: list[str] = []
    world = World(rig=Rig(GEARBOX.replace(n_pins=12), effects=[Noise(0.1)]), quantity="input_torque")
    for _ in range(2):
        posterior_of_world(world, cache=tmp_path, progress=told.append)
    assert [call["world"] for call in learned] == [world]
    # Of another gearbox and the other torque: what the packaged networks know is the beginning.
    assert learned[0]["start"].names_ == load_posterior().names_
    assert [path.suffix for path in tmp_path.iterdir()] == [".npz"]
    assert len(told) == 2
    assert "ten minutes" in told[0]
    # Fewer bands: networks of their own.
    posterior_of_world(dataclasses.replace(world, sampling_rate=6400.0), cache=tmp_path)
    assert learned[1]["start"] is None


def test_without_jax_nothing_is_simulated(
    learned: list[dict[str, Any]], monkeypatch: Any, tmp_path: Path
) -> None:
    def fail() -> None:
        raise ImportError("training a network needs JAX and Optax: pip install jax optax")

    monkeypatch.setattr(of_model, "import_jax", fail)
    with pytest.raises(
        ImportError, match=r"is for .* output torque, 25600 Hz, 350 to 700 RPM .* pip install jax"
    ):
        posterior_of_world(World(quantity="input_torque"), cache=tmp_path)
    assert not [*tmp_path.iterdir()]


def test_a_posterior_of_another_model_is_refused() -> None:
    torque = np.random.default_rng(0).normal(22, 0.1, 51_200)
    recordings = [Recording(torque, 25_600, speed_rpm=500, load_nm=22) for _ in range(2)]
    with pytest.raises(
        ValueError, match="posterior must have been learned from model, got one of another rig"
    ):
        find_gap(recordings, model=Rig(effects=[Hum(0.1)]), posterior=load_posterior())


def test_it_is_kept_in_the_user_s_cache(
    learned: list[dict[str, Any]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    posterior_of_world(World(quantity="input_torque"))
    assert [path.parent for path in tmp_path.rglob("*.npz")] == [tmp_path / "cyclofeat"]
