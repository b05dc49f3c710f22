"""Simulated assemblies of the rigs, simulated once and stored without sensor noise, which is added later.

All of them are surrogates on assumed rigs.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import joblib
import numpy as np
from numpy.typing import NDArray

from cyclofeat._base.files import write_whole
from cyclofeat.counting import passage_of_lobe_zero
from cyclofeat.datasets import rig_preset
from cyclofeat.simulators import BrakeRotor, CycloidalGearbox, LobeDefects, Rig

SAMPLING_RATE = 25_600.0
N_LOBES = 15
# One evaluation of the contacts per step takes half the time. A row of the table uses the midpoint rule.
OPTIONS = (("integrator", "adams_bashforth"),)
_CHUNK = 80


@dataclass(frozen=True)
class Design:
    """Design of a simulation. Equal designs have the same content.

    Attributes
    ----------
    name : str
        Name of the folder.
    rig : str
        "R0", "R1", "R2" or "R0+brake": R0 with the effect that R1 has in addition.
    n_assemblies : int
        Number of assemblies of each class.
    seed : int
    counts : tuple of int
        Classes, for consecutive worn lobes.
    patterns : tuple of tuple of int
        Sets of worn lobes instead of consecutive ones (rotated at random), one class each.
    n_windows : int
        Number of consecutive windows of one nominal output turn from each assembly.
    load_nm, speed_rpm, depth : float
        Nominal load and input speed, and depth of the wear.
    law : str
        Contact law.
    consecutive : bool
        Worn lobes are adjacent if True, else any lobes.
    options : tuple of (str, value)
        Options of the simulation.
    """

    name: str
    rig: str = "R1"
    n_assemblies: int = 40
    seed: int = 0
    counts: tuple[int, ...] = tuple(range(8))
    patterns: tuple[tuple[int, ...], ...] = ()
    n_windows: int = 2
    load_nm: float = 22.0
    speed_rpm: float = 500.0
    depth: float = 1.0
    law: str = "paper"
    consecutive: bool = True
    options: tuple[tuple[str, Any], ...] = OPTIONS

    @property
    def classes(self) -> int:
        return len(self.patterns) or len(self.counts)

    @property
    def n_samples(self) -> int:
        """Samples of a window: one output turn at the nominal speed."""
        return round(SAMPLING_RATE * N_LOBES * 60 / self.speed_rpm)

    def simulator(self) -> Rig:
        preset, _, brake = self.rig.partition("+")
        rig = rig_preset(preset)
        if brake:
            rig = rig.with_effects(BrakeRotor(inertia=0.02, stiffness=1e4, damping_ratio=0.02))
        gearbox = CycloidalGearbox.steel().replace(
            load_torque=self.load_nm, input_speed=self.speed_rpm * 2 * math.pi / 60, contact_law=self.law
        )
        return rig.replace(gearbox=gearbox).without("noise")


@dataclass(frozen=True)
class Windows:
    """Windows of many assemblies, without sensor noise.

    Attributes
    ----------
    X : ndarray of float32, shape (n_windows, n_samples)
    y, assembly, number : ndarray of int, shape (n_windows,)
        Count, assembly, and number of the window within its assembly, from 0.
    worn : ndarray of bool, shape (n_windows, 15)
    passage : ndarray, shape (n_windows,)
    wheels : ndarray of int, shape (n_windows,)
        Number of worn wheels.
    """

    X: NDArray[np.float32]
    y: NDArray[np.int64]
    assembly: NDArray[np.int64]
    number: NDArray[np.int64]
    worn: NDArray[np.bool_]
    passage: NDArray[np.float64]
    wheels: NDArray[np.int64]

    def take(self, rows: Any) -> Windows:
        return Windows(**{name: getattr(self, name)[rows] for name in self.__dataclass_fields__})

    def noisy(self, noise_nm: float, seed: int = 0) -> Windows:
        """Add white noise of the sensor; the same seed gives the same noise except for its size."""
        random = np.random.default_rng([seed, 77])
        noise = random.standard_normal(self.X.shape, dtype=np.float32)
        noise *= np.float32(noise_nm)
        noise += self.X
        return replace(self, X=noise)

    @staticmethod
    def joined(parts: Sequence[Windows]) -> Windows:
        """Concatenate windows; assemblies remain distinct."""
        first = np.cumsum([0, *(part.assembly.max() + 1 for part in parts)])
        parts = [replace(p, assembly=p.assembly + k) for p, k in zip(parts, first, strict=False)]
        names = Windows.__dataclass_fields__
        return Windows(**{name: np.concatenate([getattr(part, name) for part in parts]) for name in names})


def load(design: Design, folder: Path, n_jobs: int = 1) -> Windows:
    """Return the windows of a design and simulate missing ones; an interrupted simulation is continued."""
    content = design.__dict__ | {"options": dict(design.options)}
    if design.consecutive:
        del content["consecutive"]
    text = json.dumps(content, sort_keys=True, default=list)
    home = folder / f"{design.name}-{hashlib.sha256(text.encode()).hexdigest()[:8]}"
    home.mkdir(parents=True, exist_ok=True)
    (home / "design.json").write_text(text + "\n", encoding="utf-8")
    total = design.n_assemblies * design.classes
    chunks = [range(k, min(k + _CHUNK, total)) for k in range(0, total, _CHUNK)]
    for chunk in chunks:
        path = home / f"{chunk[0]:05d}.npz"
        if path.exists():
            continue
        work = joblib.Parallel(n_jobs=n_jobs)(joblib.delayed(_assembly)(design, index) for index in chunk)
        found = {name: np.array([one[name] for one in work]) for name in work[0]}
        write_whole(path, lambda stream, found=found: np.savez(stream, **found))  # type: ignore[misc]
        print(f"{design.name}: {chunk[-1] + 1} of {total} assemblies", flush=True)
    parts = [dict(np.load(home / f"{chunk[0]:05d}.npz")) for chunk in chunks]
    whole = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    n = design.n_windows
    return Windows(
        X=whole["torque"].reshape(total * n, -1),
        y=np.repeat(whole["worn"].sum(axis=1), n),
        assembly=np.repeat(np.arange(total), n),
        number=np.tile(np.arange(n), total),
        worn=np.repeat(whole["worn"], n, axis=0),
        passage=whole["passage"].reshape(-1),
        wheels=np.repeat(whole["wheels"], n),
    )


def _assembly(design: Design, index: int) -> dict[str, Any]:
    """Torque and truth of one assembly; classes alternate, so that more can be appended."""
    # Of the name "rig" only: the same assemblies, worn otherwise, are twins.
    seed = np.random.SeedSequence([design.seed, *design.rig.encode()], spawn_key=(index,))
    random = np.random.default_rng(seed.spawn(2)[1])
    k = index % design.classes
    if design.patterns:
        turn = int(random.integers(N_LOBES))
        wheels = (0,) if random.random() < 0.5 else (0, 1)
        lobes = [(lobe + turn) % N_LOBES for lobe in design.patterns[k]]
        defects = LobeDefects.worn(lobes, wheels=wheels, depth=design.depth)
    else:
        defects = LobeDefects.drawn(
            design.counts[k], N_LOBES, random, depth=design.depth, consecutive=design.consecutive
        )
    n = design.n_samples
    run = design.simulator().simulate(
        defects, duration=design.n_windows * n / SAMPLING_RATE, sampling_rate=SAMPLING_RATE,
        random_state=seed, **dict(design.options),
    )  # fmt: skip
    worn = np.zeros(N_LOBES, dtype=bool)
    worn[list(defects.worn_lobes)] = True
    starts = run.input_angle[::n][: design.n_windows]
    return {
        "torque": run.torque_out.reshape(design.n_windows, n).astype(np.float32),
        "worn": worn,
        "passage": passage_of_lobe_zero(starts, N_LOBES),
        "wheels": len(defects.wheels) if defects.defect_count else 0,
    }
