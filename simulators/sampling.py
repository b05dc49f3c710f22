"""Draw assemblies and recordings of rigs: errors, conditions, worn lobes and machines, from seeds to runs.

Equal seeds give equal recordings, to the last bit, alone or in a batch. Common random numbers: recordings
with equal ``assembly`` seeds are of one machine, and recordings with equal ``random_state`` share start
angle, drift and noise, whatever their worn lobes, loads and other effects are.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, TypeVar

import numpy as np

from cyclofeat._base import checks
from cyclofeat.simulators.defects import MOST_WEAR_UM, LobeDefects
from cyclofeat.simulators.effects import Drift, Effect, Gain, Hum, Noise, Offset, TorqueMeterLowPass
from cyclofeat.simulators.effects.effect import EffectParameter, from_plain, is_distribution, to_plain
from cyclofeat.simulators.effects.library import child_seed
from cyclofeat.simulators.machine import MachineRun, PlannedRun
from cyclofeat.simulators.many import simulate_each
from cyclofeat.simulators.rig import DEFECTS, Rig
from cyclofeat.simulators.simulation import SimulationFailed, SimulationRun, Solver, solver_within

T = TypeVar("T")
Seed = np.random.SeedSequence

# Children of a recording's seed. The second is the stream of the start angle too; those before the fifth are
# the rig's.
_CONDITIONS, _REDRAWN = 2, 5
# Assumptions: errors and drift as multiples of what the rig states, and noise, log-uniform.
_ERRORS, _NOISE = (0.0, 1.5), (0.1, 1.5)
# Largest hum, drift and offset of a torque meter as shares of the load, its gain, its lowest cut-off in Hz.
_HUM, _DRIFT, _OFFSET, _GAIN, _CUTOFF_HZ = 0.014, 0.14, 0.09, 0.05, 300.0
_BELOW_NYQUIST = 0.9
# Probability of each of these five.
_HARMLESS = 1 / 8


def recording_seed(random_state: int, name: str, index: int) -> Seed:
    """Return the seed of one of many recordings of a rig or campaign of this name."""
    return Seed([random_state, *name.encode()], spawn_key=(index,))


@dataclass(frozen=True, kw_only=True)
class Sample:
    """One recording to simulate."""

    rig: Rig  #: at the speed and load of the recording
    defects: LobeDefects
    duration: float  #: in s
    sampling_rate: float  #: in Hz
    random_state: Seed  #: of the run: start angle, drift and noise
    assembly: Seed | None = None  #: seed of the machine; default: that of the run
    quantity: str = "output_torque"  #: what is measured
    solver: Solver | None = None  #: time step and integrator
    #: In place of a solver: largest error of the torque, in Nm rms (:func:`simulation.solver_within`).
    error_nm: float | None = None
    chains: Sequence[Sequence[Effect]] = ()  #: effects of later records, for which the run suffices
    name: str = ""  #: name of the assembly, for errors

    def plan(self, n_failed: int = 0) -> PlannedRun:
        """Draw the machine and state its run; another machine after each of ``n_failed`` that could not run.

        Raises ValueError if the rig cannot be built.
        """
        seed = child_seed(self.random_state, _REDRAWN + n_failed - 1) if n_failed else self.random_state
        try:
            planned = self.rig.plan_run(
                self.defects, duration=self.duration, sampling_rate=self.sampling_rate, random_state=seed,
                assembly=self.assembly, quantity=self.quantity, chains=self.chains, solver=self.solver,
                torque_in=False, motion=False,  # plan_run sets torque_in where it is measured
            )  # fmt: skip
        except ValueError as error:
            if not self.name:
                raise
            raise ValueError(f"assembly {self.name}: {error}") from None
        if self.error_nm is not None:
            solver = solver_within(planned.machine.gearbox, self.sampling_rate, self.error_nm)
            planned.arguments["solver"] = solver
        return planned


class SampledRun(NamedTuple):
    """Run of a sample, or the error of the last machine that was drawn for it."""

    plan: PlannedRun  #: machine and arguments of the run
    run: MachineRun | SimulationFailed | ValueError  #: ValueError: a motor that does not hold its speed
    failures: list[str]  #: errors of the machines that could not run


def sample_each(
    samples: Sequence[Sample], then: Callable[[int, SampledRun], T], *, kernel: str = "auto", n_jobs: int = 1,
    most_draws: int = 1,
) -> Generator[tuple[int, T], None, None]:  # fmt: skip
    """Yield the place of each sample, and what ``then`` makes of place and run in the thread that made it.

    ``kernel`` and ``n_jobs`` as in :func:`cyclofeat.simulators.simulate_many`. For each sample, up to
    ``most_draws`` machines are drawn until one can run.
    """
    plans = dict(enumerate(sample.plan() for sample in samples))

    def finish(place: int, simulated: SimulationRun | SimulationFailed) -> T:
        plan, failures = plans.pop(place), list[str]()
        while True:
            run = _finish_or_error(plan, simulated)
            if not isinstance(run, Exception):
                return then(place, SampledRun(plan, run, failures))
            failures.append(str(run))
            if len(failures) == most_draws:
                return then(place, SampledRun(plan, run, failures))
            plan = samples[place].plan(len(failures))
            ((_, simulated),) = simulate_each([plan.arguments], "exact")

    yield from simulate_each([plan.arguments for plan in plans.values()], kernel, n_jobs, finish)


def sample_runs(
    samples: Sequence[Sample | PlannedRun | ValueError], *, kernel: str = "auto"
) -> list[MachineRun | SimulationFailed | ValueError]:
    """Simulate recordings of rigs, in batches where possible; a failure is a result.

    Samples may be drawn already (:meth:`cyclofeat.simulators.Rig.plan_run`); an error stands for itself.
    Results have the order of the samples, and each depends on its own sample and the kernel only. A
    ValueError is that of a machine that cannot be built or run.
    """
    checks.one_of("kernel", kernel, ("exact", "batch", "auto"))
    runs: list[Any] = []
    for sample in samples:
        try:
            runs.append(sample.plan() if isinstance(sample, Sample) else sample)
        except ValueError as error:
            runs.append(error)
    places = [place for place, plan in enumerate(runs) if isinstance(plan, PlannedRun)]
    plans = [runs[place] for place in places]
    try:
        for number, simulated in simulate_each([plan.arguments for plan in plans], kernel):
            runs[places[number]] = _finish_or_error(plans[number], simulated)
    except ValueError as error:  # of one of them
        for place, plan in zip(places, plans, strict=True):
            if runs[place] is plan:
                (runs[place],) = sample_runs([plan], kernel=kernel) if len(plans) > 1 else [error]
    return runs


def _finish_or_error(
    plan: PlannedRun, simulated: SimulationRun | SimulationFailed
) -> MachineRun | SimulationFailed | ValueError:
    """Return the machine's run; the ValueError of a motor that does not hold its speed."""
    if isinstance(simulated, SimulationFailed):
        return simulated
    try:
        return plan.finish_run(simulated)
    except ValueError as error:
        return error


