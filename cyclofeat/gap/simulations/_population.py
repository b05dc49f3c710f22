"""Recordings that a rig would give, and banks of simulated ones."""

from __future__ import annotations

import dataclasses
import itertools
import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import TypeVar

import joblib
import numpy as np
from numpy.typing import NDArray

from cyclofeat._base.quantities import CHANNELS, factor_to_output
from cyclofeat.simulators import (
    CycloidalGearbox,
    Effect,
    LobeDefects,
    MachineRun,
    PinErrors,
    PlannedRun,
    Rig,
    Scale,
    SimulationFailed,
    Solver,
    run_planned,
)

T = TypeVar("T")
Float = NDArray[np.float64]
Seed = np.random.SeedSequence

# One evaluation per step instead of two; the difference is below the resolution of the summaries.
SOLVER = Solver(integrator="adams_bashforth")
# Banks and tables are compared within the scatter of recordings: the error of single precision is far below.
KERNEL = "auto"
# Errors of a rig that cannot be built or simulated: a filter above the Nyquist frequency, a gearbox that does
# not settle, an effect that does not apply to its contact law.
NO_SUCH_RIG = (SimulationFailed, ValueError)
SPARE = 0.06  # share by which a run is longer, for the slowest converter in the library


# Assumptions: pin errors of 5 um rms, load +-0.5 %, speed +-0.3 %.
MAY_DIFFER: tuple[Effect, ...] = (
    PinErrors(5e-6), Scale("load", (0.995, 1.005)), Scale("speed", (0.997, 1.003)),
)  # fmt: skip


def as_rig(model: Rig | CycloidalGearbox | None) -> Rig:
    """Return a rig unchanged, a gearbox as a rig without effects, and paper B's gearbox for None."""
    if isinstance(model, Rig):
        return model
    return Rig(CycloidalGearbox.steel() if model is None else model)


def with_may_differ(rig: Rig, effects: Iterable[Effect] = MAY_DIFFER) -> Rig:
    """Return the rig with those of the effects added whose kind it does not have."""
    stated = {effect.effect_id for effect in rig.effects}
    return rig.with_added(*(effect for effect in effects if effect.effect_id not in stated))


@dataclass(frozen=True)
class Record:
    """One recording: torque in Nm referred to the output, float32 (n_samples,), and mean speed in Hz."""

    torque: NDArray[np.float32] = field(repr=False)
    speed: float


@dataclass(frozen=True)
class Bank:
    """Simulated recordings.

    Attributes
    ----------
    X : ndarray, shape (n, n_samples)
        Torque in Nm, float32.
    counts : ndarray of int, shape (n,)
        Worn lobes of each.
    speeds : ndarray, shape (n,)
        Mean input speed of each in Hz.
    assemblies : ndarray of int, shape (n,)
        Assembly of each.
    """

    X: NDArray[np.float32] = field(repr=False)
    counts: NDArray[np.int64] = field(repr=False)
    speeds: Float = field(repr=False)
    assemblies: NDArray[np.int64] = field(repr=False)


@dataclass(frozen=True)
class Population:
    """Source of simulated recordings: a rig and the conditions under which it is recorded.

    Start angle and first worn lobe of each recording are random.

    Parameters
    ----------
    rig : Rig
        With the spread between its assemblies.
    n_samples : int
        Length of a recording.
    sampling_rate : float
        In Hz.
    wheels : tuple of tuple of int
        Wheels that may carry the wear, with equal chances.
    direction : {1, -1}
        -1 in reverse (:func:`record`).
    quantity : {"output_torque", "input_torque"}
        What is measured.
    """

    rig: Rig
    n_samples: int
    sampling_rate: float
    wheels: tuple[tuple[int, ...], ...]
    direction: int = 1
    quantity: str = "output_torque"

    @property
    def text(self) -> str:
        """Text of everything that affects a recording, besides its count and its random numbers."""
        others = {name: value for name, value in vars(self).items() if name != "rig"}
        return json.dumps([self.rig.to_text(), others])

    def plan_run(
        self,
        count: int,
        random_state: Seed,
        assembly: Seed | None = None,
        *,
        spare: float = 0.0,
        solver: Solver = SOLVER,
    ) -> PlannedRun:
        """Draw one run of the machine, without simulating it.

        ``count`` consecutive lobes are worn, the first and the wheels at random. Runs with equal ``assembly``
        seeds are of one assembly. The run is longer by the share ``spare``, for a slow converter. Raises
        ValueError if the rig cannot be built.
        """
        # Not spawn(): it counts its calls, and equal seeds must give equal recordings.
        for_defects, for_run = (
            Seed(random_state.entropy, spawn_key=(*random_state.spawn_key, k)) for k in range(2)
        )
        random, n_lobes = np.random.default_rng(for_defects), self.rig.gearbox.n_lobes
        first = int(random.integers(n_lobes))
        wheels = self.wheels[int(random.integers(len(self.wheels)))]
        duration = self.n_samples / self.sampling_rate
        return self.rig.plan_run(
            LobeDefects.worn([(first + k) % n_lobes for k in range(count)], wheels=wheels),
            duration=duration,
            sampling_rate=self.sampling_rate,
            random_state=for_run,
            assembly=assembly,
            quantity=self.quantity,
            torque_in=False,  # plan_run sets True where it is measured
            motion=False,
            solver=solver,
            spare_s=spare * duration,
        )

    def record(self, count: int, random_state: Seed, assembly: Seed | None = None) -> Record:
        """Simulate one recording; arguments as :meth:`plan_run`.

        Raises SimulationFailed or ValueError if the rig cannot be simulated or built.
        """
        return record(self.plan_run(count, random_state, assembly).simulate(), (), self.direction)


