"""Values of an independent implementation of paper B's model, over 0.3-0.6 s of its 0.6 s runs.

Means and healthy forces agree to 2 %, standard deviations and peaks to 10 %: contact makes peaks sensitive.
"""

from __future__ import annotations

import pytest

from cyclofeat.simulators import CycloidalGearbox, LobeDefects, Solver, simulate

STEEL, SETTLED = CycloidalGearbox.steel(), slice(30_000, None)


@pytest.mark.parametrize(
    ("wheels", "count", "std", "least", "most", "mean_in", "force"),
    [
        ((0,), 0, 0.018, 21.96, 22.04, 1.454, 99),
        ((0,), 1, 0.025, 21.92, 22.18, 1.456, 743),
        ((0,), 3, 0.065, 21.60, 22.46, 1.459, 716),
        ((0,), 7, 0.068, 21.64, 22.46, 1.466, 716),
        ((0, 1), 1, 0.121, 21.06, 22.81, 1.457, 693),
        ((0, 1), 3, 0.155, 20.64, 22.83, 1.462, 675),
        ((0, 1), 7, 0.250, 19.39, 23.48, 1.475, 675),
    ],
)
def test_torque_and_largest_force(
    wheels: tuple[int, ...], count: int, std: float, least: float, most: float, mean_in: float, force: float
) -> None:
    worn, pick = LobeDefects.worn(count, wheels=wheels), Solver(decimation="pick")
    run = simulate(STEEL, worn, duration=0.6, sampling_rate=100_000, solver=pick, forces=True)
    torque = run.torque_out[SETTLED]
    rounding = 0.005  # of the values above
    assert torque.mean() == pytest.approx(22.0, rel=0.02)
    assert run.torque_in[SETTLED].mean() == pytest.approx(mean_in, rel=0.02)
    assert torque.std() == pytest.approx(std, rel=0.1)
    assert 22 - torque.min() == pytest.approx(22 - least, rel=0.1, abs=rounding)
    assert torque.max() - 22 == pytest.approx(most - 22, rel=0.1, abs=rounding)
    assert run.external_forces is not None
    assert run.external_forces[SETTLED].max() == pytest.approx(force, rel=0.02 if count == 0 else 0.1)