@dataclass(frozen=True, kw_only=True)
class Wear:
    """What the worn lobes of assemblies have in common; the rest is drawn."""

    #: Neighbours from a random first lobe; any ("random"); one or the other with equal chances ("mixed").
    lobes: str = "consecutive"
    wheels: tuple[int, ...] | None = None  #: default: wheel 0 alone or both, with equal chances
    depth: float = 1.0  #: severity of the chord
    #: Range of radial wear in place of the chord; log-uniform unless it begins at 0.
    wear_um: tuple[float, float] | None = None
    radial_share: float = 1.0  #: probability of radial wear; the other assemblies have the chord

    def __post_init__(self) -> None:
        checks.one_of("lobes", self.lobes, ("consecutive", "random", "mixed"))
        if not 0 < checks.number("radial_share", self.radial_share, "a share") <= 1:
            raise ValueError(f"radial_share must be above 0 and at most 1, got {self.radial_share!r}")
        if self.wear_um is None and self.radial_share != 1:
            raise ValueError(f"radial_share needs wear_um, got {self.radial_share!r} without")
        if self.wear_um is not None and not 0 <= self.wear_um[0] <= self.wear_um[1] <= MOST_WEAR_UM:
            raise ValueError(f"wear_um must be a range within 0 to {MOST_WEAR_UM:g} um, got {self.wear_um!r}")

    def draw(self, count: int, n_lobes: int, random_state: Seed) -> LobeDefects:
        """Draw ``count`` worn lobes of a recording, and then their wear: the lobes do not depend on it."""
        random = np.random.default_rng(child_seed(random_state, DEFECTS))
        consecutive = self.lobes == "consecutive" or (self.lobes == "mixed" and bool(random.random() < 0.5))
        defects = draw_worn_lobes(count, n_lobes, random, consecutive, self.wheels, self.depth)
        if self.wear_um is None:
            return defects
        share = random.random()
        wear_um = self.wear_um[1] * share if self.wear_um[0] == 0 else log_uniform(self.wear_um, share)
        radial = random.random() < self.radial_share
        return replace(defects, depth=0.0, wear_um=wear_um) if radial else defects


