"""Prior over rigs: which effects they have, how large, and under which conditions they are recorded."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.stats import hypergeom

from cyclofeat.gap.simulations import with_may_differ
from cyclofeat.simulators import Drift, Effect, Noise, Rig, known_effects

Float = NDArray[np.float64]

# Assumption: no rig is free of noise, and no brake free of drift.
FLOOR: tuple[Effect, ...] = (Noise(0.02), Drift(0.05, 1.5))
# Assumptions: a rig may be made better than ``MAY_DIFFER`` states, or somewhat worse (a factor on all of it),
# and its recordings may all be of one assembly, whose pins they share.
TOLERANCES = (0.0, 1.5)
_ONE_ASSEMBLY = 1 / 3
_REVERSED = 1 / 3  # share of the conditions in reverse


@dataclass(frozen=True)
class DrawnSession:
    """Conditions of the recordings of one machine, arrays of shape (n_recordings,).

    Set-points of speed and load, direction (-1 in reverse) and worn lobes; recordings with equal numbers in
    ``assemblies`` are of one assembly. ``tolerance`` is a factor on all that differs anyway.
    """

    speeds_rpm: Float = field(repr=False)
    loads_nm: Float = field(repr=False)
    directions: NDArray[np.int64] = field(repr=False)
    counts: NDArray[np.int64] = field(repr=False)
    assemblies: NDArray[np.int64] = field(repr=False)
    tolerance: float = 1.0


@dataclass(frozen=True)
class EffectPrior:
    """Random sets of effects that a model may lack.

    The number of effects has equal probabilities from 0 to ``most``; each set of that number is equally
    probable, and sizes follow the priors of the effects' parameters. Several rigs share a machine: first the
    effects that the gearbox answers are drawn, then, for each rig, those on the torque signal alone, with
    the probabilities that they have given the first.

    Parameters
    ----------
    effects : sequence of Effect
        With the settings that they are to have; sizes are drawn.
    most : int
        Largest number of effects at once.
    """

    effects: tuple[Effect, ...]
    most: int

    @functools.cached_property
    def _effect_shares(self) -> Float:
        """Probability of a number of effects in the machine (rows) and in all (columns)."""
        n_in_machine, total = np.ogrid[: self.most + 1, : self.most + 1]
        n_answered = sum(effect.needs_simulation() for effect in self.effects)
        shares = hypergeom.pmf(n_in_machine, len(self.effects), n_answered, total)
        return np.asarray(shares / (self.most + 1))

    def in_machine(self, random: np.random.Generator) -> tuple[Effect, ...]:
        """Draw the effects that the gearbox answers."""
        n = random.choice(self.most + 1, p=self._effect_shares.sum(axis=1))
        return self._draw_effects(n, True, random)

    def on_torque(self, n_in_machine: int, random: np.random.Generator) -> tuple[Effect, ...]:
        """Draw the effects on the torque signal of a machine that has ``n_in_machine`` others."""
        shares = self._effect_shares[n_in_machine]
        n = random.choice(self.most + 1, p=shares / shares.sum()) - n_in_machine
        return self._draw_effects(n, False, random)

    def _draw_effects(self, n: int, in_machine: bool, random: np.random.Generator) -> tuple[Effect, ...]:
        possible = [effect for effect in self.effects if effect.needs_simulation() == in_machine]
        chosen = sorted(random.choice(len(possible), n, replace=False)) if n else []
        return tuple(possible[k].draw_parameters(random) for k in chosen)


def missing_effects(rig: Rig) -> tuple[Effect, ...]:
    """Return the known effects that have a prior and that the rig does not have, with default values.

    With a user's simulator, its own take the place of those of the toolkit's gearbox.
    """
    unanswered = "change_simulator" if rig.simulator is None else "change_gearbox"
    stated = {effect.effect_id for effects in rig.effect_sets() for effect in effects}
    stated |= {"brake_rotor"} if rig.has_brake else set()
    return tuple(
        effect
        for name, effect in known_effects().items()
        if effect.vector_names() and name not in stated and not effect.overrides(unanswered)
    )


def with_floor(rig: Rig, may_differ: Sequence[Effect], tolerance: float = 1.0) -> Rig:
    """Return the rig with so much of what may differ anyway, and with noise and drift where it has none."""
    return with_may_differ(rig, (*(_scale_spread(one, tolerance) for one in may_differ), *FLOOR))


def _scale_spread(effect: Effect, factor: float) -> Effect:
    """Return an effect with its parameters' distances from neutral changed by a factor, but distributions."""
    changed = {}
    for name, parameter in effect.parameters.items():
        value, neutral = getattr(effect, name), parameter.neutral
        if neutral is not None and isinstance(value, int | float | tuple):
            ends = neutral + factor * (np.array(value) - neutral)
            changed[name] = tuple(ends.tolist()) if ends.ndim else float(ends)
    return effect.with_parameters(**changed)


def draw_session(
    speeds_rpm: tuple[float, float],
    loads_nm: tuple[float, float],
    defect_counts: Sequence[int],
    n_recordings: int,
    random: np.random.Generator,
) -> DrawnSession:
    """Draw one or three conditions, which the recordings take in turn, and what differs between them."""
    speeds, loads = random.uniform(*speeds_rpm, 3), random.uniform(*loads_nm, 3)
    directions = np.where(random.random(3) < _REVERSED, -1, 1)
    n_conditions = 3 if random.random() < 0.5 else 1
    at = np.arange(n_recordings) % n_conditions
    counts = random.choice(np.array(defect_counts), n_recordings)
    one_assembly = random.random() < _ONE_ASSEMBLY
    assemblies = np.zeros(n_recordings, dtype=np.int64) if one_assembly else np.arange(n_recordings)
    tolerance = random.uniform(*TOLERANCES)
    return DrawnSession(speeds[at], loads[at], directions[at], counts, assemblies, tolerance)
