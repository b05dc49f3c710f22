"""Folder of a campaign: files that appear complete or not at all, and the missing ones."""

from __future__ import annotations

import contextlib
import errno
import hashlib
import itertools
import json
import os
import shutil
import sys
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping
from pathlib import Path
from typing import IO, Any

import numpy as np

from cyclofeat._base.checks import short
from cyclofeat._base.files import write_whole
from cyclofeat.simulators.campaign._design import FORMAT, Campaign, RunPlan, json_bytes
from cyclofeat.simulators.campaign._run import (
    INTEGER,
    INTEGERS,
    NUMBER,
    TEXT,
    RunResult,
    check_middle,
    columns,
    made_with,
)

DESIGN, MANIFEST, PARAMETERS = "campaign.json", "manifest.json", "parameters.parquet"
MANIFEST_FORMAT = "cyclofeat campaign manifest 1"
_KINDS = ("npy", "parquet", "sha256")  # files of a shard, in the order of writing
# Number of shards whose rows are in memory at once when the table is written, or that are planned at once.
_SHARDS_PER_GROUP = 64


def shard_file(shard: int, kind: str) -> str:
    """Return the name of a file of a shard.

    ``"npy"`` holds the torque, ``"parquet"`` the rows, and ``"sha256"`` the digests of both, for sha256sum;
    the last one finishes the shard.
    """
    return f"shard-{shard:05d}.{kind}"


def parquet() -> tuple[Any, Any]:
    """Import ``pyarrow`` and ``pyarrow.parquet``."""
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        raise ImportError("campaigns need pyarrow for their tables: pip install pyarrow") from None
    return pyarrow, pyarrow.parquet


def complete(
    campaign: Campaign,
    folder: Path,
    results: Callable[[Iterable[RunPlan]], Generator[RunResult, None, None]],
    progress: Callable[[int, int], object] | None = None,
) -> None:
    """Simulate and write the missing runs of a campaign in a folder.

    ``results`` takes plans and yields their results in the same order. Raises as :func:`run_campaign`.
    """
    parquet()
    if folder.exists() and not folder.is_dir():
        raise NotADirectoryError(f"{folder}: is not a folder; a campaign needs one of its own")
    _check_folder(campaign, folder)
    check_middle(campaign)
    folder.mkdir(parents=True, exist_ok=True)
    with _locked(folder):
        for part in folder.glob(".*.part"):
            part.unlink()
        if not (folder / DESIGN).exists():
            content = {"format": FORMAT, "made_with": _versions(), **campaign.to_dict()}
            write_whole(folder / DESIGN, lambda file: file.write(json_bytes(content)), durable=True)
        digests = {shard: _digests_if_whole(folder, shard) for shard in range(campaign.n_shards)}
        missing = [shard for shard, names in digests.items() if not names]
        done = campaign.n_runs - sum(map(campaign.shard_size, missing))
        if progress is not None and done:
            progress(done, campaign.n_runs)
        if not missing and _is_finished(folder):
            return
        _check_space(campaign, folder, missing)
        plans = itertools.chain.from_iterable(campaign.plans(*runs) for runs in _stretches(campaign, missing))
        with contextlib.closing(results(plans)) as made:
            counted = _counted(made, done, campaign.n_runs, progress)
            for shard in missing:
                with _full_disk_explained(folder, digests):
                    digests[shard] = _make_shard(campaign, folder, shard, counted)
        with _full_disk_explained(folder, digests):
            _finish(campaign, folder, digests)


