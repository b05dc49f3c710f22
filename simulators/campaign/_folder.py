"""Folder of a campaign: workers that make its runs, shards of runs, their table, and the manifest."""

from __future__ import annotations

import concurrent.futures
import contextlib
import errno
import functools
import hashlib
import itertools
import os
import shutil
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import joblib
import numpy as np
from numpy.typing import DTypeLike, NDArray

from cyclofeat._base.checks import n_jobs as check_n_jobs
from cyclofeat._base.checks import repr_of
from cyclofeat._base.displays import data_frame
from cyclofeat._base.files import code_sha256, package_versions
from cyclofeat._base.progress import stopped_quietly
from cyclofeat._base.shards import ShardStore
from cyclofeat.simulators.campaign import _design
from cyclofeat.simulators.campaign._design import Campaign, RunPlan, RunResult

if TYPE_CHECKING:
    import pandas as pd

DESIGN, MANIFEST, PARAMETERS = "campaign.json", "manifest.json", "parameters.parquet"
MANIFEST_FORMAT = "cyclofeat campaign manifest 1"
_KINDS = ("npy", "parquet", "sha256")  # files of a shard, in the order of writing
# Number of shards whose rows are in memory at once when the table is written.
_SHARDS_PER_GROUP = 64
# Tasks that are submitted per thread of the workers, so that no thread waits.
_AHEAD = 4
CONNECT_S = 10.0
# Time without any worker after which a cluster counts as lost.
NO_WORKER_S = 60.0
LOOK_S = 5.0
_KEPT = "all finished shards are kept: run the same campaign again to go on"


class WorkerLost(ConnectionError):
    """Error of workers or a scheduler that died or cannot be reached; finished shards are on disk."""


def run_campaign(
    campaign: Campaign,
    out: str | os.PathLike[str],
    *,
    n_jobs: int = 1,
    scheduler: str | None = None,
    progress: Callable[[int, int], object] | None = None,
) -> CampaignData:
    """Simulate the runs that are missing in a folder, until the campaign is whole.

    Parameters
    ----------
    campaign : Campaign
        The design.
    out : path
        Folder, created if necessary. A part of this campaign in it is completed.
    n_jobs : int, default 1
        Number of processes; -1 for all processors. ``joblib.parallel_config`` sets another backend.
    scheduler : str, optional
        Address of a Dask scheduler (``"tcp://host:8786"``) instead of ``n_jobs``. Only this process writes to
        ``out``.
    progress : callable, optional
        Called for each run that is made, in their order, with the number of finished runs and their total.

    Returns
    -------
    CampaignData
        As :func:`load_campaign` returns it. The same bytes on disk for any number and kind of workers,
        interrupted or not, with the same versions of all packages on processors of one kind.

    Raises
    ------
    ValueError
        If the folder holds another design, a campaign of other versions or other files, if a worker has other
        versions, or if the medians of the design cannot be simulated.
    OSError, WorkerLost
        If the folder cannot be written, the disk is too small, or workers are lost. Finished shards are kept.
    RuntimeError
        If the design's kernel is "batch" or "auto" and batches cannot be compiled here or on a worker.

    Notes
    -----
    A run that diverges, locks or whose parameters contradict each other is a row of NaN torque with
    ``status`` and ``reason``.

    Examples
    --------
    >>> import tempfile
    >>> campaign = Campaign(rig="R0", defect_counts=(0, 2), repeats=1, duration=0.1)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     data = run_campaign(campaign, folder)
    ...     print(data.X.shape, data.X.dtype, data.y, data.ok)
    (2, 2560) float32 [0 2] [ True  True]
    """
    check_n_jobs(n_jobs)
    # In the folder every value is explicit: its files must not follow from the version that reads it.
    campaign = campaign.replace(runs_per_shard=campaign.shard_length)
    versions = made_with() | {"pyarrow": import_pyarrow()[0].__version__}
    store, folder = CampaignStore(Path(out)), Path(out)
    store.check_content(campaign, versions)
    _design.check_middle(campaign)
    folder.mkdir(parents=True, exist_ok=True)
    with store.hold_lock("campaign"):
        store.begin_work({"format": _design.FORMAT, "made_with": versions, **campaign.to_dict()})
        digests = {shard: store.shard_digests(shard) for shard in range(campaign.n_shards)}
        missing = [shard for shard, names in digests.items() if not names]
        done = campaign.n_runs - sum(_design.shard_size(campaign, shard) for shard in missing)
        report = progress or (lambda done, total: None)
        if done:
            report(done, campaign.n_runs)
        if not missing and store.is_finished():
            return load_campaign(out)
        needed = (campaign.n_runs - done) * campaign.n_samples * 4
        free = shutil.disk_usage(folder).free
        if needed > free:
            raise OSError(
                errno.ENOSPC,
                f"{folder}: the {len(missing)} shards to be made take {needed / 1e6:.4g} MB, the disk has "
                f"{free / 1e6:.4g} MB left: make room, or take a folder elsewhere",
            )

        def count_runs(runs: Iterable[RunResult]) -> Iterator[RunResult]:
            for number, run in enumerate(runs, done + 1):
                report(number, campaign.n_runs)
                yield run

        length = campaign.shard_length
        plans = (plan for shard in missing for plan in campaign.plans(shard * length, length))
        try:
            with contextlib.closing(simulate_anywhere(campaign, plans, n_jobs, scheduler)) as runs:
                counted = count_runs(runs)
                for shard in missing:
                    digests[shard] = store.write_shard(campaign, shard, counted)
            store.write_manifest(campaign, digests, versions)
        except OSError as error:
            if error.errno not in (errno.ENOSPC, errno.EDQUOT):
                raise
            finished = sum(map(bool, digests.values()))
            raise OSError(
                error.errno,
                f"{folder}: the disk is full; {finished} of {len(digests)} shards are finished and kept: "
                "make room and run the same campaign again to go on",
            ) from error
    return load_campaign(out)


