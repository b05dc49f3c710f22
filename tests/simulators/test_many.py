"""Many runs at once are the runs one by one, whoever works on them."""

from __future__ import annotations

import numpy as np
import pytest

from cyclofeat.simulators import (
    AssemblyTolerances,
    CycloidalGearbox,
    GearboxLocked,
    LobeDefects,
    SimulationDiverged,
    SimulationRun,
    many,
    simulate,
    simulate_many,
)

DEFECTS = [LobeDefects.worn(n) for n in (3, 0, 7, 1)]
STIFF = CycloidalGearbox.steel(stiffness_scale=1.0, ramp_time=0.0)


def torques(runs: list[SimulationRun]) -> np.ndarray:
    return np.array([run.torque_out for run in runs])


def test_as_one_by_one() -> None:
    runs = simulate_many(defects=DEFECTS, start_angles=[0.0, 1.0, 2.0, 3.0], duration=0.03, forces=True)
    for run, defects, angle in zip(runs, DEFECTS, (0.0, 1.0, 2.0, 3.0), strict=True):
        alone = simulate(None, defects, duration=0.03, start_angle=angle, forces=True)
        assert run.defects == defects
        assert np.array_equal(run.torque_out, alone.torque_out)
        assert np.array_equal(run.external_forces, alone.external_forces)


@pytest.mark.parametrize("prefer", ["threads", pytest.param("processes", marks=pytest.mark.slow)])
def test_workers_and_order_change_nothing(prefer: str) -> None:
    tolerances = AssemblyTolerances()
    alone = simulate_many(n_runs=4, tolerances=tolerances, random_state=5, duration=0.02)
    shared = simulate_many(
        n_runs=6, tolerances=tolerances, random_state=5, duration=0.02, n_jobs=2, prefer=prefer
    )
    assert np.array_equal(torques(alone), torques(shared)[:4])
    assert len({run.seed for run in shared}) == 6
    assert np.ptp(torques(shared), axis=0).max() > 0.01
    again = simulate(seed=shared[2].seed, tolerances=tolerances, duration=0.02)
    assert np.array_equal(again.torque_out, shared[2].torque_out)


def test_a_failure_ends_everything_or_takes_its_place() -> None:
    gearboxes = [CycloidalGearbox.steel(), STIFF]
    defects = LobeDefects.worn(1)
    with pytest.raises(SimulationDiverged) as error:
        simulate_many(gearboxes, defects, duration=0.02)
    assert error.value.__notes__ == ["in run 1 of 2 (counted from 0)"]
    calls: list[tuple[int, int]] = []
    found = simulate_many(
        gearboxes,
        defects,
        duration=0.02,
        on_failure="return",
        n_jobs=2,
        progress=lambda done, total: calls.append((done, total)),
    )
    assert isinstance(found[0], SimulationRun)
    assert isinstance(found[1], SimulationDiverged | GearboxLocked)
    assert calls == [(1, 2), (2, 2)]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"defects": DEFECTS, "n_runs": 3}, "must agree in number, got defects 4, n_runs 3"),
        ({"tolerances": AssemblyTolerances()}, "random_state must be given with tolerances"),
        ({"n_jobs": 0}, "n_jobs must be a whole number of workers"),
        ({"prefer": "magic"}, "prefer must be 'threads' or 'processes', got 'magic'"),
        ({"on_failure": "ignore"}, "on_failure must be 'raise' or 'return', got 'ignore'"),
        ({"seed": 1}, "seed is one run's; give random_state for many"),
        ({"start_angle": 1.0}, "start_angle is one run's; give start_angles for many"),
    ],
)
def test_what_does_not_fit_together_is_refused(arguments: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        simulate_many(duration=0.01, **arguments)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            {"gearboxes": "steel"},
            "gearboxes must be a CycloidalGearbox or several, one for each run, got 'steel'",
        ),
        ({"defects": 3}, "defects must be a LobeDefects or several, one for each run, got 3"),
        ({"defects": [3]}, "defects must be of type LobeDefects, got 3"),
        ({"start_angles": 3.0}, "start_angles must be numbers of rad, one for each run, got 3.0"),
        ({"start_angles": ["a"]}, "start_angles must be numbers of rad, got 'a'"),
        ({"random_state": "a"}, "random_state must be a whole number, got 'a'"),
    ],
)
def test_arguments_of_another_type_are_refused(arguments: dict, message: str) -> None:
    with pytest.raises(TypeError, match=message):
        simulate_many(duration=0.01, **arguments)


def test_no_two_runs_have_the_same_seed() -> None:
    """Of 150,000 seeds of 32 random bits two would be equal with a chance of 93 %."""
    assert len({many._seed_of(1, index) for index in range(150_000)}) == 150_000
    assert simulate_many(n_runs=3, random_state=1, duration=0.001)[2].seed == many._seed_of(1, 2)