def _stretches(campaign: Campaign, shards: list[int]) -> Iterator[tuple[int, int]]:
    """Yield first run and number of runs of neighbouring shards: to plan many at once costs little more."""
    numbered = enumerate(shards)
    for _, group in itertools.groupby(numbered, lambda one: (one[1] - one[0], one[0] // _SHARDS_PER_GROUP)):
        together = [shard for _, shard in group]
        yield together[0] * campaign.shard_length, sum(map(campaign.shard_size, together))


def _differences(stored: Any, given: Any, key: str = "") -> Iterator[str]:
    """Yield the keys at which two designs differ, with both values."""
    if isinstance(stored, dict) and isinstance(given, dict):
        for name in stored | given:
            path = f"{key}.{name}" if key else name
            yield from _differences(stored.get(name), given.get(name), path)
    elif stored != given:
        yield f"{key} is {short(stored)} there and {short(given)} here"


def digest(path: Path) -> str:
    """Return the SHA-256 of a file, in hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def read_design(folder: Path) -> tuple[Campaign, dict[str, str]]:
    """Read ``campaign.json`` of a folder: the design, and the versions that it was begun with."""
    content = _read_json(folder / DESIGN)
    try:
        return Campaign.from_dict(content), content.get("made_with", {})
    except (TypeError, ValueError) as error:
        raise ValueError(f"{folder / DESIGN}: {error}") from None


def read_manifest(folder: Path) -> dict[str, Any]:
    """Read ``manifest.json`` of a folder."""
    content = _read_json(folder / MANIFEST)
    if content.get("format") != MANIFEST_FORMAT or not isinstance(content.get("files"), dict):
        raise ValueError(f"{folder / MANIFEST}: is not a campaign's manifest of format {MANIFEST_FORMAT!r}")
    return content


def _read_json(path: Path) -> dict[str, Any]:
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise ValueError(f"{path}: is not valid JSON ({error}): the file was changed") from None
    if not isinstance(content, dict):
        raise ValueError(f"{path}: must hold a JSON object: the file was changed")
    return content


def _check_folder(campaign: Campaign, folder: Path) -> None:
    """Raise ValueError unless the folder is empty or holds a part of this campaign."""
    if not folder.exists():
        return
    if not (folder / DESIGN).exists():
        others = sorted(p.name for p in folder.iterdir() if not p.match(f".{DESIGN}.*.part"))
        if others:
            raise ValueError(
                f"{folder}: must be empty or hold a campaign, got {others[0]!r} and no {DESIGN}: take "
                "another folder"
            )
        return
    stored, versions = read_design(folder)
    for difference in _differences(stored.to_dict(), campaign.to_dict()):
        raise ValueError(
            f"{folder}: holds a campaign of another design: {difference}; take another folder, or the design "
            f"in {DESIGN}"
        )
    for difference in _differences(versions, _versions()):
        raise ValueError(
            f"{folder}: was begun with other versions: {difference}; finish it with those, or take another "
            "folder"
        )


def _versions() -> dict[str, str]:
    """Return the versions on which the bytes of the files depend; pyarrow writes the tables."""
    pyarrow, _ = parquet()
    return {**made_with(), "pyarrow": pyarrow.__version__}


def _check_space(campaign: Campaign, folder: Path, missing: list[int]) -> None:
    needed = sum(map(campaign.shard_size, missing)) * campaign.n_samples * 4
    free = shutil.disk_usage(folder).free
    if needed > free:
        raise OSError(
            errno.ENOSPC,
            f"{folder}: the {len(missing)} shards to be made take {_bytes(needed)}, the disk has "
            f"{_bytes(free)} left: make room, or take a folder elsewhere",
        )


@contextlib.contextmanager
def _full_disk_explained(folder: Path, digests: Mapping[int, Mapping[str, str]]) -> Iterator[None]:
    """Add to the error of a full disk how much is finished."""
    try:
        yield
    except OSError as error:
        if error.errno not in (errno.ENOSPC, errno.EDQUOT):
            raise
        finished = sum(map(bool, digests.values()))
        raise OSError(
            error.errno,
            f"{folder}: the disk is full; {finished} of {len(digests)} shards are finished and kept: make "
            "room and run the same campaign again to go on",
        ) from error


@contextlib.contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Lock the folder for this process; the lock ends with the process."""
    try:
        held = _lock(folder)
    except (BlockingIOError, FileExistsError):
        raise BlockingIOError(
            errno.EWOULDBLOCK, f"{folder}: another process is at work on this campaign: wait for its end"
        ) from None
    try:
        yield
    finally:
        os.close(held)


def _lock(folder: Path) -> int:
    """Return a descriptor that locks the folder until it is closed."""
    if sys.platform == "win32":  # folders cannot be opened; the system removes the file with its process
        return os.open(folder / ".lock", os.O_CREAT | os.O_EXCL | os.O_TEMPORARY)
    import fcntl

    held = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(held)
        raise
    except OSError:
        pass  # a file system without locks
    return held


def _counted(
    results: Iterator[RunResult], done: int, total: int, progress: Callable[[int, int], object] | None
) -> Iterator[RunResult]:
    for number, result in enumerate(results, done + 1):
        if progress is not None:
            progress(number, total)
        yield result


def _make_shard(campaign: Campaign, folder: Path, shard: int, results: Iterator[RunResult]) -> dict[str, str]:
    """Write torque, rows, and last their digests, which finish the shard."""
    size = campaign.shard_size(shard)
    block = np.full((size, campaign.n_samples), np.nan, dtype=np.float32)
    rows = []
    for position in range(size):
        torque, row = next(results)
        if torque is not None:
            block[position] = torque
        rows.append(row)
    pyarrow, tables = parquet()
    table = pyarrow.Table.from_pylist(rows, schema=_schema(campaign))

    def write_torque(file: IO[bytes]) -> None:
        # Not write_array: for a full disk it raises an error without a number.
        np.lib.format.write_array_header_1_0(file, np.lib.format.header_data_from_array_1_0(block))
        file.write(block.data)

    names = [shard_file(shard, kind) for kind in _KINDS]
    write_whole(folder / names[0], write_torque, durable=True)
    write_whole(folder / names[1], lambda file: tables.write_table(table, file), durable=True)
    digests = {name: digest(folder / name) for name in names[:2]}
    write_whole(folder / names[2], lambda file: file.write(_lines(digests)), durable=True)
    return digests | {names[2]: digest(folder / names[2])}


def _lines(digests: Mapping[str, str]) -> bytes:
    """Return digests by name as ``sha256sum`` writes them."""
    return "".join(f"{sha256}  {name}\n" for name, sha256 in digests.items()).encode()


def _schema(campaign: Campaign) -> Any:
    pyarrow, _ = parquet()
    kinds = {
        INTEGER: pyarrow.int64(),
        NUMBER: pyarrow.float64(),
        TEXT: pyarrow.string(),
        INTEGERS: pyarrow.list_(pyarrow.int64()),
    }
    return pyarrow.schema([(name, kinds[kind]) for name, kind in columns(campaign).items()])


def _is_finished(folder: Path) -> bool:
    """Return True if the manifest exists and agrees with the design and the table."""
    try:
        stated = read_manifest(folder)["files"]
        return all(stated[name]["sha256"] == digest(folder / name) for name in (DESIGN, PARAMETERS))
    except (FileNotFoundError, KeyError, TypeError, ValueError):
        return False


def _digests_if_whole(folder: Path, shard: int) -> dict[str, str]:
    """Return the digests of a shard's files if all exist and are unchanged; else nothing."""
    names = [shard_file(shard, kind) for kind in _KINDS]
    if not all((folder / name).is_file() for name in names):
        return {}
    digests = {name: digest(folder / name) for name in names}
    of_both = {name: digests[name] for name in names[:2]}
    return digests if (folder / names[2]).read_bytes() == _lines(of_both) else {}


def _finish(campaign: Campaign, folder: Path, digests: Mapping[int, Mapping[str, str]]) -> None:
    """Write the table of all rows, then the manifest, which finishes the campaign."""
    pyarrow, tables = parquet()

    def write(file: IO[bytes]) -> None:
        with tables.ParquetWriter(file, _schema(campaign)) as writer:
            for first in range(0, campaign.n_shards, _SHARDS_PER_GROUP):
                group = range(first, min(first + _SHARDS_PER_GROUP, campaign.n_shards))
                parts = [tables.read_table(folder / shard_file(shard, "parquet")) for shard in group]
                writer.write_table(pyarrow.concat_tables(parts).combine_chunks())

    write_whole(folder / PARAMETERS, write, durable=True)
    status = tables.read_table(folder / PARAMETERS, columns=["status"]).column("status")
    counts = {item["values"]: item["counts"] for item in status.value_counts().to_pylist()}
    files = {name: digest(folder / name) for name in (DESIGN, PARAMETERS)}
    for shard in range(campaign.n_shards):
        files |= digests[shard]
    manifest = {
        "format": MANIFEST_FORMAT,
        "made_with": _versions(),
        "source": "surrogate",
        "n_runs": campaign.n_runs,
        "n_samples": campaign.n_samples,
        "sampling_rate": campaign.sampling_rate,
        "status": dict(sorted(counts.items())),
        "design": campaign.to_dict(),
        "files": {
            name: {"sha256": sha256, "bytes": (folder / name).stat().st_size}
            for name, sha256 in files.items()
        },
    }
    write_whole(folder / MANIFEST, lambda file: file.write(json_bytes(manifest)), durable=True)


def _bytes(number: float) -> str:
    for unit in ("bytes", "kB", "MB", "GB"):
        if number < 1000:
            return f"{number:.3g} {unit}"
        number /= 1000
    return f"{number:.4g} TB"
