"""The rig whose surrogate torque has the statistics of paper A's table 4, and the drift that it takes."""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Mapping
from importlib import resources
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from cyclofeat.simulators import CycloidalGearbox, Rig
from cyclofeat.simulators.effects import Effect, EffectParameter, LoadDrift, LogUniform, Offset, Place

Float = NDArray[np.float64]

NAME = "published"
TABLE = "published_rig.csv"


class ProportionalDrift(Effect):
    """Fluctuation of the brake's torque in proportion to it: a drift of its logarithm.

    The load T becomes T exp(x(t) - s^2/2), x low-passed white noise as in
    :class:`cyclofeat.simulators.LoadDrift` with standard deviation s = ``relative``: the mean stays T, and
    excursions are as large upward as downward by factors, hence larger upward by newton metres. A brake whose
    torque is a product (pressure, friction coefficient, radius) does so. *An assumption*: no brake was
    looked at.

    Parameters
    ----------
    relative : float or (low, high), default 0.15
        Standard deviation s of the load's logarithm, a pure number; 0 is neutral.
    cutoff_hz : float or (low, high), default 50
        Cutoff (-3 dB) of x's low-pass in Hz, up to 1000.
    order : int, default 2
        Order of that low-pass (Butterworth), from 1 to 8.

    Notes
    -----
    It is no effect of the library: files cannot name it. Separating measurement: another set-point of the
    brake, with which this drift grows and an additive one does not; or the skewness of a long record.

    Examples
    --------
    >>> from cyclofeat.simulators import CompositeSimulator
    >>> run = CompositeSimulator(effects=[ProportionalDrift(0.2)]).simulate(duration=0.2, seed=1)
    >>> bool(run.torque_out.max() - 22 > 22 - run.torque_out.min())
    True
    """

    effect_id: ClassVar[str] = "proportional_drift"
    place: ClassVar[Place] = Place.LOAD_AND_SPEED
    parameters: ClassVar[Mapping[str, EffectParameter]] = {
        "relative": EffectParameter("1", 0.0, 1.0, 0.0, LogUniform(0.005, 0.3), log=True),
        "cutoff_hz": EffectParameter("Hz", 1e-3, 1e3, None, LogUniform(0.2, 400.0), log=True),
    }
    separated_by: ClassVar[str] = "another set-point of the brake"

    def __init__(self, relative: Any = 0.15, cutoff_hz: Any = 50.0, order: int = 2) -> None:
        self.relative = relative
        self.cutoff_hz = cutoff_hz
        self.order = order

    def check_settings(self) -> None:
        LoadDrift(order=self.order).check_settings()

    def load_fluctuation(
        self, gearbox: CycloidalGearbox, duration: float, random: np.random.Generator
    ) -> Callable[[Float], Float] | None:
        # The same process as the additive drift's; its unit is then no newton metre but the logarithm's.
        logarithm = LoadDrift(self.relative, self.cutoff_hz, self.order).load_fluctuation(
            gearbox, duration, random
        )
        if logarithm is None:
            return None
        load, shift = gearbox.load_torque, 0.5 * float(self.relative) ** 2

        def fluctuation(time: Float) -> Float:
            return np.asarray(load * np.expm1(logarithm(time) - shift))

        return fluctuation


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
