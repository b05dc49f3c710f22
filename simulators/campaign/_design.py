"""Design of a campaign: rig, classes, the values that each run draws, and the runs themselves."""

from __future__ import annotations

import dataclasses
import inspect
import json
import math
import os
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cyclofeat._base import checks
from cyclofeat._base.files import write_whole
from cyclofeat._base.quantities import from_1
from cyclofeat._base.shards import json_bytes
from cyclofeat.simulators.defects import MOST_WEAR_UM, LobeDefects
from cyclofeat.simulators.effects.effect import reject_unknown, settings_of_file, settings_to_file
from cyclofeat.simulators.effects.library import label_effects
from cyclofeat.simulators.machine import MachineRun, PlannedRun
from cyclofeat.simulators.rig import Rig, read_json
from cyclofeat.simulators.sampling import Sample, Wear, recording_seed, sample_runs
from cyclofeat.simulators.simulation import GearboxLocked, SimulationFailed, Solver, settling_time

Float = NDArray[np.float64]

FORMAT = "cyclofeat campaign 3"
_NOTE = (
    "SI units, as in the rig. rig: R0, R1, R2, or an object as in a rig's own file; its parameters that are "
    "ranges or distributions are explored. Missing keys have their default."
)
_PRESETS: dict[str, Callable[[], Rig]] = {"R0": Rig.r0, "R1": Rig.r1, "R2": Rig.r2}
DEPTH, WEAR = "depth", "wear_um"
OF_DEFECTS = (DEPTH, WEAR)  # explored, but no parameters of the rig
# Keys of a file that do not belong to the design.
_REMARKS = ("format", "note", "made_with")
# Larger than any byte of a name, to separate the seeds of the design from those of the runs.
_DESIGN_KEY = 1000
# Length of scipy's Sobol' sequences.
_MOST_REPEATS = 2**30
# Of campaigns that do not state their shards: few runs are lost, and many runs do not make many files.
_FEWEST_SHARDS, _LONGEST_SHARD = 20, 128
OK = "ok"  # other values of "status": "diverged", "locked", "invalid" (parameters contradict each other)
# Columns of every campaign's table and their types; those of its effects follow.
_COLUMNS: dict[str, type] = {
    "run": int, "assembly": str, "defect_count": int, "worn_lobes_from_1": list, "wheels_from_1": list,
    DEPTH: float, "status": str, "reason": str, "kernel": str, "start_angle_rad": float, "settling_s": float,
    "true_speed_rpm": float, "true_load_nm": float, "brake_inertia_kg_m2": float,
    "meter_stiffness_nm_per_rad": float, "meter_damping_nms_per_rad": float, "stiffness_scale": float,
    "contact_damping": float, "clearance_m": float,
}  # fmt: skip


class RunPlan(NamedTuple):
    """Class and explored values of one run of a campaign."""

    run: int  #: index in the campaign, from 0
    defect_count: int  #: number of worn lobes
    values: dict[str, float]  #: explored values by name, as in :attr:`Campaign.explored_names`


