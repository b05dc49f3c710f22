"""Write the pages of the effects and of the rigs from their classes: ``python docs/_effects.py``."""

from __future__ import annotations

import math
import re
from pathlib import Path

from cyclofeat._base.quantities import quantity_text
from cyclofeat.datasets import rig_preset
from cyclofeat.gap import World
from cyclofeat.simulators import Effect, known_effects
from cyclofeat.simulators.effects.library import look_alikes

DOCS = Path(__file__).parent
RIGS = """# The rigs R0, R1, R2 and published

Four rigs come with the toolkit. Neither paper describes its test bench in full, so their values are
assumptions.

- **R0** is the papers' free output: the load acts on the output shaft itself, without a brake.
- **R1** has one known brake behind a known torque meter, the same in each assembly.
- **R2** is a test bench that nobody has measured: brake, torque meter and contacts differ from one assembly
  to the next. The packaged models are trained on it.
- **published** has a drift and an offset that give roughly the statistics of paper A's table 4.

All have the gearbox of paper B, at {rpm:.0f} RPM and {load:g} Nm. Each assembly draws its values from the
ranges below. A rig of your own is [a JSON file](howto/gearbox.rst).

{table}

Without `--rig`, the commands take different rigs:

| command | rig without `--rig` |
|---|---|
| `simulate`, `animate` | the papers' free output, without any of these effects |
| `simulate --count`, `train` | R2 |
| `plan` | R1 |
| `gap` | the same as `simulate`, to compare recordings with it (`--simulator` names another) |
"""
EFFECTS = """# All effects

An effect is one thing that a rig adds to the gearbox model. `cyclofeat gap` considers the {n} effects of the
first table (`cyclofeat.gap.World().effects`). The range holds 90 % of the sizes that it expects before it
sees a recording. Effects that look alike change the torque of one condition in the same way; the last
column names the measurement that separates them.

{gap}

## Effects that `gap` does not name

These can be part of a rig, but torque alone does not show them, or they belong to a motor's current.

{others}
"""


def name_text(name: str) -> str:
    """Return the name of a parameter without its unit."""
    return re.sub(r"_(nm|hz|s)$", "", name).replace("_", " ")


def parameter_text(effect: Effect, name: str) -> str:
    """Return a parameter with its range, or with its default where nothing is expected."""
    parameter = effect.parameters[name]
    if parameter.prior is None:
        return ""
    low, high = parameter.prior.interval(0.9)
    return f"{name_text(name)} {quantity_text((low, high), parameter.unit)}"


def table_of(effects: list[Effect]) -> str:
    """Return the table of some effects."""
    groups = [set(group) for group in look_alikes()]
    lines = ["| id | effect | range | looks like | told apart by |", "|---|---|---|---|---|"]
    for effect in effects:
        sizes = [text for name in effect.parameters if (text := parameter_text(effect, name))]
        alike = set().union(*(group for group in groups if effect.effect_id in group)) - {effect.effect_id}
        names = ", ".join(f"`{name}`" for name in sorted(alike))
        what = f"`{effect.effect_id}` | {effect.summary.rstrip('.')}"
        lines.append(f"| {what} | {'; '.join(sizes)} | {names} | {effect.separated_by} |")
    return "\n".join(lines)


def effects_page() -> str:
    weighed = list(World().effects or ())
    names = {effect.effect_id for effect in weighed}
    others = [effect for name, effect in known_effects().items() if name not in names]
    return EFFECTS.format(n=len(weighed), gap=table_of(weighed), others=table_of(others))


def value_text(value: object, unit: str) -> str:
    """Return a value as a rig states it: a number, a range, or a distribution."""
    if hasattr(value, "support"):
        ends = value.support()
        if not math.isfinite(ends[1]):
            return f"{quantity_text((value.median(),), unit)} (median)"
        value = ends
    return quantity_text(value if isinstance(value, tuple) else (value,), unit)


def values_text(effect: Effect) -> str:
    """Return the values of an effect that are not those of a part without it."""
    values = {
        name: value_text(getattr(effect, name), parameter.unit)
        for name, parameter in effect.parameters.items()
        if getattr(effect, name) not in (None, parameter.neutral) and (parameter.prior or parameter.default)
    }
    return ", ".join(f"{name_text(name)} {value}" for name, value in values.items())


def rigs_page() -> str:
    rigs = [rig_preset(name) for name in ("R0", "R1", "R2", "published")]
    effects = {effect.effect_id: effect for rig in rigs for effect in rig.effects}
    lines = ["| effect | R0 | R1 | R2 | published |", "|---|---|---|---|---|"]
    for name, effect in effects.items():
        cells = [
            "; ".join(dict.fromkeys(values_text(one) for one in rig.effects if one.effect_id == name))
            for rig in rigs
        ]
        lines.append(f"| {effect.summary.rstrip('.').partition(':')[0]} (`{name}`) | {' | '.join(cells)} |")
    gearbox = rigs[0].gearbox
    rpm = 60 * gearbox.input_speed_hz
    return RIGS.format(rpm=rpm, load=gearbox.load_torque, table="\n".join(lines))


if __name__ == "__main__":
    (DOCS / "effects.md").write_text(effects_page(), encoding="utf-8")
    (DOCS / "rigs.md").write_text(rigs_page(), encoding="utf-8")
