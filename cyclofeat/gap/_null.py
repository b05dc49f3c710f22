"""What the simulator alone would have recorded: the prior of what may differ, and the bank of records."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from numbers import Real
from pathlib import Path
from typing import Any

import joblib
import numpy as np
import sklearn
from numpy.typing import NDArray

from cyclofeat._files import write_whole
from cyclofeat.gap import _summaries
from cyclofeat.gap._recordings import registered
from cyclofeat.simulators import (
    AssemblyTolerances,
    CompositeSimulator,
    CycloidalGearbox,
    LobeDefects,
    MachineRun,
    Rig,
    SimulationFailed,
)
from cyclofeat.simulators.campaign import made_with

Float = NDArray[np.float64]
# One evaluation per step instead of two: what it does otherwise lies below the summaries' resolution.
_INTEGRATOR = "adams_bashforth"
_STORED = ("X", "counts", "input_angle", "assemblies")
# What cannot be simulated, or cannot be built: a filter beyond half of the sampling rate, a gearbox that
# never settles, an effect on what this contact law does not have.
NO_SUCH_RIG = (SimulationFailed, ValueError)
# What the summaries' code takes from the package, directly and by way of others.
_SUMMARISED_WITH = (
    "_density.py", "_wavelet_filters.py", "_welch.py", "_windows.py", "lobes.py", "orders.py", "wavelets.py",
)  # fmt: skip
SPARE = 0.06  # share by which a machine runs longer, for the slowest converter of the library
_LAYOUT = 3  # raise it when the bank's content changes for other reasons than the simulator's code


def as_composite(simulator: CompositeSimulator | Rig | CycloidalGearbox | None) -> CompositeSimulator:
    """A simulator, rig or gearbox as what effects can be added to."""
    return simulator if isinstance(simulator, CompositeSimulator) else CompositeSimulator(simulator)


@dataclass(frozen=True)
class NuisancePrior:
    """What may differ between a measured recording and a simulated one without being a missing effect.

    Start angle and first worn lobe are always random. All values are *assumptions*.

    Parameters
    ----------
    tolerances : AssemblyTolerances
        Spread between assemblies; by default 5 um rms pin errors, speed +-0.3 %, load +-0.5 %, no clearance,
        no run-out, contact stiffness and damping fixed.
    defect_counts : sequence of int
        Counts of worn lobes from which a recording's is drawn, where it is not known.
    wheels : tuple of tuple of int
        Wheels that may carry the wear, with equal chances.

    Examples
    --------
    >>> NuisancePrior().tolerances.pin_position
    5e-06
    """

    tolerances: AssemblyTolerances = field(
        default_factory=lambda: AssemblyTolerances(
            pin_position=5e-6, runout=0.0, stiffness=0.0, damping=0.0, load=0.005, speed=0.003,
            clearance=(0.0, 0.0),
        )
    )  # fmt: skip
    defect_counts: Sequence[int] = tuple(range(8))
    wheels: tuple[tuple[int, ...], ...] = ((0,), (0, 1))

    def __post_init__(self) -> None:
        given: Any = self.defect_counts
        counts: tuple[Any, ...] = tuple(given) if isinstance(given, Iterable) else ()
        whole = (isinstance(c, Real) and float(c).is_integer() and float(c) >= 0 for c in counts)
        if not counts or not all(whole):
            raise ValueError(f"defect_counts must hold whole numbers from 0, got {self.defect_counts!r}")
        object.__setattr__(self, "defect_counts", tuple(int(count) for count in counts))
        if not self.wheels:
            raise ValueError(f"wheels must hold at least one of (0,), (1,) and (0, 1), got {self.wheels!r}")
        for wheels in self.wheels:
            LobeDefects.worn(0, wheels=wheels)

    def simulator(self, simulator: CompositeSimulator | Rig | CycloidalGearbox | None) -> CompositeSimulator:
        """The simulator with this prior as the spread between its assemblies.

        Parameters
        ----------
        simulator : CompositeSimulator, Rig, CycloidalGearbox or None
            A rig keeps its brake, drift and noise; its spread between assemblies is replaced. A gearbox, or
            a rig without spread, keeps its clearance, to which this prior's comes. None: paper B's gearbox.
        """
        composite = as_composite(simulator)
        rig, tolerances = composite.to_rig(), self.tolerances
        if not rig.tolerances.has_spread:
            own = rig.tolerances.clearance[0]
            low, high = tolerances.clearance
            tolerances = dataclasses.replace(tolerances, clearance=(low + own, high + own))
        return CompositeSimulator(rig.replace(effects=(), tolerances=tolerances), rig.effects)

    def n_lobes(
        self, simulator: CompositeSimulator | Rig | CycloidalGearbox | None, input_speed_hz: float
    ) -> int:
        """Lobes of the simulator's discs, where it turns at the recordings' speed.

        Parameters
        ----------
        simulator : CompositeSimulator, Rig, CycloidalGearbox or None
        input_speed_hz : float
            Nominal speed of the recordings.

        Raises
        ------
        ValueError
            If the simulator turns at another speed.
        """
        gearbox = self.simulator(simulator).to_rig().gearbox
        own = gearbox.input_speed / (2 * np.pi)
        if abs(own / input_speed_hz - 1) > _summaries.SPEED_TOLERANCE:
            raise ValueError(
                f"input_speed_hz must be the model's speed, {own:.4g} Hz ({60 * own:.4g} RPM), got "
                f"{input_speed_hz:.4g} ({60 * input_speed_hz:.4g} RPM): give a simulator of that speed"
            )
        return int(gearbox.n_lobes)

    def draw_defects(self, count: int, n_lobes: int, random: np.random.Generator) -> LobeDefects:
        """Consecutive worn lobes with a random first one, on random wheels."""
        first = int(random.integers(n_lobes))
        wheels = self.wheels[int(random.integers(len(self.wheels)))]
        return LobeDefects.worn([(first + k) % n_lobes for k in range(count)], wheels=wheels)


@dataclass(frozen=True)
class Bank:
    """Simulated recordings under the prior.

    Attributes
    ----------
    X : ndarray, shape (n, n_samples)
        Torque in Nm, float32.
    counts : ndarray of int, shape (n,)
        Worn lobes of each.
    input_angle : ndarray, shape (n, 2)
        Input angle in rad at the first and the last sample.
    assemblies : ndarray of int, shape (n,)
        Assembly of each.
    n_failed : int
        Recordings asked for whose simulation failed; they are left out.
    key : str
        Name of the content: two banks with one name are equal.
    """

    X: NDArray[np.float32] = field(repr=False)
    counts: NDArray[np.int64] = field(repr=False)
    input_angle: Float = field(repr=False)
    assemblies: NDArray[np.int64] = field(repr=False)
    n_failed: int = 0
    key: str = ""

    @property
    def speeds(self) -> Float:
        """Mean input speed of each recording in turns per sample, shape (n,)."""
        return np.asarray(np.diff(self.input_angle, axis=1)[:, 0] / (2 * np.pi * (self.X.shape[1] - 1)))


def make_bank(
    simulator: CompositeSimulator | Rig | CycloidalGearbox | None,
    nuisance: NuisancePrior,
    counts: Sequence[int] | None = None,
    *,
    n: int = 200,
    n_samples: int = 46_080,
    sampling_rate: float = 25_600.0,
    n_assemblies: int | None = None,
    random_state: int = 0,
    n_jobs: int = 1,
    cache: str | os.PathLike[str] | None = None,
) -> Bank:
    """Simulate recordings under the prior, or take them from the cache.

    Parameters
    ----------
    simulator, nuisance
        What is simulated, and what differs between recordings.
    counts : sequence of int, optional
        Counts of worn lobes, gone through in turn; default those of the prior.
    n : int
        Number of recordings.
    n_samples, sampling_rate : int, float
        Length of each, and its rate in Hz.
    n_assemblies : int, optional
        Recordings i and i + n_assemblies are of the same assembly. Default: each is of its own.
    random_state : int
        Seed. Recording i depends on it and on i alone.
    n_jobs : int
        Number of worker processes.
    cache : path, optional
        Folder for banks; the file's name is made of everything above and of the code's version.

    Returns
    -------
    Bank

    Raises
    ------
    SimulationFailed
        If more than half of the simulations fail.
    """
    composite = nuisance.simulator(simulator)
    classes = tuple(int(count) for count in (nuisance.defect_counts if counts is None else counts))
    stated = (classes, n_samples, sampling_rate, n_assemblies, random_state, _LAYOUT)
    key = f"{cache_key(composite, nuisance, *stated)}-{n}"
    file = None if cache is None else Path(cache) / f"bank-{key}.npz"
    if file is not None and file.exists():
        with np.load(file) as stored:
            kept = {name: stored[name] for name in _STORED}
            return Bank(**kept, n_failed=n - len(kept["X"]), key=key)
    repeat, assemblies = np.divmod(np.arange(n), n if n_assemblies is None else n_assemblies)
    # Recordings of one assembly differ in their counts.
    wanted = np.array(classes)[(assemblies + repeat) % len(classes)]

    def one(i: int) -> tuple[NDArray[np.float32], tuple[float, float]] | str:
        seed = np.random.SeedSequence(random_state, spawn_key=(i,))
        shared = None if n_assemblies is None else np.random.SeedSequence([random_state, int(assemblies[i])])
        try:
            return record(composite, nuisance, int(wanted[i]), n_samples, sampling_rate, seed, shared)
        except SimulationFailed as failure:
            return str(failure)

    work = joblib.Parallel(n_jobs=n_jobs)(joblib.delayed(one)(i) for i in range(n))
    run = [i for i, found in enumerate(work) if not isinstance(found, str)]
    if len(run) <= n // 2:
        raise SimulationFailed(
            f"{n - len(run)} of {n} simulations failed, the first with: "
            f"{next(found for found in work if isinstance(found, str))}"
        )
    bank = Bank(
        X=np.array([work[i][0] for i in run], dtype=np.float32),
        counts=wanted[run],
        input_angle=np.array([work[i][1] for i in run]),
        assemblies=assemblies[run],
        n_failed=n - len(run),
        key=key,
    )
    if file is not None:
        file.parent.mkdir(parents=True, exist_ok=True)
        content: dict[str, Any] = {name: getattr(bank, name) for name in _STORED}
        write_whole(file, lambda stream: np.savez(stream, **content))
    return bank


def record(
    composite: CompositeSimulator,
    nuisance: NuisancePrior,
    count: int,
    n_samples: int,
    sampling_rate: float,
    seed: np.random.SeedSequence,
    assembly: np.random.SeedSequence | None = None,
) -> tuple[NDArray[np.float32], tuple[float, float]]:
    """Torque in Nm of one recording of the prior's simulator, and its first and last input angle in rad."""
    run = machine(composite, nuisance, count, n_samples, sampling_rate, seed, assembly).record()
    return run.torque_out.astype(np.float32), (float(run.input_angle[0]), float(run.input_angle[-1]))


