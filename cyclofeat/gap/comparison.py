"""Input that all stages of the gap share: model, allowed differences, conditions, and simulations."""

from __future__ import annotations

import functools
import itertools
import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cyclofeat._base import checks
from cyclofeat._base.checks import is_number, list_members, one_of, positive, truth_value, whole
from cyclofeat._base.checks import n_jobs as checked_jobs
from cyclofeat._base.quantities import TORQUES
from cyclofeat.gap.simulations import MAY_DIFFER, Bank, Population, remember, simulate_bank, with_may_differ
from cyclofeat.gap.summaries.summarise import SPEED_TOLERANCE, Kinematics, summarise_windows
from cyclofeat.gap.summaries.turns import MeasuredTurns, mix_counts
from cyclofeat.signal.orders import mean_speed
from cyclofeat.simulators import CycloidalGearbox, Effect, LobeDefects, Rig

Float = NDArray[np.float64]


@dataclass(frozen=True)
class Condition:
    """Set-points of recordings.

    Attributes
    ----------
    speed_rpm : float
        Speed of the input shaft.
    load_nm : float
        Size of the load torque.
    direction : {1, -1}
        -1 in reverse, where the torque is negative.
    """

    speed_rpm: float
    load_nm: float
    direction: int = 1

    @property
    def text(self) -> str:
        """The condition in words."""
        reverse = "" if self.direction > 0 else ", reverse"
        return f"{self.speed_rpm:.4g} RPM, {self.load_nm:.3g} Nm{reverse}"