def record(run: MachineRun, effects: Sequence[Effect] = (), direction: int = 1) -> Record:
    """Record a machine's run through its chain of measurement, with further effects on the torque.

    In reverse (``direction=-1``) the mirror image of the gearbox runs: its torque has the other sign before
    it is measured. The record is the torque times the direction, so positive for a load that brakes; input
    torque is also multiplied by the reduction.
    """
    channel = CHANNELS[run.quantity]
    if direction < 0:
        mirrored = dataclasses.replace(run.run, **{channel: -getattr(run.run, channel)})
        run = dataclasses.replace(run, run=mirrored)
    made = run.record(effects)
    angle = made.input_angle
    turned = (float(angle[-1]) - float(angle[0])) / (2 * np.pi)
    factor = direction * factor_to_output(run.quantity, made.gearbox.n_lobes)
    torque = getattr(made, channel).astype(np.float32) * np.float32(factor)
    return Record(torque, turned / (angle.size - 1) * made.sampling_rate)


def _in_batches(items: Sequence[T]) -> list[Sequence[T]]:
    """Parts of a list of runs, each as many as are simulated at once."""
    from cyclofeat.simulators.batch.runs import n_lanes

    return [items[first : first + n_lanes()] for first in range(0, len(items), n_lanes())]


def simulate_bank(
    population: Population,
    counts: Sequence[int],
    n: int,
    *,
    n_assemblies: int | None = None,
    random_state: int = 0,
    n_jobs: int = 1,
) -> Bank:
    """Simulate n recordings of a population that take the ``counts`` of worn lobes in turn.

    Recordings i and i + ``n_assemblies`` are of the same assembly; by default each has its own. Recording i
    depends on ``random_state`` and i alone. Raises SimulationFailed if at least half of the simulations fail.
    """
    repeat, assemblies = np.divmod(np.arange(n), n if n_assemblies is None else n_assemblies)
    # Recordings of one assembly differ in their counts.
    wanted = np.array(counts)[(assemblies + repeat) % len(counts)]

    def some(numbers: Sequence[int]) -> list[Record | str]:
        shared = {
            i: None if n_assemblies is None else Seed([random_state, int(assemblies[i])]) for i in numbers
        }
        plans = [
            population.plan_run(int(wanted[i]), Seed(random_state, spawn_key=(i,)), shared[i])
            for i in numbers
        ]
        runs = run_planned(plans, kernel=KERNEL)
        return [
            str(run) if isinstance(run, SimulationFailed) else record(run, (), population.direction)
            for run in runs
        ]

    parts = joblib.Parallel(n_jobs=n_jobs)(joblib.delayed(some)(part) for part in _in_batches(range(n)))
    made = list(itertools.chain.from_iterable(parts))
    done = [i for i, one in enumerate(made) if isinstance(one, Record)]
    if len(done) <= n // 2:
        first = next(one for one in made if isinstance(one, str))
        raise SimulationFailed(f"{n - len(done)} of {n} simulations failed, the first with: {first}")
    return Bank(
        X=np.array([made[i].torque for i in done]),
        counts=wanted[done],
        speeds=np.array([made[i].speed for i in done]),
        assemblies=assemblies[done],
    )
