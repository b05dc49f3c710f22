"""Changes of a rig whose responses are simulated: of each size, of the set of effects."""

from __future__ import annotations

import functools
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cyclofeat.gap.confirm.sessions import with_sizes
from cyclofeat.gap.engine.sets import Column
from cyclofeat.gap.world.world import TOLERANCES
from cyclofeat.simulators import Effect

Float = NDArray[np.float64]
DrawnRig = tuple[tuple[Effect, ...], float]
"""Effects of a rig, and the factor on what differs between recordings anyway."""

TOLERANCE = ""  # key of that factor among the sizes
_LEAST, _MOST = 0.03, 0.4  # relative changes of a size
_LEAST_OF_GUESS = 0.25  # change over the deviation of a guess that is closer than these
_TOLERANCE_STEP = 0.4
_STRENGTHS = (0.3, 2.0)  # of an added effect, over its guess


class RigChange(NamedTuple):
    """Rigs along a coordinate, at some places from the unchanged rig, and what the coordinate is."""

    column: Column
    places: tuple[float, ...]
    rigs: tuple[DrawnRig, ...]


@dataclass(frozen=True)
class Point:
    """Rig around which responses are simulated.

    Its coordinates are the sizes of its effects on the scale of their fit, then the factor on what differs
    anyway. ``guesses`` are mean and standard deviation of each coordinate before any simulation, ``steps``
    the changes of coordinates, both by name, "effect.parameter".
    """

    effects: tuple[Effect, ...]
    tolerance: float
    guesses: Mapping[str, tuple[float, float]]
    steps: Mapping[str, float]

    @functools.cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the coordinates."""
        sizes = (f"{one.effect_id}.{name}" for one in self.effects for name in one.vector_names())
        return *sizes, TOLERANCE

    @functools.cached_property
    def coordinates(self) -> Float:
        """Sizes of all effects, and the factor."""
        return np.concatenate([*(effect.to_vector() for effect in self.effects), [self.tolerance]])

    @functools.cached_property
    def bounds(self) -> Float:
        """Lowest and highest coordinates, shape (n_coordinates, 2)."""
        return np.vstack([*(np.transpose(effect.vector_bounds()) for effect in self.effects), TOLERANCES])

    @functools.cached_property
    def units(self) -> Float:
        """Change of each coordinate that changes its size by 100 %."""
        return np.array([*(unit for effect in self.effects for unit in relative_units(effect)), 1.0])

    def at(self, coordinates: Float) -> DrawnRig:
        """Return the rig at coordinates, which are held within their bounds."""
        return with_sizes(self.effects, coordinates), float(np.clip(coordinates[-1], *TOLERANCES))

    def moved(self, change: Float) -> Point:
        """Return the point at changed coordinates."""
        return Point(*self.at(self.coordinates + change), self.guesses, self.steps)

    def size_changes(self) -> list[RigChange]:
        """Return the changes of each size to both sides, twice to one side at the end of its range."""
        changes = []
        for k, name in enumerate(self.names):
            low, high = self.bounds[k] - self.coordinates[k]
            mean, spread = self.guesses[name]
            least = min(_LEAST * self.units[k], _LEAST_OF_GUESS * spread)
            step = float(np.clip(self.steps.get(name, spread), least, _MOST * self.units[k]))
            places: tuple[float, ...] = (step, -step) if low <= -step and step <= high else (step, 2 * step)
            if name == TOLERANCE:
                places = (_TOLERANCE_STEP,)
            if places[0] > high:
                places = tuple(-place for place in places)
            along = np.arange(len(self.names)) == k
            rigs = tuple(self.at(self.coordinates + place * along) for place in places)
            column = Column("size", name.partition(".")[0], mean - self.coordinates[k], spread**-2)
            changes.append(RigChange(column, places, rigs))
        return changes

    def set_changes(self, added: Iterable[Effect]) -> list[RigChange]:
        """Return the rigs without each of the effects, and those with another one."""
        changes = []
        for effect in self.effects:
            rest = tuple(one for one in self.effects if one is not effect)
            column = Column("without", effect.effect_id)
            changes.append(RigChange(column, (1.0,), ((rest, self.tolerance),)))
        for effect in added:
            rig = (*self.effects, effect), self.tolerance
            changes.append(RigChange(Column("with", effect.effect_id), (1.0,), (rig,)))
        return changes


def relative_units(effect: Effect) -> list[float]:
    """Return the change of each fitted coordinate that changes its size by 100 %."""
    return [
        1.0 if (parameter := effect.parameters[name]).log
        else max(abs(float(getattr(effect, name)) - (parameter.neutral or 0.0)), 1e-6)
        for name in effect.vector_names()
    ]  # fmt: skip


def with_strength(effect: Effect, factor: float) -> Effect:
    """Return an effect that is stronger by a factor, which is held between 0.3 and 2."""
    factor = float(np.clip(factor, *_STRENGTHS))
    name = effect.main_parameter
    parameter, value = effect.parameters[name], float(getattr(effect, name))
    neutral = parameter.neutral or 0.0
    if parameter.log and neutral:
        changed = neutral * (value / neutral) ** factor
    else:
        changed = neutral + factor * (value - neutral)
    vector = effect.to_vector()
    vector[effect.vector_names().index(name)] = math.log(changed) if parameter.log else changed
    return effect.from_vector(np.clip(vector, *effect.vector_bounds()))
