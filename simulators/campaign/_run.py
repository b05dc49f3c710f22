"""One run of a campaign: torque, and a row of labels and true values."""

from __future__ import annotations

import functools
import hashlib
import importlib.metadata
import math
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cyclofeat.simulators.campaign._design import DEPTH, Campaign, RunPlan
from cyclofeat.simulators.campaign._parameters import effect_labels, with_values
from cyclofeat.simulators.composite import _DEFECTS, CompositeSimulator
from cyclofeat.simulators.effects._library import child, in_chain_order
from cyclofeat.simulators.gearbox import CycloidalGearbox, LobeDefects
from cyclofeat.simulators.rig import settling_time
from cyclofeat.simulators.simulation import GearboxLocked, SimulationFailed

# Columns of every campaign, in this order, with their kinds; those of its design and effects follow.
INTEGER, NUMBER, TEXT, INTEGERS = "integer", "number", "text", "integers"
_COLUMNS = {
    "run": INTEGER,
    "assembly": TEXT,
    "defect_count": INTEGER,
    "worn_lobes": INTEGERS,
    "wheels": INTEGERS,
    DEPTH: NUMBER,
    "status": TEXT,
    "reason": TEXT,
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
# Status of a run. "invalid": its parameters contradict each other.
OK, DIVERGED, LOCKED, INVALID = "ok", "diverged", "locked", "invalid"


class RunResult(NamedTuple):
    """What comes back from a worker: torque of shape (n_samples,), or None for a failed run, and the row."""

    torque: NDArray[np.float32] | None
    row: dict[str, Any]


def columns(campaign: Campaign) -> dict[str, str]:
    """Columns of a campaign's table and their kinds."""
    design = {f"design.{name}": NUMBER for name in campaign.parameters}
    effects = {
        f"effects.{label}.{name}": NUMBER
        for label, effect in effect_labels(campaign.the_rig).items()
        for name in effect.parameters
    }
    return {**_COLUMNS, **design, **effects}


@functools.lru_cache(maxsize=1)
def made_with() -> dict[str, str]:
    """Versions of all that decides about the bytes of a result.

    ``simulators_sha256`` covers the simulators' own sources: between two releases they may differ while the
    version does not.
    """
    room = Path(__file__).parents[1]
    code = hashlib.sha256()
    for path in sorted(room.rglob("*.py")):
        code.update(path.relative_to(room).as_posix().encode() + b"\0" + path.read_bytes())
    packages = ("cyclofeat", "numpy", "scipy", "numba")
    versions = {name: importlib.metadata.version(name) for name in packages}
    return {**versions, "simulators_sha256": code.hexdigest()}


def simulate_run(campaign: Campaign, plan: RunPlan, expected: dict[str, str] | None = None) -> RunResult:
    """Simulate one run.

    Parameters
    ----------
    campaign : Campaign
    plan : RunPlan
        One of ``campaign.plans()``.
    expected : dict from str to str, optional
        Versions that must be the same here (:func:`made_with`).

    Raises
    ------
    ValueError
        If this worker has other versions.
    """
    if expected is not None and expected != made_with():
        other = next(name for name in expected if expected[name] != made_with().get(name))
        raise WrongVersion(
            f"a worker has {other} {made_with().get(other)}, the campaign {expected[other]}: install the same"
        )
    defects = _defects(campaign, plan)
    row: dict[str, Any] = {name: math.nan for name, kind in columns(campaign).items() if kind == NUMBER}
    row |= {f"design.{name}": value for name, value in plan.values.items() if name != DEPTH}
    row |= {
        "run": plan.run,
        "assembly": campaign.assembly_of(plan.run),
        "defect_count": plan.defect_count,
        "worn_lobes": list(defects.worn_lobes),
        "wheels": list(defects.wheels) if defects.worn_lobes else [],
        DEPTH: defects.depth if defects.worn_lobes else 0.0,
        "status": OK,
        "reason": "",
    }
    torque = None
    try:
        torque = _simulated(campaign, plan, defects, row)
    except SimulationFailed as error:
        row |= {"status": LOCKED if isinstance(error, GearboxLocked) else DIVERGED, "reason": str(error)}
    except ValueError as error:
        # A combination of values that cannot be is as much a result as a run that diverges.
        row |= {"status": INVALID, "reason": str(error)}
    return RunResult(torque, row)


class WrongVersion(RuntimeError):
    """A worker has other versions than the process that writes."""


def check_middle(campaign: Campaign) -> None:
    """Raise ValueError where not even the middle of the design can be simulated: nothing else could be."""
    middle = {name: 0.5 * (ends[0] + ends[1]) for name, ends in campaign.explored.items() if name != DEPTH}
    simulator = CompositeSimulator(with_values(campaign.the_rig, middle))
    duration = max(2 / campaign.sampling_rate, min(campaign.duration_s, 0.01))
    try:
        simulator.simulate(
            duration=duration,
            sampling_rate=campaign.sampling_rate,
            seed=0,
            settled=False,
            torque_in=False,
            motion=False,
        )
    except SimulationFailed:
        pass  # a result, and perhaps only here
    except ValueError as error:
        raise ValueError(
            f"the design cannot be simulated, not even in the middle of its ranges: {error}"
        ) from None


def _simulated(
    campaign: Campaign, plan: RunPlan, defects: LobeDefects, row: dict[str, Any]
) -> NDArray[np.float32]:
    """Torque of the run; what is known of the assembly goes into the row as soon as it is known."""
    seed = campaign.seed_of(plan.run)
    rig = with_values(campaign.the_rig, {k: v for k, v in plan.values.items() if k != DEPTH})
    simulator = CompositeSimulator(rig)
    gearbox, effects = simulator.assemble(seed)
    row |= _assembly(gearbox, campaign.sampling_rate)
    # Effects come back in the order of the chain.
    names = {id(effect): label for label, effect in effect_labels(rig).items()}
    for given, drawn in zip(in_chain_order(rig.effects), effects, strict=True):
        row |= {
            f"effects.{names[id(given)]}.{name}": float(getattr(drawn, name)) for name in drawn.parameters
        }
    run = simulator.simulate(
        defects, duration=campaign.n_samples / campaign.sampling_rate,
        sampling_rate=campaign.sampling_rate, seed=seed, torque_in=False, motion=False,
    )  # fmt: skip
    # As an angle of the input, within one turn of the output.
    row["start_angle_rad"] = float(run.input_angle[0] % (2 * np.pi * gearbox.n_lobes))
    return run.torque_out.astype(np.float32)


def _assembly(gearbox: CycloidalGearbox, sampling_rate: float) -> dict[str, float]:
    settling = settling_time(gearbox)
    return {
        "settling_s": math.ceil(settling * sampling_rate) / sampling_rate
        if math.isfinite(settling)
        else settling,
        # rad/s and back leaves a residue in the last digits
        "true_speed_rpm": round(float(gearbox.input_speed) * 60 / (2 * math.pi), 6),
        "true_load_nm": float(gearbox.load_torque),
        "brake_inertia_kg_m2": float(gearbox.brake_inertia),
        "meter_stiffness_nm_per_rad": float(gearbox.meter_stiffness),
        "meter_damping_nms_per_rad": float(gearbox.meter_damping),
        "stiffness_scale": float(gearbox.stiffness_scale),
        "contact_damping": float(gearbox.contact_damping),
        "clearance_m": float(gearbox.clearance),
    }


def _defects(campaign: Campaign, plan: RunPlan) -> LobeDefects:
    """Worn lobes of the run, randomly placed as in the toolkit's other surrogate recordings."""
    random = np.random.default_rng(child(campaign.seed_of(plan.run), _DEFECTS))
    depth = plan.values.get(DEPTH, campaign.depth)
    assert isinstance(depth, float)
    return LobeDefects.drawn(
        plan.defect_count,
        campaign.the_rig.gearbox.n_lobes,
        random,
        consecutive=campaign.lobes == "consecutive",
        wheels=None if isinstance(campaign.wheels, str) else campaign.wheels,
        depth=depth,
    )
