"""The rig whose surrogate torque has the statistics of paper A's table 4."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping
from importlib import resources

from cyclofeat.simulators import Offset, ProportionalDrift, Rig

NAME = "published"
TABLE = "published_rig.csv"


def rig_of_values(values: Mapping[str, float]) -> Rig:
    """The rig with the numbers of the fit.

    Parameters
    ----------
    values : mapping from str to float
        ``relative_drift_low``, ``relative_drift_high``, ``drift_cutoff_hz``, ``offset_nm``, ``noise_nm``; and
        ``brake_inertia_kg_m2``, ``meter_stiffness_nm_per_rad``, ``meter_damping_ratio``, all three or none (a
        free output).
    """

    def known(name: str) -> tuple[float, float] | None:
        return (values[name], values[name]) if name in values else None

    return Rig(
        name=NAME,
        brake_inertia=known("brake_inertia_kg_m2"),
        meter_stiffness=known("meter_stiffness_nm_per_rad"),
        meter_damping_ratio=known("meter_damping_ratio"),
        load_drift_nm=0.0,
        noise_nm=values["noise_nm"],
        effects=(
            ProportionalDrift(
                (values["relative_drift_low"], values["relative_drift_high"]), values["drift_cutoff_hz"]
            ),
            Offset(values["offset_nm"]),
        ),
    )


def fitted_values() -> dict[str, float]:
    """The numbers that ``benchmarks/published_rig.py`` found, by name."""
    text = (resources.files("cyclofeat.datasets") / "tables" / TABLE).read_text(encoding="utf-8")
    found = {row["name"]: float(row["value"]) for row in csv.DictReader(text.splitlines())}
    assert all(math.isfinite(value) for value in found.values())
    return found
