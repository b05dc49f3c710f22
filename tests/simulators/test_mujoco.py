"""A drive in MuJoCo as the simulator of a rig, beside the same equations integrated by scipy."""

from __future__ import annotations

import runpy
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from scipy import signal

from cyclofeat.simulators import Drift, LobeDefects, Rig

EXAMPLE = Path(__file__).parents[2] / "examples" / "gap" / "plot_mujoco_simulator.py"
RATE = 4000.0


@pytest.fixture(scope="module")
def drive():
    pytest.importorskip("mujoco")
    mpl.use("agg")
    return runpy.run_path(str(EXAMPLE))["MujocoDrive"]()


@pytest.mark.slow
def test_a_drive_in_mujoco_obeys_its_equations(drive) -> None:  # type: ignore[no-untyped-def]
    rig = Rig(effects=[Drift(0.5, cutoff_hz=20.0)], simulator=drive)
    plan = rig.plan_run(LobeDefects.worn(3), duration=1.0, sampling_rate=RATE, random_state=2)
    run = plan.simulate().run
    j, b, k, c = drive.motor_inertia, drive.brake_inertia, drive.stiffness, drive.damping
    # Twist of the shaft, speeds of motor and brake, as deviations from the mean; driven by wear and load.
    states = [[0, 1, -1], [-k / j, -(c + drive.speed_control) / j, c / j], [k / b, c / b, -c / b]]
    system = signal.StateSpace(states, [[0, 0], [1 / j, 0], [0, -1 / b]], [[k, c, -c]], np.zeros((1, 2)))
    lobes = 2 * np.pi * np.array([0, 1, 2]) / rig.gearbox.n_lobes
    nominal = run.input_angle[0] + rig.gearbox.input_speed * run.time
    wear = drive.wear * np.cos(nominal[:, None] - lobes).sum(axis=1)
    load = 22.0 + plan.arguments["courses"].load_fluctuation(run.time)
    _, torque, _ = signal.lsim(system, np.column_stack([wear, load - load.mean()]), run.time)
    settled = run.time > 0.6  # lsim starts at rest
    np.testing.assert_allclose(
        (run.torque_out - load.mean())[settled], torque[settled], atol=0.02 * torque.std()
    )
    turned = (run.input_angle[-1] - run.input_angle[0]) / (run.time[-1] * rig.gearbox.input_speed)
    assert turned == pytest.approx(1, abs=0.01)
