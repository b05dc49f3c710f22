"""What the tests of the gap workflow share: short records, one folder of simulations."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import pytest
from short_records import GEARBOX, SPEED, Recorder, short
from sklearn.ensemble import ExtraTreesClassifier

from cyclofeat.gap import Bank
from cyclofeat.gap.simulations import Population, as_rig
from cyclofeat.simulators import CycloidalGearbox, Effect, Rig


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
        rig = as_rig(base or GEARBOX).with_added(*effects)
        # The nominal speed of the comparisons, whatever that of the rig.
        comparison = short(rig=rig, input_speed_hz=SPEED, cache=simulations)
        return comparison.bank(n, counts, random_state=seed)

    return record


@pytest.fixture(scope="module")
def few_trees():
    """Effects are named by a tenth of the trees, in a tenth of the time."""
    fit = ExtraTreesClassifier.fit
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            ExtraTreesClassifier, "fit", lambda self, X, y: fit(self.set_params(n_estimators=40), X, y)
        )
        yield


@pytest.fixture(autouse=True, scope="session")
def _machines_once():
    """Fits of effects on the torque ask for the same runs of the machine, from the same seeds: made once."""
    real, made = Population.run_machine, {}

    def run_machine(self, count, random_state, assembly=None, spare=0.0):
        if assembly is not None:
            return real(self, count, random_state, assembly, spare)
        key = (self.text, count, str(random_state.entropy), random_state.spawn_key, spare)
        if key not in made:
            made[key] = real(self, count, random_state, spare=spare)
        return made[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Population, "run_machine", run_machine)
        yield
