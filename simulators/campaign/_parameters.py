"""Parameters of a rig that a campaign explores, by name."""

from __future__ import annotations

import dataclasses
import difflib
from collections.abc import Mapping
from typing import Any

from cyclofeat.simulators.effects import Effect
from cyclofeat.simulators.effects._library import stream_keys
from cyclofeat.simulators.gearbox import CycloidalGearbox
from cyclofeat.simulators.rig import _DRAWN, Rig
from cyclofeat.simulators.tolerances import AssemblyTolerances

# Fields of a rig: ranges from which assemblies draw, here given a value; of the last two there is always one.
_BRAKE = ("brake_inertia", "meter_stiffness", "meter_damping_ratio")
_FACTORS = ("contact_stiffness_factor", "contact_damping_factor")
_NUMBERS = (
    "load_drift_nm", "load_drift_cutoff_hz", "broad_drift_nm", "broad_drift_cutoff_hz", "noise_nm",
)  # fmt: skip
_CLEARANCE = "clearance"


def effect_labels(rig: Rig) -> dict[str, Effect]:
    """The rig's effects by their names, ``"hum"``, and ``"hum_2"`` for a second one, in the order given."""
    keys = stream_keys(rig.effects)
    return {
        effect.effect_id + (f"_{count + 1}" if count else ""): effect
        for (*_, count), effect in zip(keys, rig.effects, strict=True)
    }


def parameter_names(rig: Rig) -> list[str]:
    """Names of all parameters of a rig that a campaign may explore.

    Parameters
    ----------
    rig : Rig

    Returns
    -------
    list of str
        Fields of the gearbox that are numbers, fields of the rig, ``"tolerances.<field>"``, and
        ``"effects.<effect>.<parameter>"`` for the effects that the rig has.
    """
    gearbox = [
        item.name
        for item in dataclasses.fields(CycloidalGearbox)
        if isinstance(item.default, float) and item.name not in _DRAWN
    ]
    tolerances = [
        f"tolerances.{item.name}"
        for item in dataclasses.fields(AssemblyTolerances)
        if isinstance(item.default, float)
    ]
    effects = [
        f"effects.{label}.{name}"
        for label, effect in effect_labels(rig).items()
        for name in effect.parameters
    ]
    brake = _BRAKE if rig.has_brake else ()
    return [*gearbox, _CLEARANCE, *brake, *_FACTORS, *_NUMBERS, *tolerances, *effects]


def check_name(rig: Rig, name: str) -> None:
    """Raise ValueError for a name that is not one of :func:`parameter_names`; the message has the nearest."""
    known = parameter_names(rig)
    if name in known:
        return
    if name in _BRAKE:
        raise ValueError(f"parameters: {name!r} needs a rig with a brake, got rig {rig.name!r} without one")
    if name in _DRAWN:
        raise ValueError(f"parameters: {name!r} is drawn for each assembly, explore {_DRAWN[name]} instead")
    near = difflib.get_close_matches(name, known, n=1)
    right = f"did you mean {near[0]!r}?" if near else f"known are {', '.join(known)}"
    raise ValueError(f"unknown parameter {name!r} in parameters: {right}")


def with_values(rig: Rig, values: Mapping[str, float]) -> Rig:
    """The rig with parameters set to values, checked.

    Parameters
    ----------
    rig : Rig
    values : mapping from str to float
        Names as of :func:`parameter_names`.

    Raises
    ------
    ValueError
        If a value cannot be; the message names it.
    """
    gearbox: dict[str, Any] = {}
    tolerances: dict[str, Any] = {}
    changes: dict[str, Any] = {}
    effects: dict[str, dict[str, float]] = {}
    for name, value in values.items():
        room, _, rest = name.rpartition(".")
        if room == "tolerances":
            tolerances[rest] = value
        elif room:
            effects.setdefault(room.removeprefix("effects."), {})[rest] = value
        elif name == _CLEARANCE:
            tolerances[name] = (value, value)
        elif name in (*_BRAKE, *_FACTORS):
            changes[name] = (value, value)
        elif name in _NUMBERS:
            changes[name] = value
        else:
            gearbox[name] = value
    if gearbox:
        changes["gearbox"] = rig.gearbox.replace(**gearbox)
    if tolerances:
        changes["tolerances"] = dataclasses.replace(rig.tolerances, **tolerances)
    if effects:
        changes["effects"] = [
            effect.with_parameters(**effects.get(label, {})) for label, effect in effect_labels(rig).items()
        ]
    return rig.replace(**changes) if changes else rig
