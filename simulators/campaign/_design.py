"""The design of a campaign: what is simulated, and which run draws what."""

from __future__ import annotations

import dataclasses
import json
import math
import os
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cyclofeat.simulators._checks import number, short, whole
from cyclofeat.simulators.campaign._parameters import check_name, with_values
from cyclofeat.simulators.rig import Rig, _distinct, _reject_unknown, _rig_from

if TYPE_CHECKING:
    from cyclofeat.simulators.campaign._load import CampaignData

Float = NDArray[np.float64]
Explored = tuple[float, float] | tuple[float, float, str]

FORMAT = "cyclofeat campaign 1"
_NOTE = (
    'SI units, as in the rig. parameters: [low, high] is explored evenly, [low, high, "log"] evenly in its '
    "logarithm. rig: R0, R1, R2, or an object as in a rig's own file. Keys left out keep their default."
)
_PRESETS: dict[str, Callable[[], Rig]] = {"R0": Rig.r0, "R1": Rig.r1, "R2": Rig.r2}
_PATTERNS = ("consecutive", "random")
_DESIGNS = ("sobol", "random")
_WHEELS = ((0,), (1,), (0, 1))
DEPTH = "depth"
# Keys of a file that say where it came from and do not belong to the design.
_REMARKS = ("format", "note", "made_with")
# Beyond any byte of a name: keeps the seeds of the design apart from those of the runs.
_DESIGN_KEY = 1000
# Of the sequence by Sobol that scipy holds: 2**30 points.
_MOST_REPEATS = 2**30


class RunPlan(NamedTuple):
    """What one run of a campaign is to be.

    Parameters
    ----------
    run : int
        Place in the campaign, from 0.
    defect_count : int
        Number of worn lobes.
    values : dict from str to float
        Value of each explored parameter, ``"depth"`` among them where it is a range.
    """

    run: int
    defect_count: int
    values: dict[str, float]


