"""What the tests of the gap workflow share: short records, one folder of simulations."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import pytest
from short_records import N_SAMPLES, RATE, Recorder

from cyclofeat.gap import Bank, NuisancePrior, _fit_model, make_bank
from cyclofeat.simulators import CompositeSimulator, CycloidalGearbox, Effect, Rig


@pytest.fixture(scope="session")
def simulations(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of simulations, one for all processes of a run of the tests."""
    base = tmp_path_factory.getbasetemp()
    folder = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "simulations"
    folder.mkdir(exist_ok=True)
    return folder


@pytest.fixture(scope="session")
def recorded(simulations: Path) -> Recorder:
    """Recordings of a gearbox or rig with effects in it, in the place of measured ones."""

    def record(
        effects: Sequence[Effect] = (),
        counts: Sequence[int] = (0, 3),
        n: int = 6,
        seed: int = 101,
        base: CycloidalGearbox | Rig | None = None,
    ) -> Bank:
        return make_bank(
            CompositeSimulator(base, effects), NuisancePrior(), counts, n=n, n_samples=N_SAMPLES,
            sampling_rate=RATE, random_state=seed, cache=simulations,
        )  # fmt: skip

    return record


@pytest.fixture(autouse=True, scope="session")
def _machines_once():
    """Fits of effects on the torque ask for the same runs of the machine, from the same seeds: made once."""
    real, made = _fit_model.machine, {}

    def machine(simulator, nuisance, count, n_samples, rate, seed, **options):
        rig = simulator.to_rig().to_text()
        key = (
            rig,
            repr(nuisance),
            count,
            n_samples,
            rate,
            str(seed.entropy),
            seed.spawn_key,
            *options.items(),
        )
        if key not in made:
            made[key] = real(simulator, nuisance, count, n_samples, rate, seed, **options)
        return made[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(_fit_model, "machine", machine)
        yield
