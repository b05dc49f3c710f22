"""Simulated rigs with sets of effects, and the statistics that would have been published of them."""

from __future__ import annotations

import itertools
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import joblib
import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from cyclofeat._density import shannon_entropy
from cyclofeat._files import write_whole
from cyclofeat._welch import welch_psd
from cyclofeat.gap._null import NO_SUCH_RIG, NuisancePrior, cache_key, record
from cyclofeat.gap._summary_scores import to_statistics
from cyclofeat.simulators import (
    CompositeSimulator,
    CycloidalGearbox,
    Effect,
    Place,
    Rig,
    effect_library,
)
from cyclofeat.simulators.effects import EffectParameter, Normal

Float = NDArray[np.float64]
Set = tuple[str, ...]

SET_POINT = "brake_set_point"
_REPLICATES = 2


@dataclass(frozen=True)
class RigTable:
    """Statistics of simulated rigs: each row of theta is one rig, recorded ``_REPLICATES`` times per disc.

    ``theta`` (n, n_parameters); ``values`` (n, replicates, n_counts, 4) as :func:`to_statistics` gives them.
    """

    theta: Float
    values: Float


class SimulatedRigs:
    """Simulated rigs with sets of effects, and what they would have published."""

    def __init__(
        self,
        counts: NDArray[np.int64],
        *,
        simulator: CompositeSimulator | Rig | CycloidalGearbox | None,
        nuisance: NuisancePrior,
        duration_s: float,
        sampling_rate: float,
        n_draws: int,
        table: str | os.PathLike[str] | None,
        random_state: int,
        n_jobs: int,
        cache: str | os.PathLike[str] | None,
    ) -> None:
        self.counts, self.nuisance, self.sampling_rate = counts, nuisance, sampling_rate
        self.n_draws, self.random_state, self.n_jobs, self.cache = n_draws, random_state, n_jobs, cache
        self.simulator = nuisance.simulator(simulator)
        assert isinstance(self.simulator.base, Rig)
        self.set_point = float(self.simulator.base.gearbox.load_torque)
        self.n_samples = round(duration_s * sampling_rate)
        self.n_simulated = self.n_failed = 0
        self.tables: dict[Set, RigTable] = {}
        self.entropy: dict[Set, Float] = {}
        self.records: dict[Set, NDArray[np.float32]] = {}
        self.kept: dict[Set, NDArray[np.intp]] = {}  # rigs in the place of those that failed
        # What the numbers depend on, without the version of the code: a table may be shipped.
        self.stated = repr(
            (
                self.simulator.to_rig().to_text(), nuisance, counts.tolist(), self.n_samples,
                float(sampling_rate), int(n_draws), int(random_state),
            )
        )  # fmt: skip
        if table is not None:
            self._load(Path(table))

    def table(self, key: Set) -> RigTable:
        if key not in self.tables:
            values = self._each_torque(key, _statistics_of)
            low, high, mean, std = np.moveaxis(values, -1, 0)
            found = to_statistics(low, high, mean, std, self.set_point)
            # After the records: a rig that failed has taken another's parameters.
            self.tables[key] = RigTable(self.thetas(key), found)
        return self.tables[key]

    def entropies(self, key: Set) -> Float:
        """Shannon entropies in bits, (n_rigs, replicates, n_counts)."""
        if key not in self.entropy:
            self.entropy[key] = self._each_torque(key, self._entropy_of)[..., 0]
        return self.entropy[key]

    def parameter_names(self, key: Set) -> list[str]:
        return [f"{name}.{parameter}" for name in key for parameter in _parameters(name)]

    def bounds(self, key: Set) -> list[tuple[float, float, bool]]:
        """Smallest and largest value of each parameter in the table, and whether it counts in logarithms."""
        theta = self.table(key).theta
        kinds = [kind_of(name).parameters[p] for name in key for p in _parameters(name)]
        return [
            (float(column.min()), float(column.max()), kind.log)
            for column, kind in zip(theta.T, kinds, strict=True)
        ]

    def effects(self, key: Set, theta: Float) -> tuple[Effect, ...]:
        found, at = [], 0
        for name in key:
            names = _parameters(name)
            values = dict(zip(names, theta[at : at + len(names)].tolist(), strict=True))
            found.append(kind_of(name)().with_parameters(**values))
            at += len(names)
        return tuple(found)

    def composite(self, effects: Iterable[Effect]) -> CompositeSimulator:
        """A set-point is the load of the gearbox: what is left are effects that files know."""
        base, left = self.simulator.base, []
        assert isinstance(base, Rig)
        for effect in effects:
            if isinstance(effect, BrakeSetPoint):
                base = base.replace(gearbox=effect.change_gearbox(base.gearbox, np.random.default_rng(0)))
            else:
                left.append(effect)
        return CompositeSimulator(base, (*self.simulator.effects, *left))

    def n_rigs(self, key: Set) -> int:
        """As many as are simulated, or more where effects on the torque alone tell them apart."""
        if simulated_ones(key) == key:
            return self._n_gear(key)
        n_parameters = sum(len(_parameters(name)) for name in key)
        return max(
            self._n_gear(simulated_ones(key)),
            min(16 * self.n_draws, 5 * self.n_draws * n_parameters),
        )

    def thetas(self, key: Set) -> Float:
        """A Latin hypercube over the priors of each effect: of the gearbox's as many as are simulated."""
        n = self.n_rigs(key)
        columns: list[Float] = []
        for name in key:
            if not kind_of(name).needs_simulation():
                columns += self._hypercube(name, n)
                continue
            n_gear = self._n_gear(simulated_ones(key))
            kept = self.kept.get(simulated_ones(key), np.arange(n_gear))
            columns += [np.resize(column[kept], n) for column in self._hypercube(name, n_gear)]
        return np.column_stack(columns) if columns else np.zeros((n, 0))

    def _hypercube(self, name: str, n: int) -> list[Float]:
        kind, names = kind_of(name), _parameters(name)
        if not names:
            return []
        seed = np.random.default_rng([self.random_state, *name.encode(), n])
        shares = qmc.LatinHypercube(len(names), seed=seed).random(n)
        columns = []
        for k, parameter in enumerate(names):
            what = kind.parameters[parameter]
            assert what.prior is not None
            values = np.array([what.prior.quantile(float(share)) for share in shares[:, k]])
            columns.append(np.clip(values, what.low, what.high))
        return columns

    def _n_gear(self, gear: Set) -> int:
        """Rigs whose gearbox is simulated."""
        n_parameters = sum(len(_parameters(name)) for name in gear)
        if len(gear) > 1:
            return 3 * self.n_draws
        return self.n_draws * (max(n_parameters, 1) ** 2 if gear else 3)

    def _each_torque(self, key: Set, work: Any) -> Float:
        """What ``work`` makes of each record, shape (n_rigs, replicates, n_counts, ...)."""
        records = self._records(simulated_ones(key))
        theta = self.thetas(key)
        chain = [name for name in key if not kind_of(name).needs_simulation()]
        found = []
        for rig in range(len(theta)):
            effects = [e for e in self.effects(key, theta[rig]) if e.effect_id in chain]
            effects.sort(key=lambda effect: effect.place)
            for replicate, k in itertools.product(range(_REPLICATES), range(len(self.counts))):
                torque = records[rig % len(records), replicate, k].astype(np.float64)
                for effect in effects:
                    seed = np.random.SeedSequence(
                        [self.random_state, *effect.effect_id.encode()], spawn_key=(rig, replicate, k)
                    )
                    random = np.random.default_rng(seed)
                    torque = effect.change_torque(torque, self.sampling_rate, random)
                found.append(work(torque))
        return np.array(found).reshape(len(theta), _REPLICATES, len(self.counts), -1)

    def _entropy_of(self, torque: Float) -> Float:
        frequencies, psd = welch_psd(torque[np.newaxis], self.sampling_rate, "matlab_pwelch")
        return np.asarray(shannon_entropy(psd, frequencies))

    def _records(self, gear: Set) -> NDArray[np.float32]:
        """Torque after the effects in the gearbox, (n_gear, replicates, n_counts, n_samples).

        Another rig takes the place of one of which a record cannot be simulated; those records are counted.
        """
        if gear in self.records:
            return self.records[gear]
        n = self._n_gear(gear)
        file = None
        if self.cache is not None:
            name = cache_key(self.simulator, self.nuisance, self.stated, gear, n)
            file = Path(self.cache) / f"records-{'-'.join(gear) or 'nothing'}-{name}.npy"
            if file.exists():
                self.records[gear] = np.load(file, mmap_mode="r")
                return self.records[gear]
        columns = [column for name in gear for column in self._hypercube(name, n)]
        theta = np.column_stack(columns) if columns else np.zeros((n, 0))
        jobs = list(itertools.product(range(n), range(_REPLICATES), range(len(self.counts))))
        composites = [self.composite(self.effects(gear, row)) for row in theta]
        seeds = [np.random.SeedSequence(self.random_state, spawn_key=job) for job in jobs]
        made = joblib.Parallel(n_jobs=self.n_jobs)(
            joblib.delayed(_record)(
                composites[rig], self.nuisance, int(self.counts[k]), self.n_samples,
                float(self.sampling_rate), seed,
            )
            for (rig, _, k), seed in zip(jobs, seeds, strict=True)
        )  # fmt: skip
        self.n_simulated += len(made)
        shape = (n, _REPLICATES, len(self.counts), self.n_samples)
        failed = np.array([torque is None for torque in made]).reshape(shape[:3])
        self.n_failed += int(failed.sum())
        good = np.flatnonzero(~failed.any(axis=(1, 2)))
        if good.size == 0:
            raise ValueError(f"library must hold effects that can be simulated: {' + '.join(gear)} cannot")
        filled = [np.zeros(self.n_samples, np.float32) if torque is None else torque for torque in made]
        records = np.array(filled).reshape(shape)
        if good.size < n:
            self.kept[gear] = good[np.searchsorted(good, np.arange(n)).clip(max=good.size - 1)]
            records = records[self.kept[gear]]
        self.records[gear] = records
        # What failed would be found anew with the file there, without the rigs that took its place.
        if file is not None and good.size == n:
            file.parent.mkdir(parents=True, exist_ok=True)
            write_whole(file, lambda stream: np.save(stream, records))
        return records

    def save(self, path: Path) -> None:
        arrays: dict[str, Any] = {"stated": np.array(self.stated)}
        for key, table in self.tables.items():
            arrays["values:" + "+".join(key)] = table.values.astype(np.float16)
            arrays["theta:" + "+".join(key)] = table.theta.astype(np.float32)
        for key, entropy in self.entropy.items():
            arrays["entropy:" + "+".join(key)] = entropy.astype(np.float16)
        write_whole(path, lambda stream: np.savez_compressed(stream, **arrays))

    def _load(self, path: Path) -> None:
        with np.load(path) as stored:
            if str(stored["stated"]) != self.stated:
                raise ValueError(
                    f"table {path} was made with another simulator, prior, discs, duration_s, sampling_rate, "
                    "n_draws or random_state: leave it out, or give the same"
                )
            for name in stored.files:
                kind, _, joined = name.partition(":")
                key = tuple(joined.split("+")) if joined else ()
                n = self.n_rigs(key)
                if kind == "values":
                    theta = stored["theta:" + joined][:n].astype(np.float64)
                    self.tables[key] = RigTable(theta, stored[name][:n].astype(np.float64))
                elif kind == "entropy":
                    self.entropy[key] = stored[name][:n].astype(np.float64)