class Shards:
    """Rows of several ``.npy`` files of float32 as one two-dimensional array, read on demand.

    A single row is memory-mapped; other selections and ``numpy.asarray`` copy. ``sizes`` are the numbers of
    rows in the files.
    """

    dtype = np.dtype(np.float32)
    ndim = 2

    def __init__(self, paths: Sequence[str | os.PathLike[str]], sizes: Sequence[int], n_samples: int) -> None:
        self.paths = tuple(Path(path) for path in paths)
        self._ends = np.cumsum(sizes)
        self._starts = self._ends - sizes
        self.shape = (int(self._ends[-1]), int(n_samples))

    def __repr__(self) -> str:
        return f"<Shards of shape {self.shape}, {self.dtype}, in {len(self.paths)} files>"

    def __len__(self) -> int:
        return self.shape[0]

    def __iter__(self) -> Iterator[NDArray[np.float32]]:
        for shard in range(len(self.paths)):
            yield from self._map_shard(shard)

    def __getitem__(self, key: Any) -> Any:
        rows, *rest = key if isinstance(key, tuple) else (key,)
        if len(rest) > 1 or rows is None or rows is Ellipsis:
            raise IndexError(f"Shards take rows, or rows and samples, got {key!r}")
        taken = np.arange(len(self))[rows]  # numpy's rules for numbers, slices, masks and lists
        if taken.ndim > 1:
            raise IndexError(f"Shards take one or a list of rows, got shape {taken.shape}")
        samples = rest[0] if rest else slice(None)
        shards = np.searchsorted(self._ends, taken, side="right")
        inside = taken - self._starts[shards]
        if taken.ndim == 0:
            return self._map_shard(int(shards))[inside][samples]
        # Samples are taken apart: beside a list of rows, numpy would pair a list of them.
        copy = np.empty((len(taken), *np.empty(self.shape[1])[samples].shape), dtype=self.dtype)
        for shard in np.unique(shards).tolist():
            chosen = shards == shard
            copy[chosen] = self._map_shard(shard)[:, samples][inside[chosen]]
        return copy

    def __array__(self, dtype: DTypeLike | None = None, copy: bool | None = None) -> NDArray[Any]:
        if copy is False:
            raise ValueError("Shards lie in several files: an array of them is always a copy")
        return np.asarray(self[:], dtype=dtype)

    def _map_shard(self, shard: int) -> Any:
        return np.load(self.paths[shard], mmap_mode="r", allow_pickle=False)