def draw_worn_lobes(
    count: int, n_lobes: int, random: np.random.Generator, consecutive: bool = True,
    wheels: tuple[int, ...] | None = None, depth: float = 1.0,
) -> LobeDefects:  # fmt: skip
    """Draw neighbouring lobes from a random first one, or any, by default on wheel 0 alone or on both."""
    # Drawn even if wheels are given, so that the lobes are the same.
    one_wheel = random.random() < 0.5
    if consecutive:
        worn = (random.integers(n_lobes) + np.arange(count)) % n_lobes
    else:
        worn = random.permutation(n_lobes)[:count]
    return LobeDefects.worn(worn.tolist(), wheels=wheels or ((0,) if one_wheel else (0, 1)), depth=depth)


def draw_conditions(
    rig: Rig, speed_rpm: tuple[float, float] | None, load_nm: tuple[float, float] | None, random_state: Seed
) -> Rig:
    """Return the rig at a speed (RPM) and a load (Nm) drawn log-uniformly from ranges; None keeps its own.

    Below the gearbox's load, the load drift shrinks in proportion to the load.
    """
    shares = np.random.default_rng(child_seed(random_state, _CONDITIONS)).random(2)
    if speed_rpm is None and load_nm is None:
        return rig
    speed = None if speed_rpm is None else log_uniform(speed_rpm, shares[0])
    load = rig.gearbox.load_torque if load_nm is None else log_uniform(load_nm, shares[1])
    # A brake drifts with its load, but the rig states no more than this drift.
    factor = min(1.0, load / rig.gearbox.load_torque)
    effects = [_scaled(one, factor) if one.effect_id == "load_drift" else one for one in rig.effects]
    return rig.replace(effects=effects).at(speed, load)


def vary_errors(rig: Rig, random: np.random.Generator, sampling_rate: float) -> Rig:
    """Return the rig of one assembly with as much of its errors as a better or a poorer bench has.

    Errors of the geometry, all by one factor, and drift are uniform from none to 1.5 times what the rig
    states; noise is log-uniform from a tenth to 1.5 times. With a probability of 1/8 each, the assembly has
    mains hum, a meter that drifts, one with an offset, one with another gain, or one with a low-pass. None of
    it spoils a count (all *assumptions*).

    ``sampling_rate`` in Hz limits the cut-off of the low-pass.
    """
    geometry, drift = random.uniform(*_ERRORS, 2).tolist()
    noise = log_uniform(_NOISE, random.random())

    def varied(effect: Effect) -> Effect:
        if isinstance(effect, Noise):
            return _scaled(effect, noise)
        if isinstance(effect, Drift):
            return _scaled(effect, drift)
        return _scaled(effect, geometry) if effect.place == "geometry" else effect

    load, share, side = abs(rig.gearbox.load_torque), random.random(), float(random.uniform(-1, 1))
    harmless: tuple[Effect, ...] = (
        Hum(_HUM * load * 15 ** (share - 1)), Drift(_DRIFT * load * share, 1.5, of="sensor"),
        Offset(_OFFSET * load * side), Gain(1 + _GAIN * side),
        TorqueMeterLowPass(min(_CUTOFF_HZ * 7**share, _BELOW_NYQUIST * sampling_rate / 2)),
    )  # fmt: skip
    chosen = int(random.random() / _HARMLESS)
    return rig.replace(
        effects=(*map(varied, rig.effects), *harmless[chosen : chosen + 1]),
        variants=tuple(tuple(map(varied, one)) for one in rig.variants),
    )


def _scaled(effect: Effect, factor: float) -> Effect:
    """Return an effect whose sizes that are neutral at 0 are multiplied, as far as they are allowed."""
    scaled = {
        name: scale_size(one, getattr(effect, name), factor)
        for name, one in effect.parameters.items()
        if one.neutral == 0
    }
    return effect.with_parameters(**scaled)


def scale_size(parameter: EffectParameter, value: Any, factor: float) -> Any:
    """Return a number or a range whose distance from the neutral value is multiplied, as far as is allowed.

    A distribution, whose neutral value must be 0, is multiplied as a whole.
    """
    if is_distribution(value):
        plain = to_plain(value, is_parameter=True)
        return from_plain(
            plain | {name: factor * plain.get(name, at) for name, at in (("loc", 0.0), ("scale", 1.0))}
        )
    neutral = parameter.neutral or 0.0
    scaled = neutral + factor * (np.asarray(value, dtype=float) - neutral)
    size = np.clip(scaled, parameter.low, parameter.high).tolist()
    return tuple(size) if isinstance(size, list) else size


def log_uniform(ends: tuple[float, float], share: float) -> float:
    """Return the quantile at a share of a log-uniform distribution between two ends."""
    low, high = ends
    return float(min(low * (high / low) ** share, high))  # rounding must not leave the range