@dataclass(frozen=True)
class Campaign(checks.Replaceable):
    """Design of a campaign: a rig with ranges and distributions, and classes, to be simulated to disk.

    Run i has the defect count ``defect_counts[i % len(defect_counts)]`` and a machine of its own. The design
    spreads the runs evenly over the probability of each parameter of the rig that is a range or a
    distribution. Pin errors, start angle, drift and noise are drawn for each run. Random numbers follow from
    the campaign's name, its ``random_state`` and ``i``; neither the number of workers nor more repeats change
    them. Torque made with a rig is a surrogate for measured torque.

    Parameters
    ----------
    name : str
        Prefix of the names of the assemblies. Campaigns of different names draw different random numbers, so
        that one may train and the other test.
    rig : Rig or {"R0", "R1", "R2"}, default "R1"
        Gearbox and effects. A range of load or speed is an effect too:
        ``GearboxParameter("load_torque", (15, 25))``.
    defect_counts : sequence of int, default 0 to 7
        Classes: numbers of worn lobes.
    repeats : int
        Runs, hence assemblies, per class.
    lobes : {"consecutive", "random"}
        Worn lobes: neighbours from a random first one, or any.
    wheels : "random" or sequence of int
        Wheels with the wear: ``(0,)``, ``(1,)``, ``(0, 1)``, or wheel 0 or both with equal chances.
    depth : float or (float, float)
        Depth of the wear, above 0 up to 1 (the papers' chord), or a range to explore.
    wear_um : float or (float, float), optional
        Radial wear in um in place of the chord, above 0 up to 200, or a range to explore.
    duration : float
        Length of each record in s. It begins when the assembly has settled.
    sampling_rate : float
        In Hz.
    design : {"sobol", "random"}
        Scrambled Sobol' sequence for each class, or independent random numbers.
    random_state : int
        Seed of the whole campaign.
    runs_per_shard : int, optional
        Runs in one file. Default: so many that there are 20 files, but at most 128. An interrupted campaign
        loses the shard that is not full, and the runs that its workers were at.
    kernel : {"auto", "batch", "exact"}
        See :func:`cyclofeat.simulators.simulate_many`. "auto" and "batch" raise where batches cannot be
        compiled, for other runs would be made than elsewhere.
    integrator : {"midpoint", "adams_bashforth", "leapfrog"}
        See :class:`cyclofeat.simulators.Solver`: the second takes half the time, with about three times the
        error of the time step.

    Examples
    --------
    >>> from cyclofeat.simulators import GearboxParameter
    >>> rig = Rig.r1().with_effects(GearboxParameter("load_torque", (15, 25)))
    >>> campaign = Campaign(rig=rig, defect_counts=(0, 3), repeats=4)
    >>> campaign.n_runs, campaign.n_samples
    (8, 46080)
    >>> campaign.explored_names[0]
    'gearbox_parameter_load_torque.value'
    >>> [plan.defect_count for plan in campaign.plans(0, 4)]
    [0, 3, 0, 3]
    """

    name: str = "campaign"
    rig: Any = "R1"
    defect_counts: tuple[int, ...] = tuple(range(8))
    repeats: int = 10
    lobes: str = "consecutive"
    wheels: str | tuple[int, ...] = "random"
    depth: float | tuple[float, float] = 1.0
    wear_um: float | tuple[float, float] | None = None
    duration: float = 1.8
    sampling_rate: float = 25_600.0
    design: str = "sobol"
    random_state: int = 0
    runs_per_shard: int | None = None
    kernel: str = "auto"
    integrator: str = "midpoint"

    def __post_init__(self) -> None:
        checks.check_type("name", self.name, str)
        if not self.name or not self.name.isprintable():
            raise ValueError(f"name must be a line of printable text, got {self.name!r}")
        keep = object.__setattr__
        keep(self, "rig", _rig_of(self.rig))
        keep(self, "defect_counts", checks.defect_counts(self.defect_counts, self.rig.gearbox.n_lobes))
        keep(self, "repeats", checks.whole("repeats", self.repeats, 1, _MOST_REPEATS))
        keep(self, "random_state", checks.whole("random_state", self.random_state, 0))
        if self.runs_per_shard is not None:
            keep(self, "runs_per_shard", checks.whole("runs_per_shard", self.runs_per_shard, 1))
        checks.one_of("lobes", self.lobes, ("consecutive", "random"))
        checks.one_of("design", self.design, ("sobol", "random"))
        checks.one_of("kernel", self.kernel, ("exact", "batch", "auto"))
        Solver(integrator=self.integrator)
        keep(self, "wheels", checks.wheel_numbers(self.wheels) or "random")
        keep(self, "duration", checks.positive("duration", self.duration, "a number of s"))
        keep(self, "sampling_rate", checks.positive("sampling_rate", self.sampling_rate, "a number of Hz"))
        if self.n_samples < 2:
            raise ValueError(
                f"duration must hold at least 2 samples at {self.sampling_rate:g} Hz, got {self.duration!r}"
            )
        keep(self, DEPTH, _check_severity(DEPTH, self.depth, 1.0, "1 (the papers' chord)"))
        if self.wear_um is not None:
            keep(self, WEAR, _check_severity(WEAR, self.wear_um, MOST_WEAR_UM, f"{MOST_WEAR_UM:g} um"))
            if self.depth != 1.0:
                raise ValueError(f"depth has no effect with wear_um: leave it out, got {self.depth!r}")

    @property
    def n_runs(self) -> int:
        """Number of runs."""
        return self.repeats * len(self.defect_counts)

    @property
    def n_samples(self) -> int:
        """Number of samples of each run."""
        return round(self.duration * self.sampling_rate)

    @property
    def shard_length(self) -> int:
        """Number of runs in each shard; the last may be shorter."""
        return self.runs_per_shard or min(math.ceil(self.n_runs / _FEWEST_SHARDS), _LONGEST_SHARD)

    @property
    def n_shards(self) -> int:
        """Number of shards."""
        return math.ceil(self.n_runs / self.shard_length)

    @property
    def explored_names(self) -> tuple[str, ...]:
        """Names of the explored parameters, as in :meth:`Rig.parameters`; those of the wear."""
        return tuple(quantile_functions(self))

    def plans(self, first: int = 0, n_runs: int | None = None) -> Iterator[RunPlan]:
        """Yield the plans of successive runs.

        Parameters
        ----------
        first, n_runs : int, optional
            Index of the first run, and number of runs. Default: all.

        Yields
        ------
        RunPlan
        """
        end = self.n_runs if n_runs is None else min(first + n_runs, self.n_runs)
        n_classes = len(self.defect_counts)
        repeat, last = first // n_classes, -(-end // n_classes)
        quantiles = quantile_functions(self)
        shares = {count: self._draw_shares(count, repeat, last - repeat) for count in self.defect_counts}
        for index in range(first, end):
            count = self.defect_counts[index % n_classes]
            pairs = zip(quantiles.items(), shares[count][index // n_classes - repeat].tolist(), strict=True)
            yield RunPlan(index, count, {name: float(quantile(share)) for (name, quantile), share in pairs})

    def _draw_shares(self, count: int, first: int, n: int) -> Float:
        """Return the probability below each explored value, shape (n, n_explored).

        Each class has its own sequence: a single one would correlate the class with the parameters (each of
        eight consecutive points lies in a different eighth).
        """
        key = [self.random_state, *self.name.encode(), _DESIGN_KEY + count]
        if not self.explored_names:
            return np.empty((n, 0))
        if self.design == "random":
            rows = (
                np.random.default_rng(np.random.SeedSequence(key, spawn_key=(repeat,)))
                for repeat in range(first, first + n)
            )
            return np.array([row.random(len(self.explored_names)) for row in rows])
        from scipy.stats import qmc  # slow to import

        # scipy 1.15 renamed the argument.
        name = "rng" if "rng" in inspect.signature(qmc.Sobol).parameters else "seed"
        random = np.random.default_rng(np.random.SeedSequence(key))
        engine = qmc.Sobol(len(self.explored_names), scramble=True, **{name: random})
        if first:
            engine.fast_forward(first)
        with warnings.catch_warnings():
            # The sequence is balanced for powers of 2 only; other numbers are acceptable here.
            warnings.filterwarnings("ignore", "The balance properties", UserWarning)
            return np.asarray(engine.random(n), dtype=float)

    def to_dict(self) -> dict[str, Any]:
        """Return the design as plain numbers, text, lists and dicts.

        Returns
        -------
        dict
            Every field of the campaign by name, as in the file of :meth:`to_json`.
        """
        content: dict[str, Any] = {}
        for item in dataclasses.fields(self):
            value = getattr(self, item.name)
            content[item.name] = value.to_dict() if isinstance(value, Rig) else value
        # Tuples become lists, as in a file.
        plain: dict[str, Any] = json.loads(json.dumps(settings_to_file(content), allow_nan=False))
        return plain

    def to_json(self, path: str | os.PathLike[str]) -> None:
        """Write the design to a JSON file, every value explicit.

        Parameters
        ----------
        path : path
            File to write; an existing file is replaced.
        """
        content = json_bytes({"format": FORMAT, "note": _NOTE, **self.to_dict()})
        write_whole(Path(path), lambda file: file.write(content))

    @classmethod
    def from_json(
        cls, path: str | os.PathLike[str], *, preset: Callable[[str], Rig] | None = None
    ) -> Campaign:
        """Read a design from a JSON file.

        Parameters
        ----------
        path : path
            File in UTF-8, such as ``campaign.json`` of a campaign's folder: one object with optional
            parameters of :class:`Campaign`; ``"rig"`` is the name of a preset or an object as in
            :meth:`cyclofeat.simulators.Rig.from_json`.
        preset : callable, optional
            Returns the rig of a name, such as :func:`cyclofeat.datasets.rig_preset`. Default: ``"R0"``,
            ``"R1"`` and ``"R2"`` only.

        Returns
        -------
        Campaign
            Equal to the campaign that was written.

        Raises
        ------
        ValueError
            If the file is not JSON, or a key or value is wrong; the message names file, key and value.
        """
        make = partial(cls.from_dict, preset=preset)
        return read_json(path, make, "a campaign", '{"name": "mine", "rig": "R2", "repeats": 100}')

    @classmethod
    def from_dict(cls, content: Any, *, preset: Callable[[str], Rig] | None = None) -> Campaign:
        """Return the design of a content as :meth:`to_dict` gives it.

        Parameters
        ----------
        content : dict
            May leave out keys; may hold the remarks of a file too.
        preset : callable, optional
            See :meth:`from_json`.

        Returns
        -------
        Campaign

        Raises
        ------
        TypeError, ValueError
            If a key or value is wrong; the message names it.
        """
        if not isinstance(content, dict):
            raise TypeError(f"the file must hold a JSON object {{...}}, got {checks.repr_of(content)}")
        form = content.get("format", FORMAT)
        if form != FORMAT:
            raise ValueError(f"format must be {FORMAT!r}, got {checks.repr_of(form)}")
        given = settings_of_file(content)
        reject_unknown(given, [*(item.name for item in dataclasses.fields(cls)), *_REMARKS])
        for name in _REMARKS:
            given.pop(name, None)
        rig = given.get("rig")
        if isinstance(rig, dict) or (isinstance(rig, str) and preset is not None):
            try:
                given["rig"] = preset(rig) if isinstance(rig, str) and preset else Rig.from_dict(rig)
            except (TypeError, ValueError) as error:
                raise type(error)(f"rig: {error}") from None
        return cls(**given)


def shard_size(campaign: Campaign, shard: int) -> int:
    """Return the number of runs in a shard, counted from 0."""
    return min(campaign.shard_length, campaign.n_runs - shard * campaign.shard_length)


def quantile_functions(campaign: Campaign) -> dict[str, Callable[[float], float]]:
    """Return by name of each explored parameter the value, in its unit, of a probability from 0 to 1."""
    quantiles: dict[str, Callable[[float], float]] = {}
    for label, effect in label_effects(campaign.rig.effects).items():
        for name, parameter in effect.parameters.items():
            value = getattr(effect, name)
            if not checks.is_number(value):
                quantiles[f"{label}.{name}"] = partial(parameter.draw, value)
    for name in OF_DEFECTS:
        if isinstance(value := getattr(campaign, name), tuple):
            quantiles[name] = partial(np.interp, xp=(0.0, 1.0), fp=value)
    return quantiles


def _rig_at(campaign: Campaign, values: Mapping[str, float]) -> Rig:
    """Return the rig with its explored parameters set to those of a plan."""
    rig: Rig = campaign.rig
    return rig.with_parameters({name: v for name, v in values.items() if name not in OF_DEFECTS})


def draw_defects(campaign: Campaign, plan: RunPlan) -> LobeDefects:
    """Draw the worn lobes of a run."""
    depth, wear_um = (plan.values.get(name, getattr(campaign, name)) for name in OF_DEFECTS)
    wear = Wear(
        lobes=campaign.lobes, wheels=None if isinstance(campaign.wheels, str) else campaign.wheels,
        depth=depth, wear_um=None if wear_um is None else (wear_um, wear_um),
    )  # fmt: skip
    seed = recording_seed(campaign.random_state, campaign.name, plan.run)
    return wear.draw(plan.defect_count, campaign.rig.gearbox.n_lobes, seed)


def sample_of(campaign: Campaign, plan: RunPlan) -> Sample:
    """Return a run to simulate; raise ValueError if the values of the plan contradict each other."""
    return Sample(
        rig=_rig_at(campaign, plan.values), defects=draw_defects(campaign, plan),
        duration=campaign.n_samples / campaign.sampling_rate, sampling_rate=campaign.sampling_rate,
        random_state=recording_seed(campaign.random_state, campaign.name, plan.run),
        solver=Solver(integrator=campaign.integrator),
    )  # fmt: skip


def _rig_of(rig: Any) -> Rig:
    if isinstance(rig, Rig):
        return rig
    if isinstance(rig, str) and rig.upper() in _PRESETS:
        return _PRESETS[rig.upper()]()
    raise ValueError(f"rig must be one of {tuple(_PRESETS)} or a Rig, got {checks.repr_of(rig)}")


def _check_severity(name: str, value: Any, most: float, words: str) -> float | tuple[float, float]:
    low, high = checks.range_ends(name, value)
    if not 0 < low <= high <= most:
        raise ValueError(f"{name} must lie above 0 and up to {words}, or be such a range, got {value!r}")
    return low if checks.is_number(value) else (low, high)


class RunResult(NamedTuple):
    """Result of a run: torque of shape (n_samples,), or None if it failed, and the table's row."""

    torque: NDArray[np.float32] | None
    row: dict[str, Any]


def table_columns(campaign: Campaign) -> dict[str, type]:
    """Return the columns of a campaign's table and their types."""
    effects = {
        f"effects.{label}.{name}": float
        for effects in campaign.rig.effect_sets()
        for label, effect in label_effects(effects).items()
        for name in effect.parameters
    }
    radial = {} if campaign.wear_um is None else {WEAR: float}
    return {**_COLUMNS, **radial, **effects}


def check_kernel(campaign: Campaign) -> None:
    """Raise RuntimeError if the campaign needs batches and they cannot be compiled here."""
    if campaign.kernel == "exact":
        return
    from cyclofeat.simulators.batch import runs

    if error := runs.compile_error():
        raise RuntimeError(f"batches cannot be compiled: {error}; a campaign of kernel='exact' needs none")


def check_middle(campaign: Campaign) -> None:
    """Raise an error unless the kernel works here and the medians of the design can be simulated."""
    check_kernel(campaign)
    duration = max(2 / campaign.sampling_rate, min(campaign.duration, 0.01))
    try:
        quantiles = quantile_functions(campaign)
        rig = _rig_at(campaign, {name: float(quantile(0.5)) for name, quantile in quantiles.items()})
        planned = rig.plan_run(
            duration=duration, sampling_rate=campaign.sampling_rate, random_state=0, torque_in=False,
            motion=False,
        )  # fmt: skip
        (run,) = sample_runs([planned], kernel=campaign.kernel)
        if isinstance(run, ValueError):
            raise run
        if isinstance(run, MachineRun):  # a failure is a result, and other runs may succeed
            run.record()
    except ValueError as error:
        raise ValueError(f"the design cannot be simulated, not even in its middle: {error}") from None


def _draw_run(campaign: Campaign, plan: RunPlan) -> tuple[dict[str, Any], PlannedRun | ValueError]:
    """Return the row of a run, with all that is known before it, and what is to be simulated."""
    defects = draw_defects(campaign, plan)
    row: dict[str, Any] = {name: math.nan for name, kind in table_columns(campaign).items() if kind is float}
    row |= {f"effects.{name}": value for name, value in plan.values.items() if name not in OF_DEFECTS}
    row |= {
        "run": plan.run,
        "assembly": f"{campaign.name}-{campaign.random_state}-{plan.run:07d}",
        "defect_count": plan.defect_count,
        "worn_lobes_from_1": from_1(defects.worn_lobes),
        "wheels_from_1": from_1(defects.wheels) if defects.worn_lobes else [],
        DEPTH: defects.depth if defects.worn_lobes else 0.0,
    }
    if campaign.wear_um is not None:
        row[WEAR] = defects.wear_um if defects.worn_lobes else 0.0
    planned: PlannedRun | ValueError
    try:
        sample = sample_of(campaign, plan)
        try:
            planned = sample.plan()
        except ValueError as error:
            machine, planned = sample.rig.draw(sample.random_state), error
            settling = settling_time(machine.gearbox)
        else:
            machine, settling = planned.machine, planned.n_settling / campaign.sampling_rate
    except ValueError as error:  # there is no such machine
        return row, error
    row |= {"settling_s": settling, **machine.true_values()}
    for label, drawn in label_effects(machine.effects).items():
        row |= {f"effects.{label}.{name}": float(getattr(drawn, name)) for name in drawn.parameters}
    return row, planned


def simulate_runs(campaign: Campaign, plans: Sequence[RunPlan]) -> list[RunResult]:
    """Simulate runs, each of which depends on its own plan only."""
    rows, planned = zip(*(_draw_run(campaign, plan) for plan in plans), strict=True)
    results = []
    for row, run in zip(rows, sample_runs(planned, kernel=campaign.kernel), strict=True):
        row |= {"status": OK, "reason": "", "kernel": ""}
        torque = None
        try:
            if isinstance(run, Exception):
                raise run
            record = run.record()
        except SimulationFailed as error:
            status = "locked" if isinstance(error, GearboxLocked) else "diverged"
            row |= {"status": status, "reason": str(error), "kernel": "exact"}
        except ValueError as error:
            # An impossible combination of values is a result, like a run that diverges.
            row |= {"status": "invalid", "reason": str(error)}
        else:
            # Angle of the input, modulo one turn of the output.
            angle = float(record.input_angle[0] % (2 * np.pi * record.gearbox.n_lobes))
            row |= {"kernel": record.kernel, "start_angle_rad": angle}
            torque = record.torque_out.astype(np.float32)
        results.append(RunResult(torque, row))
    return results
