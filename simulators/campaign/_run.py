"""One run of a campaign: torque, and a row of labels and true values."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cyclofeat._base.versions import code_sha256, package_versions
from cyclofeat._base.words import from_1
from cyclofeat.simulators._machine import MachineRun, PlannedRun
from cyclofeat.simulators._settling import settling_time
from cyclofeat.simulators.campaign._design import DEPTH, OF_DEFECTS, WEAR, Campaign, RunPlan
from cyclofeat.simulators.defects import LobeDefects
from cyclofeat.simulators.effects.library import labelled, stream
from cyclofeat.simulators.many import attempt_planned, run_planned
from cyclofeat.simulators.rig import DEFECTS, Rig
from cyclofeat.simulators.simulation import GearboxLocked, SimulationFailed, Solver

# Columns of every campaign and their kinds; those of its effects follow.
INTEGER, NUMBER, TEXT, INTEGERS = "integer", "number", "text", "integers"
_COLUMNS = {
    "run": INTEGER,
    "assembly": TEXT,
    "defect_count": INTEGER,
    "worn_lobes_from_1": INTEGERS,
    "wheels_from_1": INTEGERS,
    DEPTH: NUMBER,
    "status": TEXT,
    "reason": TEXT,
    "kernel": TEXT,
    "start_angle_rad": NUMBER,
    "settling_s": NUMBER,
    "true_speed_rpm": NUMBER,
    "true_load_nm": NUMBER,
    "brake_inertia_kg_m2": NUMBER,
    "meter_stiffness_nm_per_rad": NUMBER,
    "meter_damping_nms_per_rad": NUMBER,
    "stiffness_scale": NUMBER,
    "contact_damping": NUMBER,
    "clearance_m": NUMBER,
}
OK = "ok"  # other values of "status": "diverged", "locked", "invalid" (parameters contradict each other)


class RunResult(NamedTuple):
    """Result of a worker: torque of shape (n_samples,), or None for a failed run, and the table's row."""

    torque: NDArray[np.float32] | None
    row: dict[str, Any]


def columns(campaign: Campaign) -> dict[str, str]:
    """Return the columns of a campaign's table and their kinds."""
    effects = {
        f"effects.{label}.{name}": NUMBER
        for effects in campaign.the_rig.effect_sets()
        for label, effect in labelled(effects).items()
        for name in effect.parameters
    }
    radial = {} if campaign.wear_um is None else {WEAR: NUMBER}
    return {**_COLUMNS, **radial, **effects}


@functools.lru_cache(maxsize=1)
def made_with() -> dict[str, str]:
    """Return the versions and the digest of the sources on which the bytes of a result depend."""
    room = Path(__file__).parents[1]
    packages = package_versions("cyclofeat", "numpy", "scipy", "numba")
    return packages | {"simulators_sha256": code_sha256(room, sorted(room.rglob("*.py")))}


def simulate_runs(
    campaign: Campaign, plans: Sequence[RunPlan], expected: dict[str, str] | None = None
) -> list[RunResult]:
    """Simulate runs, each of which depends on its own plan only.

    Raises UnlikeWorker unless this process has the ``expected`` versions and the campaign's kernel.
    """
    if expected is not None:
        _check_worker(campaign, expected)
    begun = [_begun(campaign, plan) for plan in plans]
    made = attempt_planned([planned for _, planned in begun], campaign.kernel)
    return [_result(row, one) for (row, _), one in zip(begun, made, strict=True)]


class UnlikeWorker(RuntimeError):
    """Error of a worker that would not make the same bytes as the process that writes."""


def _check_worker(campaign: Campaign, expected: dict[str, str]) -> None:
    if expected != made_with():
        other = next(name for name in expected if expected[name] != made_with().get(name))
        raise UnlikeWorker(
            f"a worker has {other} {made_with().get(other)}, the campaign {expected[other]}: install the same"
        )
    try:
        _check_kernel(campaign)
    except RuntimeError as error:
        raise UnlikeWorker(f"on a worker {error}") from None


def _check_kernel(campaign: Campaign) -> None:
    """Raise RuntimeError if the campaign needs batches and they cannot be compiled here."""
    if campaign.kernel == "exact":
        return
    from cyclofeat.simulators.batch import runs

    if error := runs.compile_error():
        raise RuntimeError(
            f"runs in batches cannot be compiled: {error}; a campaign of kernel='exact' needs none"
        )


