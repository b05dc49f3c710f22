"""A short look at the kernels that also runs without numba's compiler, which hides errors of Python."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import numpy as np
import pytest
from reference_tools import Kernel, kernel_state, random_state

from benchmarks.reference_gearbox import ReferenceGearbox
from cyclofeat.simulators import CycloidalGearbox, LobeDefects, simulate
from cyclofeat.simulators.simulation import SimulationDiverged

pytestmark = pytest.mark.nojit

# 1 ms under half of the load: two worn lobes and an edge of a removed one, or radial wear at all contacts.
SCRIPT = """
import json, sys
from cyclofeat.simulators import CycloidalGearbox, LobeDefects, Solver, simulate
gearbox = CycloidalGearbox.steel(ramp_time=2e-3, pin_radial_errors=[2e-5] * 16).with_brake(0.02, 1e4, 0.02)
chords = LobeDefects(worn_lobes=(0, 7), removed_lobes=(3,), depth=0.5)
defects = {"chords": chords, "radial": LobeDefects.worn(15, wear_um=60, wear_share=1.0)}[sys.argv[1]]
pick = Solver(decimation="pick")
run = simulate(gearbox, defects, duration=1e-3, sampling_rate=100_000, solver=pick, forces=True)
print(json.dumps({
    name: getattr(run, name).tolist()
    for name in ("torque_out", "torque_in", "output_angle", "external_forces", "internal_forces")
}))
"""


def in_a_process_of_its_own(wear: str, jit: bool) -> dict[str, np.ndarray]:
    environment = os.environ | {"NUMBA_DISABLE_JIT": "0" if jit else "1"}
    found = subprocess.run(
        [sys.executable, "-c", SCRIPT, wear], env=environment, capture_output=True, text=True, check=True
    )
    return {name: np.array(values) for name, values in json.loads(found.stdout).items()}


@pytest.mark.slow
@pytest.mark.parametrize(("wear", "force"), [("chords", 100), ("radial", 10)])
def test_compiled_and_interpreted_runs_agree(wear: str, force: float) -> None:
    """But for the order of sums, which the compiler may change."""
    compiled, interpreted = (in_a_process_of_its_own(wear, jit) for jit in (True, False))
    assert compiled["external_forces"].shape == (100, 2, 16)
    assert compiled["external_forces"].max() > force
    for name, values in compiled.items():
        assert np.abs(values - interpreted[name]).max() <= 1e-9 * np.abs(values).max(), name


def test_no_pin_is_missed_far_out() -> None:
    gearbox = CycloidalGearbox.steel()
    reference = ReferenceGearbox(gearbox, LobeDefects.healthy())
    state = random_state(reference, np.random.default_rng(2), 0.03)
    expected = reference.accelerations(*state)
    kernel = Kernel(gearbox, LobeDefects.healthy())
    found = kernel(kernel_state(reference, state), state.phi, state.omega, state.alpha, state.load)
    assert expected.external_force.max() > 1000
    assert found["external_force"] == pytest.approx(expected.external_force, rel=1e-6, abs=1e-3)


def test_healthy_start_and_divergence() -> None:
    run = simulate(duration=1e-3)
    assert run.torque_out.shape == (26,)
    assert np.all(np.isfinite(run.torque_out))
    assert run.torque_in[5:20].mean() == pytest.approx(2.46e-3, rel=0.2)
    with pytest.raises(SimulationDiverged):
        simulate(CycloidalGearbox.steel(stiffness_scale=1.0), LobeDefects.worn(1), duration=2e-3)