@dataclass(frozen=True)
class Campaign:
    """Design of a campaign: many runs of assemblies drawn from a rig, written to disk.

    Run i has the defect count ``defect_counts[i % len(defect_counts)]``: class after class in turn, each run
    an assembly of its own. All that is random in a run follows from the campaign's name and seed and from
    ``i``; neither the number of workers nor more repeats change it. Everything about a rig that the papers
    do not state is an *assumption*, and torque made with it is a surrogate for measured torque.

    Parameters
    ----------
    name : str
        Name, which begins those of the assemblies. It counts for the seeds: two campaigns of different names
        share no assembly, so that one may train and the other test.
    rig : Rig or {"R0", "R1", "R2"}, default "R1"
        Gearbox and rig with their spread and effects. Kept as a Rig.
    defect_counts : sequence of int, default 0 to 7
        Classes: numbers of worn lobes.
    repeats : int
        Runs, hence assemblies, per class.
    lobes : {"consecutive", "random"}
        Worn lobes: neighbours, from a random first one; or any.
    wheels : "random" or sequence of int
        Wheels that carry the wear: wheel 0 alone or both, with equal chances; or ``(0,)``, ``(1,)``,
        ``(0, 1)``.
    depth : float or (float, float)
        Depth of the wear, above 0 up to 1 (the papers' chord), or a range that is explored.
    duration_s : float
        Length of each record in s. It begins when the assembly has settled.
    sampling_rate : float
        In Hz.
    parameters : mapping from str to (low, high) or (low, high, "log")
        Parameters explored, by name (:func:`parameter_names`): a field of the gearbox
        (``"load_torque"``), of the rig (``"noise_nm"``, ``"brake_inertia"``), ``"tolerances.<field>"``, or
        ``"effects.<effect>.<parameter>"`` of an effect that the rig has. They set the nominal value; an
        assembly's own errors come on top.
    design : {"sobol", "random"}
        How the ranges are filled: by a scrambled sequence by Sobol', one for each class, or by independent
        uniform numbers.
    seed : int
        Seed of the whole campaign.
    runs_per_shard : int
        Runs in one file; the work of at most one shard is lost when a campaign is interrupted.

    Raises
    ------
    TypeError, ValueError
        If a parameter is of the wrong type or outside its range; the message names it. Both ends of every
        explored range are tried on the rig.

    Examples
    --------
    >>> campaign = Campaign(defect_counts=(0, 3), repeats=4, parameters={"load_torque": (15, 25)})
    >>> campaign.n_runs, campaign.n_samples
    (8, 46080)
    >>> [plan.defect_count for plan in campaign.plans(0, 4)]
    [0, 3, 0, 3]
    >>> all(15 <= plan.values["load_torque"] <= 25 for plan in campaign.plans())
    True
    """

    name: str = "campaign"
    rig: Rig | str = "R1"
    defect_counts: tuple[int, ...] = tuple(range(8))
    repeats: int = 10
    lobes: str = "consecutive"
    wheels: str | tuple[int, ...] = "random"
    depth: float | tuple[float, float] = 1.0
    duration_s: float = 1.8
    sampling_rate: float = 25_600.0
    parameters: Mapping[str, Explored] = field(default_factory=dict)
    design: str = "sobol"
    seed: int = 0
    runs_per_shard: int = 128

    def __post_init__(self) -> None:
        if not isinstance(self.name, str):
            raise TypeError(f"name must be text, got {self.name!r}")
        if not self.name or not self.name.isprintable():
            raise ValueError(f"name must be a line of printable text, got {self.name!r}")
        keep = object.__setattr__
        keep(self, "rig", _rig(self.rig))
        keep(self, "defect_counts", _counts(self.defect_counts, self.the_rig.gearbox.n_lobes))
        for name, least, most in (
            ("repeats", 1, _MOST_REPEATS), ("seed", 0, None), ("runs_per_shard", 1, None),
        ):  # fmt: skip
            keep(self, name, whole(name, getattr(self, name), least, most))
        for name, known in (("lobes", _PATTERNS), ("design", _DESIGNS)):
            value = getattr(self, name)
            if not isinstance(value, str) or value not in known:
                raise ValueError(f"{name} must be one of {known}, got {value!r}")
        keep(self, "wheels", _wheels(self.wheels))
        for name, unit in (("duration_s", "s"), ("sampling_rate", "Hz")):
            value = number(name, getattr(self, name), f"a number of {unit}")
            if value <= 0:
                raise ValueError(f"{name} must be positive ({unit}), got {value!r}")
            keep(self, name, value)
        if self.n_samples < 2:
            raise ValueError(
                f"duration_s must hold at least 2 samples at {self.sampling_rate:g} Hz, "
                f"got {self.duration_s!r}"
            )
        keep(self, DEPTH, _depth(self.depth))
        keep(self, "parameters", _parameters(self.parameters, self.the_rig))

    @property
    def the_rig(self) -> Rig:
        """The rig, of which ``rig`` may have been given as the name only."""
        assert isinstance(self.rig, Rig)
        return self.rig

    @property
    def n_runs(self) -> int:
        """Number of runs."""
        return self.repeats * len(self.defect_counts)

    @property
    def n_samples(self) -> int:
        """Number of samples of each run."""
        return round(self.duration_s * self.sampling_rate)

    @property
    def n_shards(self) -> int:
        """Number of shards; the last may be shorter."""
        return math.ceil(self.n_runs / self.runs_per_shard)

    @property
    def explored(self) -> dict[str, Explored]:
        """All that is explored: ``parameters``, and ``"depth"`` where it is a range."""
        depth: dict[str, Explored] = {DEPTH: self.depth} if isinstance(self.depth, tuple) else {}
        return {**self.parameters, **depth}

    def replace(self, **changes: Any) -> Campaign:
        """A copy with single fields changed, checked anew."""
        return dataclasses.replace(self, **changes)

    def shard_size(self, shard: int) -> int:
        """Number of runs in a shard."""
        return min(self.runs_per_shard, self.n_runs - shard * self.runs_per_shard)

    def plans(self, first: int = 0, n_runs: int | None = None) -> Iterator[RunPlan]:
        """What runs are to be, in their order.

        Parameters
        ----------
        first : int
            Index of the first run.
        n_runs : int, optional
            Number of runs; default: all that are left.

        Yields
        ------
        RunPlan
            The same for the same index, wherever one begins.
        """
        end = self.n_runs if n_runs is None else min(first + n_runs, self.n_runs)
        n_classes = len(self.defect_counts)
        explored = self.explored
        # The repeats of which each class has a run here.
        repeat, last = first // n_classes, -(-end // n_classes)
        shares = {}
        if explored:
            shares = {count: self._shares(count, repeat, last - repeat) for count in self.defect_counts}
        for index in range(first, end):
            count = self.defect_counts[index % n_classes]
            values = {}
            if explored:
                own = shares[count][index // n_classes - repeat].tolist()
                pairs = zip(explored.items(), own, strict=True)
                values = {name: _between(ends, share) for (name, ends), share in pairs}
            yield RunPlan(index, count, values)

    def seed_of(self, index: int) -> np.random.SeedSequence:
        """Seed of one run, from which the simulator draws assembly, start, drift, noise and effects."""
        return np.random.SeedSequence([self.seed, *self.name.encode()], spawn_key=(index,))

    def assembly_of(self, index: int) -> str:
        """Name of the assembly of one run."""
        return f"{self.name}-{self.seed}-{index:07d}"

    def _shares(self, count: int, first: int, n: int) -> Float:
        """Place of each explored value in its range, 0 to 1, shape (n, n_explored).

        Each class has a sequence of its own: in a single one that runs through the classes, the class would
        be tied to the parameters (of eight consecutive points each lies in an eighth of its own).
        """
        key = [self.seed, *self.name.encode(), _DESIGN_KEY + count]
        if self.design == "random":
            rows = (
                np.random.default_rng(np.random.SeedSequence(key, spawn_key=(repeat,)))
                for repeat in range(first, first + n)
            )
            return np.array([row.random(len(self.explored)) for row in rows])
        # Imported late: it takes as long as everything else here together.
        from scipy.stats import qmc

        # scipy 1.15 renamed the argument; older ones know the old name only.
        random = np.random.default_rng(np.random.SeedSequence(key))
        named = {"rng" if _sobol_takes_rng(qmc.Sobol) else "seed": random}
        engine = qmc.Sobol(len(self.explored), scramble=True, **named)
        if first:
            engine.fast_forward(first)
        with warnings.catch_warnings():
            # That the balance is perfect for powers of 2 only: so it is, and no reason to warn.
            warnings.filterwarnings("ignore", "The balance properties", UserWarning)
            return np.asarray(engine.random(n), dtype=float)

    def run(
        self,
        out: str | os.PathLike[str],
        *,
        n_jobs: int = 1,
        scheduler: Any = None,
        progress: Callable[[int, int], object] | None = None,
    ) -> CampaignData:
        """Simulate what is missing in a folder, until the campaign is whole.

        Parameters
        ----------
        out : path
            Folder; made if there is none. One that holds a part of this campaign is completed.
        n_jobs : int, default 1
            Number of processes; -1 for all processors. A backend set with ``joblib.parallel_config`` is used
            instead of processes.
        scheduler : str or distributed.Client, optional
            Address of a Dask scheduler (``"tcp://host:8786"``), whose workers then simulate; ``n_jobs`` is
            not used. Nothing but this process writes to ``out``.
        progress : callable, optional
            Called after each run with the number done, those found finished included, and their total.

        Returns
        -------
        CampaignData
            As :func:`load_campaign` returns it. The same bytes on disk for any number and kind of workers,
            interrupted or not, with the same versions of all packages on processors of one kind.

        Raises
        ------
        ValueError
            If the folder holds something else: another design (the message says which key differs), one made
            with other versions, or other files. Also if not even the middle of the design can be simulated.
        OSError
            If the folder cannot be written, or the disk is full or would not suffice. All shards finished are
            kept.
        WorkerLost
            If workers or the scheduler are lost (a ConnectionError). All shards finished are kept.
        ImportError
            If pyarrow, or for a scheduler dask.distributed, is not installed.

        Notes
        -----
        A run that diverges, locks or whose parameters contradict each other is a row of NaN torque with
        ``status`` and ``reason``.

        Examples
        --------
        >>> import tempfile
        >>> campaign = Campaign(rig="R0", defect_counts=(0, 2), repeats=1, duration_s=0.1)
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     data = campaign.run(folder)
        ...     print(data.X.shape, data.X.dtype, data.y, data.ok)
        (2, 2560) float32 [0 2] [ True  True]
        """
        from cyclofeat.simulators.campaign._load import load_campaign
        from cyclofeat.simulators.campaign._store import complete
        from cyclofeat.simulators.campaign._workers import results

        whole("n_jobs", n_jobs, None, None)
        if n_jobs == 0:
            raise ValueError("n_jobs must be a whole number of processes, or -1 for all, got 0")
        complete(self, Path(out), lambda plans: results(self, plans, n_jobs, scheduler), progress)
        return load_campaign(out)

    def to_dict(self) -> dict[str, Any]:
        """The design as plain numbers, text, lists and dicts, every value explicit."""
        content: dict[str, Any] = {}
        for item in dataclasses.fields(self):
            value = getattr(self, item.name)
            content[item.name] = rig_to_dict(value) if isinstance(value, Rig) else value
        # Tuples become lists, as a file gives them back.
        plain: dict[str, Any] = json.loads(json.dumps(content, allow_nan=False))
        return plain

    def to_json(self, path: str | os.PathLike[str]) -> None:
        """Write the design to a JSON file, every value explicit.

        Parameters
        ----------
        path : path
            File to write; one that exists is replaced.
        """
        Path(path).write_bytes(json_bytes({"format": FORMAT, "note": _NOTE, **self.to_dict()}))

    @classmethod
    def from_json(
        cls, path: str | os.PathLike[str], *, preset: Callable[[str], Rig] | None = None
    ) -> Campaign:
        """Read a design from a JSON file.

        Parameters
        ----------
        path : path
            File in UTF-8: one object with the parameters of :class:`Campaign`, all of which may be left out;
            ``"rig"`` is the name of a preset or an object as in :meth:`cyclofeat.simulators.Rig.from_json`.
            The ``campaign.json`` of a campaign's folder is such a file.
        preset : callable, optional
            Makes a rig of its name; default: ``"R0"``, ``"R1"`` and ``"R2"`` only. With
            :func:`cyclofeat.datasets.rig_preset`, as the command takes it, ``"published"`` is one too.

        Returns
        -------
        Campaign
            Equal to the one that was written.

        Raises
        ------
        FileNotFoundError
            If there is no such file.
        ValueError
            If the file is not JSON, or a key or value is wrong. The message names file, key and value, and
            says what would be right.

        Examples
        --------
        >>> import pathlib, tempfile
        >>> campaign = Campaign(depth=(0.2, 1.0), parameters={"noise_nm": (0.05, 2, "log")})
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = pathlib.Path(folder) / "design.json"
        ...     campaign.to_json(path)
        ...     Campaign.from_json(path) == campaign
        True
        """
        name = os.fspath(path)
        try:
            text = Path(path).read_text(encoding="utf-8-sig")
        except FileNotFoundError:
            raise FileNotFoundError(f"{name}: no such file; Campaign.to_json writes a design") from None
        except UnicodeDecodeError as error:
            raise ValueError(f"{name}: is not text in UTF-8 (byte {error.start}); a design is JSON") from None
        try:
            return cls.from_dict(json.loads(text, object_pairs_hook=_distinct), preset=preset)
        except json.JSONDecodeError as error:
            raise ValueError(
                f"{name}: is not valid JSON: {error.msg} at line {error.lineno}, column {error.colno}; "
                'a design looks like {"name": "mine", "rig": "R2", "repeats": 100}'
            ) from None
        except RecursionError:
            raise ValueError(f"{name}: is not a design: brackets are nested too deeply") from None
        except (TypeError, ValueError) as error:
            raise ValueError(f"{name}: {error}") from None

    @classmethod
    def from_dict(cls, content: Any, *, preset: Callable[[str], Rig] | None = None) -> Campaign:
        """The design from what a JSON file holds.

        Parameters
        ----------
        content : dict
        preset : callable, optional
            As :meth:`from_json` takes it.

        Raises
        ------
        TypeError, ValueError
            As :meth:`from_json`.
        """
        if not isinstance(content, dict):
            raise TypeError(f"the file must hold a JSON object {{...}}, got {short(content)}")
        given = dict(content)
        form = given.get("format", FORMAT)
        if form != FORMAT:
            raise ValueError(f"format must be {FORMAT!r}, got {short(form)}")
        _reject_unknown(given, [*(item.name for item in dataclasses.fields(cls)), *_REMARKS], "")
        for name in _REMARKS:
            given.pop(name, None)
        rig = given.get("rig")
        if isinstance(rig, dict) or (isinstance(rig, str) and preset is not None):
            try:
                given["rig"] = preset(rig) if isinstance(rig, str) and preset else _rig_from(rig, Rig)
            except (TypeError, ValueError) as error:
                raise type(error)(f"rig: {error}") from None
        return cls(**given)


def rig_to_dict(rig: Rig) -> dict[str, Any]:
    """What a rig's own file holds, without format and note."""
    content: dict[str, Any] = json.loads(rig.to_text())
    return {key: value for key, value in content.items() if key not in ("format", "note")}


def json_bytes(content: Any) -> bytes:
    """JSON in UTF-8, to read and to edit."""
    return (json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False) + "\n").encode()


