"""Many runs at once are the runs one by one, whoever works on them."""

from __future__ import annotations

import joblib
import numpy as np
import pytest

from cyclofeat.simulators import CycloidalGearbox, LobeDefects, SimulationRun, simulate, simulate_many
from cyclofeat.simulators.simulation import SimulationDiverged

DEFECTS = [LobeDefects.worn(n) for n in (3, 0, 7, 1)]
STIFF = CycloidalGearbox.steel(stiffness_scale=1.0, ramp_time=0.0)


def torques(runs: list[SimulationRun]) -> np.ndarray:
    return np.array([run.torque_out for run in runs])


def test_as_one_by_one() -> None:
    runs = simulate_many(defects=DEFECTS, start_angle=1.0, duration=0.03, forces=True)
    for run, defects in zip(runs, DEFECTS, strict=True):
        alone = simulate(None, defects, duration=0.03, start_angle=1.0, forces=True)
        assert run.defects == defects
        assert np.array_equal(run.torque_out, alone.torque_out)
        assert np.array_equal(run.external_forces, alone.external_forces)


@pytest.mark.parametrize("kind", ["threading", pytest.param("loky", marks=pytest.mark.slow)])
def test_workers_and_order_change_nothing(kind: str) -> None:
    alone = simulate_many(defects=DEFECTS, duration=0.02)
    with joblib.parallel_config(backend=kind):
        shared = simulate_many(defects=DEFECTS, duration=0.02, n_jobs=2)
    assert np.array_equal(torques(alone), torques(shared))
    assert np.ptp(torques(shared), axis=0).max() > 0.01


def test_a_failure_ends_everything() -> None:
    gearboxes = [CycloidalGearbox.steel(), STIFF]
    defects = LobeDefects.worn(1)
    with pytest.raises(SimulationDiverged) as error:
        simulate_many(gearboxes, defects, duration=0.02)
    assert error.value.__notes__ == ["in run 1 of 2 (counted from 0)"]


@pytest.mark.parametrize(
    ("error", "arguments", "message"),
    [
        (ValueError, {"defects": DEFECTS, "gearboxes": []}, "agree in number, got gearbox 0 and defects 4"),
        (ValueError, {"n_jobs": 0}, "n_jobs must be a whole number of workers"),
        (TypeError, {"gearboxes": "steel"}, "gearbox must be of type CycloidalGearbox, got 's'"),
        (TypeError, {"defects": 3}, "defects must be one LobeDefects or several, got 3"),
        (TypeError, {"defects": [3]}, "defects must be of type LobeDefects, got 3"),
    ],
)
def test_what_does_not_fit_together_is_refused(error: type[Exception], arguments: dict, message: str) -> None:
    with pytest.raises(error, match=message):
        simulate_many(duration=0.01, **arguments)