class BrakeSetPoint(Effect):
    """Another set-point of the brake: a constant more or less of load.

    Not in the library of files: as a simulator it is the gearbox's own ``load_torque``.

    Parameters
    ----------
    shift_nm : float, default=0.5
        In Nm, added to the load.
    """

    effect_id: ClassVar[str] = SET_POINT
    place: ClassVar[Place] = Place.LOAD_AND_SPEED
    parameters: ClassVar[Mapping[str, EffectParameter]] = {
        "shift_nm": EffectParameter("Nm", -1e3, 1e3, 0.0, Normal(0.0, 0.5)),
    }
    separated_by: ClassVar[str] = "a dead-weight calibration, and the brake's own reading"

    def __init__(self, shift_nm: Any = 0.5) -> None:
        self.shift_nm = shift_nm

    def change_gearbox(self, gearbox: CycloidalGearbox, random: np.random.Generator) -> CycloidalGearbox:
        return gearbox.replace(load_torque=gearbox.load_torque + self.shift_nm)


def kind_of(name: str) -> type[Effect]:
    return BrakeSetPoint if name == SET_POINT else effect_library()[name]


def _parameters(name: str) -> list[str]:
    return kind_of(name).vector_names()


def simulated_ones(key: Iterable[str]) -> Set:
    """The effects that the gearbox answers: they have to be simulated."""
    return tuple(name for name in key if kind_of(name).needs_simulation())


def _record(
    composite: CompositeSimulator,
    nuisance: NuisancePrior,
    count: int,
    n_samples: int,
    sampling_rate: float,
    seed: np.random.SeedSequence,
) -> NDArray[np.float32] | None:
    """Torque of one record, or None where it cannot be simulated."""
    try:
        return record(composite, nuisance, count, n_samples, sampling_rate, seed)[0]
    except NO_SUCH_RIG:
        return None


def _statistics_of(torque: Float) -> Float:
    return np.array([torque.min(), torque.max(), torque.mean(), torque.std()])