@dataclass(frozen=True, kw_only=True)
class Comparison(checks.Replaceable):
    """Model and conditions that measured recordings are compared under, and the simulations made for it.

    Every stage of the gap takes a comparison first. Simulated recordings are kept in the folder ``cache``.

    Parameters
    ----------
    sampling_rate : float
        Samples per second of the recordings in Hz.
    rig : Rig
        The model; a gearbox is a rig without effects. Default: paper B's gearbox.
    duration : float, default=1.8
        Length of a window in s, at least one output turn; whole turns of it are compared.
    input_speed_hz : float, optional
        Nominal input speed of the recordings in Hz, the model's within 3 %. Default: the model's.
    direction : {1, -1}, default=1
        -1 if the gearbox runs in reverse. All torque is positive for a load that brakes: that of recordings
        in reverse has the other sign than it was measured with.
    quantity : {"output_torque", "input_torque"}, default="output_torque"
        What was measured. Input torque is multiplied by the reduction: all torques are referred to the
        output.
    may_differ : tuple of Effect
        Effects that may differ between a measured and a simulated recording without being missing: added to
        the rig for those kinds of effects that it does not state itself. All values are *assumptions*.
    defect_counts : sequence of int, default=range(8)
        Counts of worn lobes from which that of a recording is drawn, where it is not known.
    wheels : tuple of tuple of int
        Wheels that may carry the wear, with equal chances.
    tachometer : bool, default=False
        Whether the recordings have the angle of the input shaft.
    one_assembly : bool, default=False
        Whether all measured recordings are of one gearbox that was not taken apart between them: they have
        its errors in common, and count as fewer.
    n_bank : int, default=200
        Simulated recordings that measured ones are compared with.
    random_state : int, default=0
    n_jobs : int, default=1
        Number of worker processes of the simulations.
    cache : path, optional
        Folder in which simulations are kept: an interrupted run goes on from there.

    Examples
    --------
    >>> comparison = Comparison(sampling_rate=6400.0, defect_counts=(0, 3))
    >>> bank = comparison.bank(2)
    >>> bank.X.shape, bank.counts.tolist()
    ((2, 11520), [0, 3])
    """

    sampling_rate: float
    rig: Rig = Rig()  # noqa: RUF009  (frozen)
    duration: float = 1.8
    input_speed_hz: float | None = None
    direction: int = 1
    quantity: str = "output_torque"
    may_differ: tuple[Effect, ...] = MAY_DIFFER
    defect_counts: Sequence[int] = tuple(range(8))
    wheels: tuple[tuple[int, ...], ...] = ((0,), (0, 1))
    tachometer: bool = False
    one_assembly: bool = False
    n_bank: int = 200
    random_state: int = 0
    n_jobs: int = 1
    cache: str | os.PathLike[str] | None = None

    def __post_init__(self) -> None:
        counts: tuple[Any, ...] = list_members(self.defect_counts) or ()
        model: Any = self.rig
        if not counts or not all(is_number(c) and float(c).is_integer() and c >= 0 for c in counts):
            raise ValueError(f"defect_counts must hold whole numbers from 0, got {self.defect_counts!r}")
        checked: dict[str, Any] = {
            "sampling_rate": positive("sampling_rate", self.sampling_rate, "a number of Hz"),
            "duration": positive("duration", self.duration, "a number of s"),
            "rig": model if isinstance(model, Rig) else Rig(model or CycloidalGearbox.steel()),
            "quantity": one_of("quantity", self.quantity, TORQUES),
            "defect_counts": tuple(int(count) for count in counts),
            "tachometer": truth_value("tachometer", self.tachometer),
            "one_assembly": truth_value("one_assembly", self.one_assembly),
            "random_state": whole("random_state", self.random_state, 0),
            "n_bank": whole("n_bank", self.n_bank, 10),
            "n_jobs": checked_jobs(self.n_jobs),
        }
        if self.direction not in (1, -1):
            raise ValueError(f"direction must be 1 or -1, got {self.direction!r}")
        if not self.wheels:
            raise ValueError(f"wheels must hold at least one of (0,), (1,) and (0, 1), got {self.wheels!r}")
        for wheels in self.wheels:
            LobeDefects.worn(0, wheels=wheels)
        # Rounded in RPM, so that 500 RPM give exactly 500 / 60 Hz.
        of_model = round(checked["rig"].gearbox.input_speed * 30 / np.pi, 9) / 60
        speed = of_model if self.input_speed_hz is None else positive("input_speed_hz", self.input_speed_hz)
        if abs(of_model / speed - 1) > SPEED_TOLERANCE:
            raise ValueError(
                f"input_speed_hz must be the model's speed, {of_model:.4g} Hz ({60 * of_model:.4g} RPM), got "
                f"{speed:.4g} ({60 * speed:.4g} RPM): give a model of that speed"
            )
        for name, value in (checked | {"input_speed_hz": speed}).items():
            object.__setattr__(self, name, value)

    @property
    def kinematics(self) -> Kinematics:
        """Rate, nominal speed and number of lobes."""
        assert self.input_speed_hz is not None
        return Kinematics(self.sampling_rate, self.input_speed_hz, self.n_lobes)

    @property
    def condition(self) -> Condition:
        """Nominal speed, load and direction."""
        speed_rpm = round(60 * self.kinematics.input_speed_hz, 6)
        return Condition(speed_rpm, float(self.rig.gearbox.load_torque), self.direction)

    @property
    def n_lobes(self) -> int:
        """Number of lobes of the model's discs."""
        return int(self.rig.gearbox.n_lobes)

    @property
    def n_samples(self) -> int:
        """Number of samples that are compared: those of whole output turns."""
        return self.kinematics.whole_turns(round(self.duration * self.sampling_rate))

    @functools.cached_property
    def population(self) -> Population:
        """Source of simulated recordings: the model with what may differ anyway."""
        rig = with_may_differ(self.rig, self.may_differ)
        return Population(rig, self.n_samples, self.sampling_rate, self.wheels, self.direction, self.quantity)

    def bank(
        self,
        n: int,
        counts: Iterable[int] | None = None,
        *,
        n_assemblies: int | None = None,
        random_state: int | None = None,
    ) -> Bank:
        """Simulate recordings, or return those simulated before.

        Parameters
        ----------
        n : int
            Number of recordings.
        counts : iterable of int, optional
            Counts of worn lobes, which the recordings take in turn. Default: ``defect_counts``.
        n_assemblies : int, optional
            Recordings i and i + n_assemblies are of the same assembly. Default: each has its own.
        random_state : int, optional
            Default: that of the comparison.

        Returns
        -------
        Bank
            Torque in Nm, shape (n, n_samples); worn lobes, mean input speed in Hz and assembly of each.

        Raises
        ------
        SimulationFailed
            If at least half of the simulations fail.
        """
        wanted = self.defect_counts if counts is None else tuple(int(count) for count in counts)
        state = self.random_state if random_state is None else random_state
        return remember(
            self.cache,
            lambda: simulate_bank(
                self.population, wanted, n, n_assemblies=n_assemblies, random_state=state, n_jobs=self.n_jobs
            ),
            "bank", self.population.text, wanted, n, n_assemblies, state,
        )  # fmt: skip


