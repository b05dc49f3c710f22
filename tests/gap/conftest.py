"""What the tests of the gap workflow share: short records, one folder of simulations."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import pytest
from short_records import BASE, GEARBOX, SPEED, Recorder, short

from cyclofeat.gap import Comparison
from cyclofeat.gap.simulations import Bank
from cyclofeat.simulators import CycloidalGearbox, Effect, Rig


@pytest.fixture(scope="session")
def simulations(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of simulations, one for all processes of a run of the tests."""
    base = tmp_path_factory.getbasetemp()
    folder = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "simulations"
    folder.mkdir(exist_ok=True)
    return folder


@pytest.fixture
def comparison(simulations: Path) -> Comparison:
    return short(rig=BASE, n_bank=40, cache=simulations)


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
        base = GEARBOX if base is None else base
        rig = (base if isinstance(base, Rig) else Rig(base)).with_added(*effects)
        # The nominal speed of the comparisons, whatever that of the rig.
        comparison = short(rig=rig, input_speed_hz=SPEED, cache=simulations)
        return comparison.bank(n, counts, random_state=seed)

    return record