@dataclass(frozen=True)
class CampaignData:
    """A finished campaign; its torque is a surrogate for measured torque.

    ``X[ok], y[ok], groups[ok]`` hold no NaN.
    """

    #: Output torque in Nm, float32, shape (n_runs, n_samples): memmap or Shards; NaN in rows of failed runs.
    X: Any = field(repr=False)
    y: NDArray[np.int64] = field(repr=False)  #: number of worn lobes of each run
    groups: NDArray[np.str_] = field(repr=False)  #: assembly of each run
    ok: NDArray[np.bool_] = field(repr=False)  #: runs that reached their end
    #: One value per run: labels (``worn_lobes_from_1``, ``wheels_from_1``, ``depth``), ``status``,
    #: ``reason``, true values (``true_speed_rpm``, ...), those of effects (``effects.<effect>.<parameter>``).
    parameters: dict[str, NDArray[Any]] = field(repr=False)
    sampling_rate: float  #: in Hz
    campaign: Campaign  #: the design
    manifest: dict[str, Any] = field(repr=False)  #: content of ``manifest.json``

    def to_frame(self) -> pd.DataFrame:
        """Return ``parameters`` as a data frame of pandas, one row per run."""
        return data_frame(self.parameters)


def load_campaign(path: str | os.PathLike[str], *, verify: bool = False) -> CampaignData:
    """Open a finished campaign; torque stays on disk until it is used.

    Parameters
    ----------
    path : path
        Folder of the campaign.
    verify : bool
        Compare every file with its SHA-256 in the manifest, not only its size.

    Returns
    -------
    CampaignData
        ``X`` of shape (n_runs, n_samples), ``y``, ``groups`` and ``ok`` of shape (n_runs,), ``parameters``.

    Raises
    ------
    FileNotFoundError, ValueError
        If there is no finished campaign, or a file of it is missing or was changed; the message names it.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     _ = run_campaign(Campaign(rig="R0", defect_counts=(0, 2), repeats=1, duration=0.1), folder)
    ...     data = load_campaign(folder, verify=True)
    ...     data.y.tolist(), data.groups.tolist()
    ([0, 2], ['campaign-0-0000000', 'campaign-0-0000001'])
    """
    folder = Path(path)
    if not (folder / DESIGN).is_file():
        raise FileNotFoundError(f"{folder}: holds no campaign (no {DESIGN})")
    _, tables = import_pyarrow()
    store = CampaignStore(folder)
    campaign, _ = store.read_design()
    if not (folder / MANIFEST).is_file():
        n = campaign.n_shards
        done = n - len(store.missing_names(shard_file(shard, "sha256") for shard in range(n)))
        raise ValueError(f"{folder}: is not finished, {done} of {n} shards are there: run it again to go on")
    manifest = store.read_manifest()
    mend = "run the campaign again to mend it"
    for name, stated in manifest["files"].items():
        file = folder / name
        if not file.is_file():
            raise FileNotFoundError(f"{file}: is missing; {mend}")
        if (size := file.stat().st_size) != stated["bytes"]:
            raise ValueError(f"{file}: was changed, {size} bytes instead of {stated['bytes']}; {mend}")
        if verify and file_sha256(file) != stated["sha256"]:
            raise ValueError(f"{file}: was changed, its SHA-256 is not the manifest's; {mend}")
    table = tables.read_table(folder / PARAMETERS)
    parameters = {name: table.column(name).to_numpy() for name in table.column_names}
    paths = [folder / shard_file(shard, "npy") for shard in range(campaign.n_shards)]
    sizes = [_design.shard_size(campaign, shard) for shard in range(campaign.n_shards)]
    shards = Shards(paths, sizes, campaign.n_samples)
    return CampaignData(
        X=shards if len(paths) > 1 else np.load(paths[0], mmap_mode="r", allow_pickle=False),
        y=parameters["defect_count"].astype(np.int64),
        groups=parameters["assembly"].astype(np.str_), ok=parameters["status"] == _design.OK,
        parameters=parameters, sampling_rate=campaign.sampling_rate, campaign=campaign, manifest=manifest,
    )  # fmt: skip