def measured_turns(
    comparison: Comparison,
    X: ArrayLike,
    y: ArrayLike | None = None,
    groups: ArrayLike | None = None,
    angle: ArrayLike | None = None,
) -> MeasuredTurns:
    """Return measured windows of about ``duration``, torque in Nm (n_windows, n_samples), in whole turns.

    ``y`` are counts of worn lobes, where they are known; ``groups`` the recording of each window (default: a
    recording each); ``angle`` is that of the input shaft in rad, like X, if there is a tachometer.
    """
    windows, n_samples = np.asarray(X), comparison.n_samples
    names = np.arange(len(windows)) if groups is None else groups
    _, first, of_window = np.unique(names, return_index=True, return_inverse=True)
    return MeasuredTurns(
        # The precision of simulated recordings: otherwise the share of distinct values would differ.
        windows[:, :n_samples].astype(np.float32),
        of_window,
        None if y is None else np.asarray(y)[first].astype(np.int64),
        None if angle is None else mean_speed(np.asarray(angle)[:, :n_samples], comparison.sampling_rate),
        comparison.kinematics,
    )


def corrected_rig(
    comparison: Comparison, effects: Iterable[Effect] = (), variants: Sequence[Sequence[Effect]] = ()
) -> Rig:
    """Return the model with effects added, after the ``may_differ`` effects of the same kinds.

    ``variants`` are effects of single assemblies: each joins one of the model's variants, if it has some.
    """
    added = tuple(effects)
    kinds = {effect.effect_id for effect in itertools.chain(added, *variants)}
    own = with_may_differ(comparison.rig, [one for one in comparison.may_differ if one.effect_id in kinds])
    joined = [(*first, *more) for first, more in zip(itertools.cycle(own.variants or ((),)), variants)]
    return own.with_added(*added).replace(variants=joined if any(joined) else own.variants)


def summarise_bank(comparison: Comparison, bank: Bank) -> Float:
    """Summarise simulated recordings: (n, n_cells), each cell in its own unit (dB, Nm, bit, % or none)."""
    speeds, kinematics = bank.speeds if comparison.tachometer else None, comparison.kinematics
    return remember(
        comparison.cache, lambda: summarise_windows(bank.X, kinematics, speeds)[0],
        "summaries", bank.X, speeds, kinematics,
    )  # fmt: skip


def bank_like(comparison: Comparison, measured: MeasuredTurns) -> Bank:
    """Simulate ``n_bank`` recordings with the counts of measured ones in about their shares, if known."""
    counts = None if measured.counts is None else mix_counts(measured.counts, comparison.n_bank)
    return comparison.bank(comparison.n_bank, counts)


@dataclass(frozen=True)
class GapSettings:
    """Settings of :func:`find_gap`.

    Attributes
    ----------
    alpha : float
        Chance of a false "disagree".
    pictures : bool
        Whether to fold torque over the turn and to test all numbers at once, as the page shows them.
    n_after, n_report : int
        Simulated recordings of the corrected model in the overlays, and of each model that is judged by the
        recordings held out.
    n_permutations : int
        Relabellings of the comparison.
    n_bank : int
        Simulated recordings that those of each condition are compared with.
    random_state : int, optional
        Seed of all simulations. Default: drawn at random.
    n_jobs : int
        Number of worker processes.
    cache : path or None
        Folder in which simulations are kept.
    one_assembly : bool
        Whether all recordings are of one gearbox that was not taken apart between them.
    """

    alpha: float = 0.03
    pictures: bool = True
    n_after: int = 96
    n_report: int = 64
    n_permutations: int = 999
    n_bank: int = 200
    random_state: int | None = None
    n_jobs: int = 1
    cache: str | os.PathLike[str] | None = None
    one_assembly: bool = False

    def __post_init__(self) -> None:
        if not 0 < checks.number("alpha", self.alpha) < 1:
            raise ValueError(f"alpha must be between 0 and 1, got {self.alpha!r}")
        least = {"n_after": 10, "n_report": 10, "n_permutations": 19, "n_bank": 10}
        for name, low in least.items():
            checks.whole(name, getattr(self, name), low)
        object.__setattr__(self, "random_state", checks.seed_number(self.random_state))

    @property
    def seed(self) -> int:
        """The ``random_state``, drawn where none was given."""
        assert self.random_state is not None
        return self.random_state
