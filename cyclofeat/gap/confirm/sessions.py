"""Simulation of sessions like a measured one, of given rigs and their changes, and of drawn rigs."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import joblib
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from cyclofeat._base.progress import stopped_quietly
from cyclofeat.gap.engine.sets import Column
from cyclofeat.gap.world.prepare import DrawnMachine, collect_rigs, simulate_drawn
from cyclofeat.gap.world.world import TOLERANCES, Rigs, Session, World, size_names
from cyclofeat.simulators import Effect, SimulationFailed
from cyclofeat.simulators.effects import EffectParameter

Float = NDArray[np.float64]
# Effects on the gearbox, effects on the torque signal of each rig, factor on what differs anyway.
DrawnRigs = tuple[tuple[Effect, ...], list[tuple[Effect, ...]], float]

MOST_RECORDINGS = 12  # of a session, that are simulated
_RIGS_PER_MACHINE = 2  # with different effects on the torque signal
_MACHINES_AT_ONCE = 4


def simulate_pairs(
    world: World,
    template: Session,
    rigs: Sequence[tuple[Sequence[Effect], float]],
    n_sessions: Sequence[int],
    *,
    random_state: int,
    n_jobs: int = 1,
) -> list[Float]:
    """Simulate sessions with the conditions of a template, of rigs that share all random numbers.

    A rig is its effects and a factor on what differs anyway; equal effects on the gearbox share its runs.
    Each has its number of sessions, and session ``k`` of all has the same random numbers; unknown counts are
    drawn. Returns cells (n_sessions, n_recordings, n_cells) of each rig, NaN where a simulation failed.
    """
    machines: dict[tuple[tuple[Effect, ...], float], list[int]] = {}
    for k, (effects, tolerance) in enumerate(rigs):
        in_machine = tuple(effect for effect in effects if effect.needs_simulation())
        machines.setdefault((in_machine, tolerance), []).append(k)
    drawn, places = [], []
    for (in_machine, tolerance), sharing in machines.items():
        for number in range(max(n_sessions[k] for k in sharing)):
            members = [k for k in sharing if number < n_sessions[k]]
            on_torque = [tuple(one for one in rigs[k][0] if not one.needs_simulation()) for k in members]
            seed = np.random.SeedSequence([random_state, number])
            drawn.append(_draw_machine(world, template, (in_machine, on_torque, tolerance), seed))
            places.append((members, number))
    cells = [np.full((n, *template.values.shape), np.nan) for n in n_sessions]
    for columns, (members, number) in zip(_simulate_machines(world, drawn, n_jobs), places, strict=True):
        for k, values in zip(members, columns["values"], strict=True):
            cells[k][number] = values
    return cells


def simulate_prior(
    world: World,
    template: Session,
    n_rigs: int,
    *,
    random_state: int,
    n_jobs: int = 1,
    progress: Callable[[int, int], object] | None = None,
) -> Rigs:
    """Simulate sessions with the conditions of a template, of rigs whose effects are drawn from the prior.

    Two rigs at a time share the runs of a machine; unknown counts are drawn. ``progress`` is called with the
    number of rigs done and ``n_rigs``. Rigs with too many failed recordings are left out; raises
    SimulationFailed if all are.
    """

    def draw_rigs(random: np.random.Generator) -> DrawnRigs:
        in_machine = world.prior.in_machine(random)
        n = len(in_machine)
        return in_machine, [world.prior.on_torque(n, random) for _ in range(_RIGS_PER_MACHINE)], 1.0

    parts: list[dict[str, NDArray[Any]]] = []
    n_machines = -(-n_rigs // _RIGS_PER_MACHINE)
    seeds = np.random.SeedSequence(random_state).spawn(n_machines)
    machines = [_draw_machine(world, template, draw_rigs, seed) for seed in seeds]
    for part in _simulate_machines(world, machines, n_jobs):
        parts.append(part)
        if progress is not None:
            progress(min(len(parts) * _RIGS_PER_MACHINE, n_rigs), n_rigs)
    usable = collect_rigs(world, parts, n_rigs, _RIGS_PER_MACHINE)
    if not len(usable):
        raise SimulationFailed(f"none of {n_rigs} simulated rigs gave enough recordings")
    return usable


def _draw_machine(
    world: World,
    template: Session,
    rigs: DrawnRigs | Callable[[np.random.Generator], DrawnRigs],
    seed: np.random.SeedSequence,
) -> DrawnMachine:
    """Return a machine with the conditions of a session, and rigs that are given or drawn."""
    n = len(template.values)
    assemblies = np.arange(n) if template.assemblies is None else template.assemblies
    for_draws, *for_runs = seed.spawn(n + 1)
    random = np.random.default_rng(for_draws)
    counts = template.counts
    if counts is None:
        counts = random.choice(np.array(world.defect_counts), n)
    in_machine, on_torque, tolerance = rigs(random) if callable(rigs) else rigs
    session = dataclasses.replace(template, counts=counts, assemblies=assemblies)
    return DrawnMachine(in_machine, on_torque, session, tolerance, for_runs)


def _simulate_machines(
    world: World, machines: Sequence[DrawnMachine], n_jobs: int
) -> Iterator[dict[str, NDArray[Any]]]:
    """Yield the columns of the rigs of each machine."""
    parts = [machines[k : k + _MACHINES_AT_ONCE] for k in range(0, len(machines), _MACHINES_AT_ONCE)]
    calls = (joblib.delayed(simulate_drawn)(world, part) for part in parts)
    with stopped_quietly(joblib.Parallel(n_jobs=n_jobs, return_as="generator")(calls)) as made:
        for part in made:
            yield from part


def limit_recordings(session: Session, most: int) -> Session:
    """Return at most ``most`` recordings of a session, round-robin over its conditions."""
    _, of_condition = np.unique(session.conditions, axis=0, return_inverse=True)
    earlier = np.array([np.sum(of_condition[:k] == condition) for k, condition in enumerate(of_condition)])
    rows = np.sort(np.argsort(earlier, kind="stable")[:most])
    shown = {name: values[rows] for name, values in vars(session).items() if values is not None}
    return dataclasses.replace(session, **shown)


def with_sizes(effects: Sequence[Effect], sizes: Float) -> tuple[Effect, ...]:
    """Return effects with sizes on the scale of their fit, held within their bounds."""
    made, first = [], 0
    for effect in effects:
        low, high = effect.vector_bounds()
        part = sizes[first : first + low.size]
        first += low.size
        made.append(effect.from_vector(np.clip(part, low, high)))
    return tuple(made)


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
    anyway. ``guesses``: mean and standard deviation of each coordinate before any simulation, by name as
    "effect.parameter"; ``covariances``: what is known of the sizes of each effect, by its name.

    Rigs are changed along the principal axes of each effect's sizes, in units of the guesses' deviations:
    sizes that compensate each other, as an inertia and a stiffness at one resonance, change together, so that
    what bends with their common change is simulated.
    """

    effects: tuple[Effect, ...]
    tolerance: float
    guesses: Mapping[str, tuple[float, float]]
    covariances: Mapping[str, Float]

    @functools.cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the coordinates."""
        return *size_names(self.effects), TOLERANCE

    @functools.cached_property
    def coordinates(self) -> Float:
        """Sizes of all effects, and the factor."""
        return np.concatenate([*(effect.to_vector() for effect in self.effects), [self.tolerance]])

    @functools.cached_property
    def owners(self) -> tuple[str, ...]:
        """Effect of each coordinate."""
        return tuple(name.partition(".")[0] for name in self.names)

    @functools.cached_property
    def axes(self) -> Float:
        """Change of the coordinates (rows) with each axis (columns)."""
        return np.asarray(block_diag(*(axes for axes, _ in self._principal_axes)))

    def at(self, coordinates: Float) -> DrawnRig:
        """Return the rig at coordinates, which are held within their bounds."""
        return with_sizes(self.effects, coordinates), float(np.clip(coordinates[-1], *TOLERANCES))

    def moved(self, along: Float) -> Point:
        """Return the point that is moved along the axes."""
        return Point(*self.at(self.coordinates + self.axes @ along), self.guesses, self.covariances)

    def size_changes(self) -> list[RigChange]:
        """Return the changes along each axis to both sides, twice to one side at the end of its range."""
        bounds = np.vstack([*(np.transpose(effect.vector_bounds()) for effect in self.effects), TOLERANCES])
        low, high = (bounds - self.coordinates[:, None]).T
        mean, spread = np.array([self.guesses[name] for name in self.names]).T
        units = np.array([*(unit for effect in self.effects for unit in relative_units(effect)), 1.0])
        least, most = np.minimum(_LEAST * units, _LEAST_OF_GUESS * spread), _MOST * units
        least[-1] = most[-1] = _TOLERANCE_STEP
        steps = np.concatenate([steps for _, steps in self._principal_axes])
        means = np.linalg.solve(self.axes, mean - self.coordinates)
        changes = []
        for axis, owner, step, middle in zip(self.axes.T, self.owners, steps, means, strict=True):
            shortest, longest = (1 / np.max(np.abs(axis) / ends) for ends in (least, most))
            step = float(np.clip(step, shortest, longest))
            inside = [bool(np.all((low <= way * axis) & (way * axis <= high))) for way in (step, -step)]
            way = step if inside[0] else -step
            places: tuple[float, ...] = (step, -step) if all(inside) else (way, 2 * way)
            places = places[:1] if owner == TOLERANCE else places
            rigs = tuple(self.at(self.coordinates + place * axis) for place in places)
            changes.append(RigChange(Column("size", owner, middle), places, rigs))
        return changes

    @functools.cached_property
    def _principal_axes(self) -> list[tuple[Float, Float]]:
        """Axes of each effect's sizes, and of the factor, and their deviations."""
        found = []
        for owner in dict.fromkeys(self.owners):
            names = (name for name, of in zip(self.names, self.owners, strict=True) if of == owner)
            spread = np.array([self.guesses[name][1] for name in names])
            known = self.covariances.get(owner, np.diag(spread**2)) / np.outer(spread, spread)
            squares, vectors = np.linalg.eigh(known)
            found.append((spread[:, None] * vectors, np.sqrt(np.maximum(squares, 0))))
        return found

    def set_changes(self, guessed: Iterable[Effect]) -> list[RigChange]:
        """Return the rigs without each of the effects, and those with one of the ``guessed`` added."""
        changes = []
        for effect in self.effects:
            rest = tuple(one for one in self.effects if one is not effect)
            column = Column("without", effect.effect_id)
            changes.append(RigChange(column, (1.0,), ((rest, self.tolerance),)))
        for effect in guessed:
            spread = self.guesses[f"{effect.effect_id}.{effect.main_parameter}"][1] / 2
            added, mean, least = with_likely_size(effect, spread)
            column = Column("with", effect.effect_id, mean, least=least)
            changes.append(RigChange(column, (1.0,), (((*self.effects, added), self.tolerance),)))
        return changes