def shard_file(shard: int, kind: str) -> str:
    """Return the name of a file of a shard.

    ``"npy"`` holds the torque, ``"parquet"`` the rows, and ``"sha256"`` the digests of both, for sha256sum;
    the last one finishes the shard.
    """
    return f"shard-{shard:05d}.{kind}"


def import_pyarrow() -> tuple[Any, Any]:
    """Import ``pyarrow`` and ``pyarrow.parquet``."""
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        raise ImportError("campaigns need pyarrow for their tables: pip install pyarrow") from None
    return pyarrow, pyarrow.parquet


def _find_differences(stored: Any, given: Any, key: str = "") -> Iterator[str]:
    """Yield the keys at which two designs differ, with both values."""
    if isinstance(stored, dict) and isinstance(given, dict):
        for name in stored | given:
            path = f"{key}.{name}" if key else name
            yield from _find_differences(stored.get(name), given.get(name), path)
    elif stored != given:
        yield f"{key} is {repr_of(stored)} there and {repr_of(given)} here"


def file_sha256(path: Path) -> str:
    """Return the SHA-256 of a file, in hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


class CampaignStore(ShardStore):
    """Folder of a campaign: the design, shards of torque, rows and digests, the table, and the manifest."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder, DESIGN)

    def read_design(self) -> tuple[Campaign, dict[str, str]]:
        """Return the design, and the versions that the campaign was begun with."""
        content = self.read_json(DESIGN)
        try:
            return Campaign.from_dict(content), content.get("made_with", {})
        except (TypeError, ValueError) as error:
            raise ValueError(f"{self.path_of(DESIGN)}: {error}") from None

    def read_manifest(self) -> dict[str, Any]:
        """Return the content of the manifest."""
        content = self.read_json(MANIFEST)
        if content.get("format") != MANIFEST_FORMAT or not isinstance(content.get("files"), dict):
            raise ValueError(f"{self.path_of(MANIFEST)}: is not of format {MANIFEST_FORMAT!r}")
        return content

    def check_content(self, campaign: Campaign, versions: dict[str, str]) -> None:
        """Raise an error unless the folder is empty or holds a part of this campaign."""
        folder = self.folder
        if not folder.exists():
            return
        if not folder.is_dir():
            raise NotADirectoryError(f"{folder}: is not a folder; a campaign needs one of its own")
        if not self.path_of(DESIGN).exists():
            others = sorted(p.name for p in folder.iterdir() if not p.match(f".{DESIGN}.*.part"))
            if others:
                raise ValueError(f"{folder}: must be empty or hold a campaign, got {others[0]!r}")
            return
        stored, begun_with = self.read_design()
        for difference in _find_differences(stored.to_dict(), campaign.to_dict()):
            raise ValueError(f"{folder}: holds a campaign of another design: {difference}; take another")
        for difference in _find_differences(begun_with, versions):
            raise ValueError(f"{folder}: was begun with other versions: {difference}; finish it with those")

    def shard_digests(self, shard: int) -> dict[str, str]:
        """Return the digests of a shard's files if all exist and are unchanged; else nothing."""
        names = [shard_file(shard, kind) for kind in _KINDS]
        if self.missing_names(names):
            return {}
        digests = {name: file_sha256(self.path_of(name)) for name in names}
        of_both = {name: digests[name] for name in names[:2]}
        return digests if self.path_of(names[2]).read_bytes() == _digest_lines(of_both) else {}

    def is_finished(self) -> bool:
        """Return True if the manifest exists and agrees with the design and the table."""
        try:
            stated = self.read_manifest()["files"]
            return all(
                stated[name]["sha256"] == file_sha256(self.path_of(name)) for name in (DESIGN, PARAMETERS)
            )
        except (FileNotFoundError, KeyError, TypeError, ValueError):
            return False

    def write_shard(self, campaign: Campaign, shard: int, results: Iterator[RunResult]) -> dict[str, str]:
        """Write torque, rows, and last their digests, which finish the shard."""
        size = _design.shard_size(campaign, shard)
        block = np.full((size, campaign.n_samples), np.nan, dtype=np.float32)
        rows = []
        for position in range(size):
            torque, row = next(results)
            if torque is not None:
                block[position] = torque
            rows.append(row)
        pyarrow, tables = import_pyarrow()
        table = pyarrow.Table.from_pylist(rows, schema=_table_schema(campaign))

        def write_torque(file: IO[bytes]) -> None:
            # Not write_array: for a full disk it raises an error without a number.
            np.lib.format.write_array_header_1_0(file, np.lib.format.header_data_from_array_1_0(block))
            file.write(block.data)

        names = [shard_file(shard, kind) for kind in _KINDS]
        self.write_file(names[0], write_torque)
        self.write_file(names[1], lambda file: tables.write_table(table, file))
        digests = {name: file_sha256(self.path_of(name)) for name in names[:2]}
        self.write_file(names[2], lambda file: file.write(_digest_lines(digests)))
        return digests | {names[2]: file_sha256(self.path_of(names[2]))}

    def write_manifest(
        self, campaign: Campaign, digests: Mapping[int, Mapping[str, str]], versions: dict[str, str]
    ) -> None:
        """Write the table of all rows, then the manifest, which finishes the campaign."""
        pyarrow, tables = import_pyarrow()

        def write(file: IO[bytes]) -> None:
            with tables.ParquetWriter(file, _table_schema(campaign)) as writer:
                for first in range(0, campaign.n_shards, _SHARDS_PER_GROUP):
                    group = range(first, min(first + _SHARDS_PER_GROUP, campaign.n_shards))
                    parts = [tables.read_table(self.path_of(shard_file(shard, "parquet"))) for shard in group]
                    writer.write_table(pyarrow.concat_tables(parts).combine_chunks())

        self.write_file(PARAMETERS, write)
        status = tables.read_table(self.path_of(PARAMETERS), columns=["status"]).column("status")
        counts = {item["values"]: item["counts"] for item in status.value_counts().to_pylist()}
        files = {name: file_sha256(self.path_of(name)) for name in (DESIGN, PARAMETERS)}
        for shard in range(campaign.n_shards):
            files |= digests[shard]
        manifest = {
            "format": MANIFEST_FORMAT,
            "made_with": versions,
            "source": "surrogate",
            "n_runs": campaign.n_runs,
            "n_samples": campaign.n_samples,
            "sampling_rate": campaign.sampling_rate,
            "status": dict(sorted(counts.items())),
            "design": campaign.to_dict(),
            "files": {
                name: {"sha256": sha256, "bytes": (self.path_of(name)).stat().st_size}
                for name, sha256 in files.items()
            },
        }
        self.write_json(MANIFEST, manifest)


