"""Length of surrogate recordings, the speeds and loads at which they are made, and their radial wear."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from cyclofeat._base import checks

if TYPE_CHECKING:
    from cyclofeat.simulators import CycloidalGearbox, LobeDefects, Rig

DEFAULT_S = 1.8  # one output turn at 500 RPM


@dataclass(frozen=True)
class Length:
    """Length of recordings in s, or in turns of the output."""

    duration: float | None
    output_turns: float | None

    @classmethod
    def checked(cls, duration: float | None, output_turns: float | None) -> Length:
        if output_turns is None:
            given = DEFAULT_S if duration is None else duration
            return cls(checks.positive("duration", given, "a number of s"), None)
        if duration is not None:
            raise ValueError(
                f"duration and output_turns exclude each other, got {duration!r} s and {output_turns!r} turns"
            )
        return cls(None, checks.positive("output_turns", output_turns, "a number of turns of the output"))

    def seconds(self, gearbox: CycloidalGearbox) -> float:
        """Return the length at the gearbox's nominal speed."""
        if self.duration is not None:
            return self.duration
        assert self.output_turns is not None
        return self.output_turns * gearbox.n_lobes / gearbox.input_speed_hz


@dataclass(frozen=True)
class Conditions:
    """Ranges of nominal speed (RPM) and load (Nm) over the assemblies; None for those of the gearbox."""

    speed_rpm: tuple[float, float] | None = None
    load_nm: tuple[float, float] | None = None

    @classmethod
    def checked(cls, speed_rpm: Any, load_nm: Any) -> Conditions:
        return cls(_positive_range("speed_rpm", speed_rpm, "RPM"), _positive_range("load_nm", load_nm, "Nm"))

    def drawn(self, rig: Rig, seed: np.random.SeedSequence) -> Rig:
        """Return the rig at the conditions of one assembly."""
        random = np.random.default_rng(seed)
        shares = random.random(2)
        changes = {}
        if self.speed_rpm is not None:
            changes["input_speed"] = _log_uniform(self.speed_rpm, shares[0]) * 2 * np.pi / 60
        if self.load_nm is not None:
            changes["load_torque"] = _log_uniform(self.load_nm, shares[1])
        if not changes:
            return rig
        # A brake drifts with its load, but the rig states no more than this drift.
        factor = min(1.0, changes.get("load_torque", rig.gearbox.load_torque) / rig.gearbox.load_torque)
        effects = [
            effect.with_parameters(rms_nm=_scaled(effect.rms_nm, factor))
            if effect.effect_id == "load_drift"
            else effect
            for effect in rig.effects
        ]
        return rig.replace(gearbox=rig.gearbox.replace(**changes), effects=effects)


@dataclass(frozen=True)
class Radial:
    """Range of the depth of radial wear in um, and the probability that a worn assembly has it."""

    wear_um: tuple[float, float]
    share: float

    @classmethod
    def checked(cls, wear_um: Any, share: Any) -> Radial | None:
        from cyclofeat.simulators.defects import MOST_WEAR_UM

        if not 0 < checks.number("radial_share", share, "a share") <= 1:
            raise ValueError(f"radial_share must be above 0 and at most 1, got {share!r}")
        if wear_um is None:
            if share != 1:
                raise ValueError(f"radial_share needs wear_um, the depth of the wear, got {share!r} without")
            return None
        low, high = checks.ends("wear_um", wear_um, "a number of um")
        if not 0 <= low <= high <= MOST_WEAR_UM:
            raise ValueError(
                f"wear_um must be a number of um or a range (low, high) within 0 to {MOST_WEAR_UM:g}, "
                f"got {wear_um!r}"
            )
        return cls((low, high), share)

    def drawn(self, defects: LobeDefects, random: np.random.Generator) -> LobeDefects:
        """Return the defects of one assembly: with radial wear, or as they are."""
        low, high = self.wear_um
        share = random.random()
        depth = high * share if low == 0 else _log_uniform(self.wear_um, share)
        return replace(defects, depth=0.0, wear_um=depth) if random.random() < self.share else defects


def _scaled(value: Any, factor: float) -> Any:
    """Return a parameter's number or range times a factor."""
    if factor == 1:
        return value
    ends = checks.members(value)
    if ends is not None:
        return tuple(factor * end for end in ends)
    if not checks.is_number(value):
        raise ValueError(
            f"load_nm scales the load drift, whose rms_nm must then be a number or a range, got {value!r}"
        )
    return factor * value


def _positive_range(name: str, given: Any, unit: str) -> tuple[float, float] | None:
    if given is None:
        return None
    low, high = checks.ends(name, given, f"a number of {unit}")
    checks.positive(name, low)
    if low > high:
        raise ValueError(f"{name} must be a range (low, high) with low <= high, got {given!r}")
    return low, high


def _log_uniform(ends: tuple[float, float], share: float) -> float:
    low, high = ends
    return float(min(low * (high / low) ** share, high))  # rounding must not leave the range
