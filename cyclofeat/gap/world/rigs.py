"""Sessions of recordings as a posterior takes them, and the simulated rigs that it learns from."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cyclofeat._base.checks import positive
from cyclofeat.gap.summaries.summarise import Kinematics
from cyclofeat.gap.world.cells import recording_cells, turn_samples

Float = NDArray[np.float64]
Index = Sequence[int] | NDArray[np.intp] | slice


@dataclass(frozen=True)
class Session:
    """Recordings of one rig, as summaries.

    Attributes
    ----------
    values : ndarray, shape (n_recordings, n_cells)
    conditions : ndarray, shape (n_recordings, 3)
        Set-points: speed of the input in RPM, load in Nm, direction (1 or -1).
    counts, speeds_rpm : ndarray, shape (n_recordings,), or None
        Worn lobes, and mean speed of the input by a tachometer, where they are known.
    assemblies : ndarray of int, shape (n_recordings,), or None
        Recordings with equal numbers are of one assembly; None stands for an assembly each.
    """

    values: Float = field(repr=False)
    conditions: Float
    counts: NDArray[np.int64] | None = None
    speeds_rpm: Float | None = None
    assemblies: NDArray[np.int64] | None = None

    @classmethod
    def of(
        cls,
        recordings: Sequence[ArrayLike],
        sampling_rate: float,
        conditions: ArrayLike,
        *,
        counts: ArrayLike | None = None,
        speeds_rpm: ArrayLike | None = None,
        assemblies: ArrayLike | None = None,
        n_lobes: int = 15,
    ) -> Session:
        """Summarise recordings; of each, some 3 % more than the first output turn is used.

        Parameters
        ----------
        recordings : sequence of array-like
            Torque in Nm, as measured, of each recording.
        sampling_rate : float
            In Hz.
        conditions : array-like, shape (n_recordings, 3)
            Speed in RPM, load in Nm and direction (1 or -1) of each.
        counts, speeds_rpm : array-like, shape (n_recordings,), optional
            Worn lobes, and mean speed by a tachometer.
        assemblies : array-like of int, shape (n_recordings,), optional
            Equal numbers for recordings of one assembly. Default: an assembly each.
        n_lobes : int, default=15

        Examples
        --------
        >>> from cyclofeat.simulators import Rig
        >>> run = Rig().simulate(duration=2.0)
        >>> session = Session.of([run.torque_out] * 2, 25_600, [(500, 22, 1)] * 2, counts=[0, 0])
        >>> session.values.shape[0]
        2
        """
        positive("sampling_rate", sampling_rate, "a number of Hz")
        at = np.asarray(conditions, dtype=float)
        if at.shape != (len(recordings), 3) or not np.all(np.isin(at[:, 2], (-1, 1))):
            raise ValueError(
                "conditions must hold (speed in RPM, load in Nm, direction 1 or -1) of each of the "
                f"{len(recordings)} recordings, got {conditions!r}"
            )
        rows: list[Float] = []
        for k, (torque, (speed, _, direction)) in enumerate(zip(recordings, at, strict=True)):
            turn = Kinematics(sampling_rate, speed / 60, n_lobes)
            x = np.asarray(torque, dtype=np.float32)[: turn_samples(turn)]
            if x.ndim != 1 or x.size < turn_samples(turn) or not np.all(np.isfinite(x)):
                raise ValueError(
                    f"recordings[{k}] must hold an output turn and 3 % more of finite torque "
                    f"({turn_samples(turn)} samples at {speed:g} RPM), got shape {np.shape(torque)}"
                )
            rows.append(recording_cells(x[None] * np.float32(direction), turn)[0][0])
        return cls(
            np.array(rows), at,
            None if counts is None else np.asarray(counts, dtype=np.int64),
            None if speeds_rpm is None else np.asarray(speeds_rpm, dtype=float),
            None if assemblies is None else np.asarray(assemblies, dtype=np.int64),
        )  # fmt: skip


@dataclass(frozen=True)
class Rigs:
    """Simulated rigs of a :class:`World`.

    Attributes
    ----------
    names, size_names, cells : tuple of str
        Effects, their fitted parameters, and summaries of a recording.
    logarithmic : tuple of bool
        Whether ``sizes`` holds the logarithm of a parameter.
    numbers, machines : ndarray of int, shape (n_rigs,)
        Rigs of one machine share its runs: keep them on one side of a split.
    values, conditions, counts, speeds : ndarray, shape (n_rigs, n_recordings, ...)
        Summaries, NaN where the simulation failed; speed in RPM, load in Nm and direction; worn lobes; mean
        speed in RPM, as a tachometer has it.
    sizes : ndarray, shape (n_rigs, n_sizes)
        Parameters on the scale of their fit (:meth:`Effect.to_vector`), NaN where the effect is absent.
    world : dict
        Settings of the world (:meth:`World.to_dict`).
    """

    names: tuple[str, ...]
    size_names: tuple[str, ...]
    logarithmic: tuple[bool, ...] = field(repr=False)
    cells: tuple[str, ...] = field(repr=False)
    numbers: NDArray[np.int64] = field(repr=False)
    machines: NDArray[np.int64] = field(repr=False)
    values: NDArray[np.float32] = field(repr=False)
    conditions: Float = field(repr=False)
    counts: NDArray[np.int64] = field(repr=False)
    speeds: Float = field(repr=False)
    sizes: Float = field(repr=False)
    world: dict[str, Any] = field(default_factory=dict, repr=False)

    def __len__(self) -> int:
        return len(self.numbers)

    @property
    def present(self) -> NDArray[np.bool_]:
        """Presence of each effect, shape (n_rigs, n_effects)."""
        return present_effects(self.sizes, self.size_names, self.names)

    def of(self, rows: Index | NDArray[np.bool_]) -> Rigs:
        """Return some of the rigs."""
        columns: dict[str, Any] = {
            name: values[rows] for name, values in vars(self).items() if isinstance(values, np.ndarray)
        }
        return dataclasses.replace(self, **columns)

    def session(
        self, rig: int, recordings: Index = slice(None), *, counts: bool = True, tachometer: bool = False
    ) -> Session:
        """Return recordings of the rig in a row, without those that failed.

        ``counts`` and ``tachometer`` state whether counts of worn lobes and the speed are known.
        """
        shown = np.arange(self.values.shape[1])[recordings]
        shown = shown[np.isfinite(self.values[rig, shown, 0])]
        return Session(
            self.values[rig, shown].astype(np.float64),
            self.conditions[rig, shown],
            self.counts[rig, shown] if counts else None,
            self.speeds[rig, shown] if tachometer else None,
        )


def present_effects(sizes: Float, size_names: Sequence[str], names: Sequence[str]) -> NDArray[np.bool_]:
    """Return which effects rigs have (n_rigs, n_effects): sizes (n_rigs, n_sizes) of absent ones are NaN."""
    owners = np.array([name.partition(".")[0] for name in size_names])
    return np.column_stack([np.isfinite(sizes[:, owners == name]).any(axis=1) for name in names])