def _digest_lines(digests: Mapping[str, str]) -> bytes:
    """Return digests by name as ``sha256sum`` writes them."""
    return "".join(f"{sha256}  {name}\n" for name, sha256 in digests.items()).encode()


def _table_schema(campaign: Campaign) -> Any:
    pyarrow, _ = import_pyarrow()
    types = {int: pyarrow.int64(), float: pyarrow.float64(), str: pyarrow.string()}
    types[list] = pyarrow.list_(types[int])
    return pyarrow.schema([(name, types[kind]) for name, kind in _design.table_columns(campaign).items()])


@functools.lru_cache(maxsize=1)
def made_with() -> dict[str, str]:
    """Return the versions and the digest of the sources on which the bytes of a result depend."""
    room = Path(__file__).parents[1]
    packages = package_versions("cyclofeat", "numpy", "scipy", "numba")
    return packages | {"simulators_sha256": code_sha256(room, sorted(room.rglob("*.py")))}


def simulate_task(campaign: Campaign, plans: Sequence[RunPlan], expected: dict[str, str]) -> list[RunResult]:
    """Simulate runs on a worker, which must have the ``expected`` versions and the campaign's kernel."""
    here = made_with()
    for name, version in expected.items():
        if (found := here.get(name)) != version:
            raise ValueError(f"a worker has {name} {found}, the campaign {version}: install the same")
    _design.check_kernel(campaign)
    return _design.simulate_runs(campaign, plans)