def machine(
    composite: CompositeSimulator,
    nuisance: NuisancePrior,
    count: int,
    n_samples: int,
    sampling_rate: float,
    seed: np.random.SeedSequence,
    assembly: np.random.SeedSequence | None = None,
    *,
    spare: float = 0.0,
) -> MachineRun:
    """One run of the prior's simulator, before it is measured; longer by a share ``spare``."""
    # Not spawn(), which counts: the same seed always gives the same recording.
    for_defects, for_run = (
        np.random.SeedSequence(seed.entropy, spawn_key=(*seed.spawn_key, k)) for k in range(2)
    )
    n_lobes = composite.to_rig().gearbox.n_lobes
    defects = nuisance.draw_defects(count, n_lobes, np.random.default_rng(for_defects))
    duration = n_samples / sampling_rate
    return composite.run_machine(
        defects,
        duration=duration,
        sampling_rate=sampling_rate,
        seed=for_run,
        assembly=assembly,
        torque_in=False,
        motion=False,
        integrator=_INTEGRATOR,
        spare_s=spare * duration,
    )


def cache_key(composite: CompositeSimulator, nuisance: NuisancePrior, *others: Any) -> str:
    """Name for what follows from these, from the summaries' code and from all of the simulator's."""
    code = code_of("_recordings.py", "_summaries.py")
    stated = [composite.to_rig().to_text(), dataclasses.asdict(nuisance), *others, made_with(), code]
    return hashlib.sha256(json.dumps(stated, sort_keys=True, default=str).encode()).hexdigest()[:20]