def _sobol_takes_rng(kind: Callable[..., Any]) -> bool:
    import inspect

    return "rng" in inspect.signature(kind).parameters


def _between(ends: Explored, share: float) -> float:
    low, high = ends[:2]
    if low == high:
        return low
    value = low * (high / low) ** share if len(ends) == 3 else low + (high - low) * share
    return min(max(value, low), high)  # rounding may leave the range


def _rig(rig: Any) -> Rig:
    if isinstance(rig, Rig):
        return rig
    if isinstance(rig, str) and rig.upper() in _PRESETS:
        return _PRESETS[rig.upper()]()
    raise ValueError(
        f"rig must be one of {tuple(_PRESETS)} or a Rig (cyclofeat.datasets.rig_preset makes others), "
        f"got {short(rig)}"
    )


def _counts(counts: Any, n_lobes: int) -> tuple[int, ...]:
    if isinstance(counts, str) or not isinstance(counts, Iterable):
        raise TypeError(f"defect_counts must be several whole numbers, e.g. range(8), got {counts!r}")
    found = tuple(whole("defect_counts", count, 0, n_lobes) for count in counts)
    if not found or len(set(found)) < len(found):
        raise ValueError(f"defect_counts must be distinct and from 0 to {n_lobes}, got {list(found)}")
    return found