def simulate_anywhere(
    campaign: Campaign, plans: Iterable[RunPlan], n_jobs: int = 1, scheduler: str | None = None
) -> Generator[RunResult, None, None]:
    """Yield results of runs in the order of their plans; simulate only a few more than are consumed."""
    size, queue, expected = 1, iter(plans), made_with()
    if campaign.kernel != "exact":
        from cyclofeat.simulators.batch import runs

        size = runs.n_lanes()
    # A task is one batch, or one run of the exact kernel.
    tasks = iter(lambda: list(itertools.islice(queue, size)), [])
    if scheduler is not None:
        yield from simulate_on_cluster(campaign, tasks, expected, scheduler)
        return
    workers = joblib.Parallel(n_jobs=n_jobs, prefer="processes", return_as="generator")
    made = workers(joblib.delayed(simulate_task)(campaign, task, expected) for task in tasks)
    try:
        with stopped_quietly(made):
            yield from itertools.chain.from_iterable(made)
    except concurrent.futures.BrokenExecutor as error:
        raise WorkerLost(f"a worker process died ({type(error).__name__}); {_KEPT}") from error


def simulate_on_cluster(
    campaign: Campaign, tasks: Iterator[list[RunPlan]], expected: dict[str, str], scheduler: str
) -> Generator[RunResult, None, None]:
    """Yield the results of tasks, as :func:`simulate_anywhere`, from a Dask scheduler's workers."""
    try:
        from distributed import CancelledError, Client, KilledWorker
        from distributed.comm.core import CommClosedError
    except ImportError:
        raise ImportError("a scheduler needs dask.distributed: pip install distributed") from None
    waiting: deque[Any] = deque()
    try:
        client: Any = Client(scheduler, timeout=CONNECT_S, set_as_default=False)  # type: ignore[no-untyped-call]
    except (OSError, ValueError) as error:
        raise WorkerLost(
            f"no Dask scheduler answers at {scheduler!r} ({' '.join(str(error).split())}): give the address "
            "that 'dask scheduler' prints, like tcp://host:8786"
        ) from None
    with client:
        try:
            ahead = _AHEAD * _count_threads(client)
            while True:
                while len(waiting) < ahead and (task := next(tasks, None)):
                    # Not pure: Dask must not reuse a result of an earlier campaign.
                    waiting.append(client.submit(simulate_task, campaign, task, expected, pure=False))
                if not waiting:
                    return
                results = None
                while results is None:  # the scheduler repeats a task whose worker died on another
                    try:
                        results = waiting[0].result(timeout=LOOK_S)
                    except TimeoutError:
                        _count_threads(client)
                yield from results
                waiting.popleft()
        except (KilledWorker, CancelledError, CommClosedError) as error:
            raise WorkerLost(f"the cluster lost workers ({type(error).__name__}); {_KEPT}") from error
        finally:
            with contextlib.suppress(Exception):  # the scheduler may be gone
                client.cancel(list(waiting), force=True)


def _count_threads(client: Any) -> int:
    """Count the threads of all workers; wait some time for the first of them."""
    if not client.nthreads():
        try:
            client.wait_for_workers(1, timeout=NO_WORKER_S)
        except TimeoutError:
            raise WorkerLost(f"the cluster has had no worker for {NO_WORKER_S:g} s; {_KEPT}") from None
    return sum(client.nthreads().values()) or 1
