"""Simulated recordings of the model.

A :class:`Population` describes recordings of a rig and how they may differ. :func:`simulate_bank` simulates
them, and :func:`remember` keeps them.
"""

from __future__ import annotations

import dataclasses
import itertools
import json
import os
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import joblib
import numpy as np
import sklearn
from numpy.typing import NDArray

from cyclofeat._base.files import code_sha256
from cyclofeat._base.quantities import CHANNELS, factor_to_output
from cyclofeat._base.shards import ShardStore
from cyclofeat.simulators import Effect, LobeDefects, PinErrors, Rig, Scale, SimulationFailed
from cyclofeat.simulators.campaign import made_with
from cyclofeat.simulators.effects.library import child_seed
from cyclofeat.simulators.machine import MachineRun
from cyclofeat.simulators.sampling import Sample, sample_runs

T = TypeVar("T")
Float = NDArray[np.float64]
Seed = np.random.SeedSequence

# Assumption: a torque meter has at least 0.02 Nm rms of noise. A tenth of it goes unnoticed.
ERROR_NM = 2e-3
# Banks and tables are compared within the scatter of recordings: the error of single precision is far below.
KERNEL = "auto"
# Errors of a rig that cannot be built or simulated: a filter above the Nyquist frequency, a gearbox that does
# not settle, an effect that does not apply to its contact law.
NO_SUCH_RIG = (SimulationFailed, ValueError)


# Assumptions: pin errors of 5 um rms, load +-0.5 %, speed +-0.3 %.
MAY_DIFFER: tuple[Effect, ...] = (
    PinErrors(5e-6), Scale("load", (0.995, 1.005)), Scale("speed", (0.997, 1.003)),
)  # fmt: skip


def with_may_differ(rig: Rig, effects: Iterable[Effect] = MAY_DIFFER) -> Rig:
    """Return the rig with those of the effects added whose kind it does not have."""
    stated = {effect.effect_id for effect in rig.effects}
    return rig.with_added(*(effect for effect in effects if effect.effect_id not in stated))


class Record(NamedTuple):
    """One recording: torque in Nm referred to the output, float32 (n_samples,), and mean speed in Hz."""

    torque: NDArray[np.float32]
    speed: float


@dataclass(frozen=True)
class Bank:
    """Simulated torque in Nm (n, n_samples); worn lobes, mean input speed in Hz and assembly of each (n,)."""

    X: NDArray[np.float32] = field(repr=False)
    counts: NDArray[np.int64] = field(repr=False)
    speeds: Float = field(repr=False)
    assemblies: NDArray[np.int64] = field(repr=False)