def _wheels(wheels: Any) -> str | tuple[int, ...]:
    if isinstance(wheels, str) and wheels == "random":
        return wheels
    known = {pair: pair for pair in _WHEELS}
    try:
        return known[tuple(sorted(wheels))]
    except (TypeError, KeyError):
        raise ValueError(f"wheels must be 'random', (0,), (1,) or (0, 1), got {wheels!r}") from None


def _depth(depth: Any) -> float | tuple[float, float]:
    is_range = isinstance(depth, (tuple, list))
    ends = [number(DEPTH, end, "a number or a pair (low, high)") for end in (depth if is_range else [depth])]
    if len(ends) != 1 + is_range or not 0 < ends[0] <= ends[-1] <= 1:
        raise ValueError(
            f"depth must lie above 0 and up to 1 (the papers' chord), or be a pair (low, high), got {depth!r}"
        )
    return (ends[0], ends[1]) if is_range else ends[0]


def _parameters(given: Any, rig: Rig) -> dict[str, Explored]:
    if not isinstance(given, Mapping):
        raise TypeError(f'parameters must be a mapping like {{"load_torque": (15, 25)}}, got {short(given)}')
    found: dict[str, Explored] = {}
    for name, ends in given.items():
        if not isinstance(name, str):
            raise TypeError(f"parameters must be named by text, got {name!r}")
        if name == DEPTH:
            raise ValueError(f"parameters must not hold 'depth', got {short(ends)}: give depth={short(ends)}")
        check_name(rig, name)
        where = f"parameters[{name!r}]"
        found[name] = _explored(where, ends)
        for end in found[name][:2]:
            try:
                with_values(rig, {name: end})
            except (TypeError, ValueError) as error:
                raise type(error)(f"{where}: {error}") from None
    return found


def _explored(where: str, ends: Any) -> Explored:
    what = '(low, high) or (low, high, "log")'
    if not isinstance(ends, Sequence) or isinstance(ends, str) or len(ends) not in (2, 3):
        raise ValueError(f"{where} must be {what}, got {short(ends)}")
    low, high = (number(where, end, what) for end in ends[:2])
    if len(ends) == 3 and ends[2] != "log":
        raise ValueError(f"{where} must be {what}, got {short(ends)}")
    if low > high or (len(ends) == 3 and low <= 0):
        raise ValueError(f'{where} must be {what} with low <= high, above 0 for "log", got {short(ends)}')
    return (low, high, "log") if len(ends) == 3 else (low, high)