def relative_units(effect: Effect) -> list[float]:
    """Return the change of each fitted coordinate that changes its size by 100 %."""
    return [
        1.0 if (parameter := effect.parameters[name]).log
        else max(abs(float(getattr(effect, name)) - (parameter.neutral or 0.0)), 1e-6)
        for name in effect.vector_names()
    ]  # fmt: skip


def _has_two_sides(parameter: EffectParameter) -> bool:
    neutral = parameter.neutral
    return not parameter.log and neutral is not None and parameter.low < neutral < parameter.high


def with_likely_size(effect: Effect, spread: float) -> tuple[Effect, float, float]:
    """Return an effect as it is added to a rig, with mean and least of its strength.

    A size that may lie on either side of its neutral value is guessed near it if it is hardly known, perhaps
    on the wrong side. It is then as far away as the deviation of the guess, ``spread``, and any strength is
    allowed. Others have their guess, and a strength of 0.3 or more.
    """
    name, vector = effect.main_parameter, effect.to_vector()
    parameter, place = effect.parameters[name], effect.vector_names().index(name)
    if not _has_two_sides(parameter):
        return effect, 1.0, _STRENGTHS[0]
    guess = vector[place] - (neutral := parameter.neutral or 0.0)
    likely = math.copysign(math.hypot(guess, spread), guess)
    vector[place] = neutral + likely
    return effect.from_vector(np.clip(vector, *effect.vector_bounds())), guess / likely, -math.inf


def with_strength(effect: Effect, factor: float) -> Effect:
    """Return an effect stronger by a factor from 0.3 to 2; itself if its neutral value is infinite.

    A negative factor leads to the other side of the neutral value, if that is possible.
    """
    name = effect.main_parameter
    parameter, value = effect.parameters[name], float(getattr(effect, name))
    neutral = parameter.neutral or 0.0
    if math.isinf(neutral):
        return effect
    sign = math.copysign(1.0, factor) if _has_two_sides(parameter) else 1.0
    factor = sign * float(np.clip(sign * factor, *_STRENGTHS))
    if parameter.log and neutral:
        changed = neutral * (value / neutral) ** factor
    else:
        changed = neutral + factor * (value - neutral)
    vector = effect.to_vector()
    vector[effect.vector_names().index(name)] = math.log(changed) if parameter.log else changed
    return effect.from_vector(np.clip(vector, *effect.vector_bounds()))