@dataclass(frozen=True)
class Population:
    """Source of simulated recordings: a rig and the conditions under which it is recorded.

    Start angle and first worn lobe of each recording are random; the ``wheels`` that may carry the wear have
    equal chances; ``direction`` is -1 in reverse (:func:`record`).
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

    def sample(
        self,
        count: int,
        random_state: Seed,
        assembly: Seed | None = None,
        *,
        chains: Sequence[Sequence[Effect]] = (),
    ) -> Sample:
        """Draw the worn lobes of one recording.

        ``count`` consecutive lobes are worn, the first and the wheels at random. Equal ``assembly`` seeds are
        one assembly. The run is long enough for records with the ``chains``.
        """
        random, n_lobes = np.random.default_rng(child_seed(random_state, 0)), self.rig.gearbox.n_lobes
        first = int(random.integers(n_lobes))
        wheels = self.wheels[int(random.integers(len(self.wheels)))]
        return Sample(
            rig=self.rig,
            defects=LobeDefects.worn([(first + k) % n_lobes for k in range(count)], wheels=wheels),
            duration=self.n_samples / self.sampling_rate,
            sampling_rate=self.sampling_rate,
            random_state=child_seed(random_state, 1),
            assembly=assembly,
            quantity=self.quantity,
            error_nm=ERROR_NM,
            chains=chains,
        )

    def record(self, count: int, random_state: Seed, assembly: Seed | None = None) -> Record:
        """Simulate one recording; SimulationFailed or ValueError if the rig cannot be simulated or built."""
        return record(self.sample(count, random_state, assembly).plan().simulate(), (), self.direction)


def record(run: MachineRun, effects: Sequence[Effect] = (), direction: int = 1) -> Record:
    """Record a machine's run through its chain of measurement, with further effects on the torque.

    In reverse (``direction=-1``) the mirror image of the gearbox runs: its torque has the other sign before
    it is measured. The record is positive for a load that brakes, and input torque is referred to the output.
    """
    channel = CHANNELS[run.plan.quantity]
    if direction < 0:
        mirrored = dataclasses.replace(run.run, **{channel: -getattr(run.run, channel)})
        run = dataclasses.replace(run, run=mirrored)
    made = run.record(effects)
    angle = made.input_angle
    turned = (float(angle[-1]) - float(angle[0])) / (2 * np.pi)
    factor = direction * factor_to_output(run.plan.quantity, made.gearbox.n_lobes)
    torque = getattr(made, channel).astype(np.float32) * np.float32(factor)
    return Record(torque, turned / (angle.size - 1) * made.sampling_rate)


def simulate_bank(
    population: Population,
    counts: Sequence[int],
    n: int,
    *,
    n_assemblies: int | None = None,
    random_state: int,
    n_jobs: int = 1,
) -> Bank:
    """Simulate n recordings of a population that take the ``counts`` of worn lobes in turn.

    Recordings i and i + ``n_assemblies`` are of the same assembly; by default each has its own. Recording i
    depends on ``random_state`` and i alone. Raises SimulationFailed if at least half of the simulations fail.
    """
    from cyclofeat.simulators.batch.runs import n_lanes

    repeat, assemblies = np.divmod(np.arange(n), n if n_assemblies is None else n_assemblies)
    # Recordings of one assembly differ in their counts.
    wanted = np.array(counts)[(assemblies + repeat) % len(counts)]

    def records(numbers: Sequence[int]) -> list[Record | str]:
        samples = [
            population.sample(
                int(wanted[i]),
                Seed(random_state, spawn_key=(i,)),
                None if n_assemblies is None else Seed([random_state, int(assemblies[i])]),
            )
            for i in numbers
        ]
        results: list[Record | str] = []
        for run in sample_runs(samples, kernel=KERNEL):
            if isinstance(run, ValueError):
                raise run
            results.append(
                str(run) if isinstance(run, SimulationFailed) else record(run, (), population.direction)
            )
        return results

    batches = [range(n)[first : first + n_lanes()] for first in range(0, n, n_lanes())]
    parts = joblib.Parallel(n_jobs=n_jobs)(joblib.delayed(records)(batch) for batch in batches)
    results = list(itertools.chain.from_iterable(parts))
    done = {i: result for i, result in enumerate(results) if isinstance(result, Record)}
    if len(done) <= n // 2:
        first = next(result for result in results if isinstance(result, str))
        raise SimulationFailed(f"{n - len(done)} of {n} simulations failed, the first with: {first}")
    return Bank(
        X=np.array([result.torque for result in done.values()]),
        counts=wanted[list(done)],
        speeds=np.array([result.speed for result in done.values()]),
        assemblies=assemblies[list(done)],
    )


SIMULATED_BY = ("signal", "gap/summaries", "gap/simulations")  # folders whose code affects simulations


def remember(
    folder: str | os.PathLike[str] | None,
    call: Callable[[], T],
    kind: str,
    *key: Any,
    code: tuple[str, ...] = SIMULATED_BY,
) -> T:
    """Return the result of ``call``, from a folder where there is one.

    It is kept in the subfolder ``kind`` for equal ``key`` and equal code, that of the simulators and of the
    folders and modules in ``code``; a file that cannot be read is replaced.
    """
    if folder is None:
        return call()
    name = str(joblib.hash((kind, key, versions(*code))))
    result: T = ShardStore(Path(folder) / kind).load_or_compute(f"{name}.joblib", call)
    return result


def versions(*rooms: str) -> dict[str, str]:
    """Return the versions of the simulators and of the code in some folders and modules of the package."""
    package = Path(__file__).parents[1]
    files = [
        path
        for room in rooms
        for path in (
            (package / room).rglob("*.py") if (package / room).is_dir() else [package / f"{room}.py"]
        )
    ]
    return made_with() | {
        "code_sha256": code_sha256(package, sorted(files)),
        "scikit-learn": sklearn.__version__,
    }