def code_of(*here: str) -> str:
    """Sum of some of this folder's files and of all that summaries are made with."""
    folder = Path(__file__).parent
    code = hashlib.sha256()
    for path in (*(folder.parent / name for name in _SUMMARISED_WITH), *(folder / name for name in here)):
        code.update(path.name.encode() + b"\0" + path.read_bytes())
    return code.hexdigest()


def versions() -> dict[str, str]:
    """Versions of all that decides about what the gap's stages find."""
    here = sorted(path.name for path in Path(__file__).parent.glob("*.py"))
    return made_with() | {"gap_sha256": code_of(*here), "scikit-learn": sklearn.__version__}


def summarised_bank(
    simulator: CompositeSimulator | Rig | CycloidalGearbox | None,
    nuisance: NuisancePrior,
    counts: Sequence[int] | None,
    *,
    sampling_rate: float,
    input_speed_hz: float,
    with_tachometer: bool,
    cache: str | os.PathLike[str] | None,
    **options: Any,
) -> tuple[Bank, Float]:
    """A bank (:func:`make_bank`, whose other options are taken too) and its recordings' summaries."""
    bank = make_bank(simulator, nuisance, counts, sampling_rate=sampling_rate, cache=cache, **options)
    n_lobes = nuisance.n_lobes(simulator, input_speed_hz)
    values = summaries_of_bank(
        bank, sampling_rate, input_speed_hz, n_lobes, with_tachometer=with_tachometer, cache=cache
    )
    return bank, values


def summaries_of_bank(
    bank: Bank,
    sampling_rate: float,
    input_speed_hz: float,
    n_lobes: int,
    *,
    with_tachometer: bool = False,
    cache: str | os.PathLike[str] | None = None,
) -> Float:
    """Summaries of a bank's recordings, (n, n_cells), or what the cache has of them."""
    file = None
    if cache is not None:
        file = Path(cache) / f"summaries-{bank.key}-{input_speed_hz!r}{'-angle' * with_tachometer}.npy"
        if file.exists():
            return np.asarray(np.load(file))
    speeds = bank.speeds * sampling_rate if with_tachometer else None
    X = registered(bank.X, sampling_rate, input_speed_hz, n_lobes)
    values, _ = _summaries.summarise_all(X, sampling_rate, input_speed_hz, n_lobes, speeds)
    if file is not None:
        file.parent.mkdir(parents=True, exist_ok=True)
        write_whole(file, lambda stream: np.save(stream, values))
    return values