def check_middle(campaign: Campaign) -> None:
    """Raise an error unless the kernel works here and the medians of the design can be simulated."""
    _check_kernel(campaign)
    duration = max(2 / campaign.sampling_rate, min(campaign.duration, 0.01))
    try:
        rig = _rig_of(campaign, campaign.medians())
        planned = rig.plan_run(
            duration=duration, sampling_rate=campaign.sampling_rate, settled=rig.has_motor, torque_in=False,
            motion=False,
        )  # fmt: skip
        (made,) = run_planned([planned], kernel=campaign.kernel)
        if isinstance(made, MachineRun):  # a failure is a result, and other runs may succeed
            made.record()
    except ValueError as error:
        raise ValueError(
            f"the design cannot be simulated, not even in the middle of its ranges: {error}"
        ) from None


def _rig_of(campaign: Campaign, values: Mapping[str, float]) -> Rig:
    """The rig with its explored parameters set."""
    return campaign.the_rig.with_parameters({name: v for name, v in values.items() if name not in OF_DEFECTS})


def _begun(campaign: Campaign, plan: RunPlan) -> tuple[dict[str, Any], PlannedRun | ValueError]:
    """Return the row of a run, with all that is known before it, and what is to be simulated."""
    defects = _defects(campaign, plan)
    row: dict[str, Any] = {name: math.nan for name, kind in columns(campaign).items() if kind == NUMBER}
    row |= {f"effects.{name}": value for name, value in plan.values.items() if name not in OF_DEFECTS}
    row |= {
        "run": plan.run,
        "assembly": campaign.assembly_of(plan.run),
        "defect_count": plan.defect_count,
        "worn_lobes_from_1": from_1(defects.worn_lobes),
        "wheels_from_1": from_1(defects.wheels) if defects.worn_lobes else [],
        DEPTH: defects.depth if defects.worn_lobes else 0.0,
    }
    if campaign.wear_um is not None:
        row[WEAR] = defects.wear_um if defects.worn_lobes else 0.0
    seed = campaign.seed_of(plan.run)
    planned: PlannedRun | ValueError
    try:
        rig = _rig_of(campaign, plan.values)
        try:
            planned = rig.plan_run(
                defects, duration=campaign.n_samples / campaign.sampling_rate,
                sampling_rate=campaign.sampling_rate, random_state=seed, torque_in=False, motion=False,
                solver=Solver(integrator=campaign.integrator),
            )  # fmt: skip
        except ValueError as error:
            machine, planned = rig.draw(seed), error
            settling = settling_time(machine.gearbox)
        else:
            machine, settling = planned.machine, planned.n_settling / campaign.sampling_rate
    except ValueError as error:  # there is no such machine
        return row, error
    row |= {"settling_s": settling, **machine.true_values()}
    for label, drawn in labelled(machine.effects).items():
        row |= {f"effects.{label}.{name}": float(getattr(drawn, name)) for name in drawn.parameters}
    return row, planned


def _result(row: dict[str, Any], made: MachineRun | SimulationFailed | ValueError) -> RunResult:
    """Complete the row of a run, and return its torque."""
    row |= {"status": OK, "reason": "", "kernel": ""}
    try:
        if isinstance(made, Exception):
            raise made
        record = made.record()
    except SimulationFailed as error:
        status = "locked" if isinstance(error, GearboxLocked) else "diverged"
        row |= {"status": status, "reason": str(error), "kernel": "exact"}
    except ValueError as error:
        # An impossible combination of values is a result, like a run that diverges.
        row |= {"status": "invalid", "reason": str(error)}
    else:
        # Angle of the input, modulo one turn of the output.
        angle = float(record.input_angle[0] % (2 * np.pi * record.gearbox.n_lobes))
        row |= {"kernel": record.kernel, "start_angle_rad": angle}
        return RunResult(record.torque_out.astype(np.float32), row)
    return RunResult(None, row)


def _defects(campaign: Campaign, plan: RunPlan) -> LobeDefects:
    """Draw the worn lobes of the run."""
    depth, wear_um = (plan.values.get(name, getattr(campaign, name)) for name in OF_DEFECTS)
    defects = LobeDefects.drawn(
        plan.defect_count,
        campaign.the_rig.gearbox.n_lobes,
        stream(campaign.seed_of(plan.run), DEFECTS),
        consecutive=campaign.lobes == "consecutive",
        wheels=None if isinstance(campaign.wheels, str) else campaign.wheels,
        depth=depth,
    )
    return defects if wear_um is None else dataclasses.replace(defects, depth=0.0, wear_um=wear_um)
