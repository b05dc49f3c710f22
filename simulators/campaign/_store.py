"""A campaign's folder: files that appear whole or not at all, and what is missing among them."""

from __future__ import annotations

import contextlib
import errno
import hashlib
import io
import json
import os
import shutil
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping
from pathlib import Path
from typing import IO, Any

import numpy as np

from cyclofeat.simulators._checks import short
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
# Shards whose rows are in memory at once when the table is written.
_SHARDS_PER_GROUP = 64
_FULL = (errno.ENOSPC, errno.EDQUOT)


def shard_name(shard: int) -> str:
    """File of a shard's torque."""
    return f"shard-{shard:05d}.npy"


def rows_name(shard: int) -> str:
    """File of a shard's rows."""
    return f"shard-{shard:05d}.parquet"


def digests_name(shard: int) -> str:
    """File that comes last and makes a shard finished: digests of the other two, as sha256sum takes them."""
    return f"shard-{shard:05d}.sha256"


def parquet() -> tuple[Any, Any]:
    """``pyarrow`` and ``pyarrow.parquet``."""
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        raise ImportError("campaigns need pyarrow for their tables: pip install 'cyclofeat[io]'") from None
    return pyarrow, pyarrow.parquet


def complete(
    campaign: Campaign,
    folder: Path,
    results: Callable[[Iterable[RunPlan]], Generator[RunResult, None, None]],
    progress: Callable[[int, int], object] | None = None,
) -> None:
    """Make what is missing of a campaign in a folder.

    Parameters
    ----------
    campaign : Campaign
    folder : pathlib.Path
        Made if there is none.
    results : callable
        Takes plans and yields their results in the same order.
    progress : callable, optional
        Called with the number of runs done and their total.

    Raises
    ------
    ValueError, OSError
        As :meth:`Campaign.run`.
    """
    parquet()
    if folder.exists() and not folder.is_dir():
        raise NotADirectoryError(f"{folder}: is not a folder; a campaign needs one of its own")
    _check_folder(campaign, folder)
    check_middle(campaign)
    folder.mkdir(parents=True, exist_ok=True)
    with _alone_in(folder):
        for left in folder.glob(".*.part"):
            left.unlink()
        if not (folder / DESIGN).exists():
            content = {"format": FORMAT, "made_with": _versions(), **campaign.to_dict()}
            write_whole(folder / DESIGN, lambda file: file.write(json_bytes(content)))
        digests = {shard: _digests_if_whole(folder, shard) for shard in range(campaign.n_shards)}
        missing = [shard for shard, found in digests.items() if not found]
        stated = _stated(folder)
        if (
            stated
            and not missing
            and all(_is_as_stated(folder, name, stated) for name in (DESIGN, PARAMETERS))
        ):
            if progress is not None:
                progress(campaign.n_runs, campaign.n_runs)
            return
        _check_space(campaign, folder, missing)
        done = campaign.n_runs - sum(map(campaign.shard_size, missing))
        if progress is not None and done:
            progress(done, campaign.n_runs)
        made = results(plan for shard in missing for plan in _plans(campaign, shard))
        with contextlib.closing(made):
            for shard in missing:
                with _explained(folder, campaign.n_shards, digests):
                    digests[shard] = _make_shard(
                        campaign, folder, shard, _counted(made, campaign, done, progress)
                    )
                    done += campaign.shard_size(shard)
        with _explained(folder, campaign.n_shards, digests):
            _finish(campaign, folder, digests)


def differences(there: Any, here: Any, key: str = "") -> Iterator[str]:
    """Keys at which two designs differ, with both values."""
    if isinstance(there, dict) and isinstance(here, dict):
        for name in [*there, *(name for name in here if name not in there)]:
            path = f"{key}.{name}" if key else name
            yield from differences(there.get(name), here.get(name), path)
    elif there != here:
        yield f"{key} is {short(there)} there and {short(here)} here"


def write_whole(path: Path, write: Callable[[IO[bytes]], object]) -> None:
    """Write a file that is there as a whole or not at all, whatever happens, power cuts included.

    Written to a file beside it, which goes to the disk and only then gets its name. One writer at a time.
    """
    part = path.with_name(f".{path.name}.part")
    try:
        with part.open("wb") as file:
            write(file)
            file.flush()
            os.fsync(file.fileno())
        part.replace(path)
    except BaseException:
        with contextlib.suppress(OSError):
            part.unlink(missing_ok=True)
        raise
    _sync_folder(path.parent)


def digest(path: Path) -> str:
    """SHA-256 of a file, in hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def read_design(folder: Path) -> dict[str, Any]:
    """What ``campaign.json`` of a folder holds."""
    return _read_json(folder / DESIGN)


def read_manifest(folder: Path) -> dict[str, Any]:
    """What ``manifest.json`` of a folder holds."""
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
    """Whether the folder is empty or holds a part of this very campaign."""
    if not folder.exists():
        return
    if not (folder / DESIGN).exists():
        others = sorted(p.name for p in folder.iterdir() if p.name != f".{DESIGN}.part")
        if others:
            raise ValueError(
                f"{folder}: must be empty or hold a campaign, got {others[0]!r} and no {DESIGN}: take "
                "another folder"
            )
        return
    there = read_design(folder)
    versions = there.pop("made_with", {})
    here = {"format": FORMAT, **campaign.to_dict()}
    for difference in differences(there, here):
        raise ValueError(
            f"{folder}: holds a campaign of another design: {difference}; take another folder, or the design "
            f"in {DESIGN}"
        )
    for difference in differences(versions, _versions()):
        raise ValueError(
            f"{folder}: was begun with other versions: {difference}; finish it with those, or take another "
            "folder"
        )


def _versions() -> dict[str, str]:
    """Versions of all that decides about the bytes of the files; pyarrow writes the tables."""
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
def _explained(folder: Path, n_shards: int, digests: Mapping[int, Mapping[str, str]]) -> Iterator[None]:
    """A full disk said in words; other errors as they are."""
    try:
        yield
    except OSError as error:
        if error.errno not in _FULL:
            raise
        finished = sum(map(bool, digests.values()))
        raise OSError(
            error.errno,
            f"{folder}: the disk is full; {finished} of {n_shards} shards are finished and kept: make room "
            "and run the same campaign again to go on",
        ) from error


@contextlib.contextmanager
def _alone_in(folder: Path) -> Iterator[None]:
    """Nobody else may write to the folder meanwhile; a process that dies lets go of it."""
    try:
        import fcntl
    except ImportError:  # not a POSIX system: nothing to hold on to
        yield
        return
    held = os.open(folder, os.O_RDONLY)
    try:
        try:
            fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise BlockingIOError(
                errno.EWOULDBLOCK, f"{folder}: another process is at work on this campaign: wait for its end"
            ) from None
        except OSError:
            pass  # a file system without locks
        yield
    finally:
        os.close(held)


def _plans(campaign: Campaign, shard: int) -> Iterator[RunPlan]:
    return campaign.plans(shard * campaign.runs_per_shard, campaign.shard_size(shard))


def _counted(
    results: Iterator[RunResult],
    campaign: Campaign,
    done: int,
    progress: Callable[[int, int], object] | None,
) -> Iterator[RunResult]:
    for result in results:
        done += 1
        if progress is not None:
            progress(done, campaign.n_runs)
        yield result


def _make_shard(campaign: Campaign, folder: Path, shard: int, results: Iterator[RunResult]) -> dict[str, str]:
    """Torque, rows, and last their digests, with which the shard counts as finished."""
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
    made = {
        # numpy, given a real file, tells of a full disk without its error number.
        shard_name(shard): _write_digested(
            folder / shard_name(shard),
            lambda file: np.lib.format.write_array(file, block, version=(1, 0), allow_pickle=False),
        ),
        rows_name(shard): _write_digested(
            folder / rows_name(shard), lambda file: tables.write_table(table, file)
        ),
    }
    made[digests_name(shard)] = _write_digested(
        folder / digests_name(shard), lambda file: file.write(_digest_lines(made))
    )
    return made


def _digest_lines(digests: Mapping[str, str]) -> bytes:
    return "".join(f"{sha256}  {name}\n" for name, sha256 in digests.items()).encode()


class _Digesting(io.RawIOBase):
    """A file to write to that knows the SHA-256 of what was written."""

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file
        self.sha256 = hashlib.sha256()

    def writable(self) -> bool:
        return True

    def write(self, data: Any) -> int:
        self.sha256.update(data)
        return self._file.write(data)


def _write_digested(path: Path, write: Callable[[Any], object]) -> str:
    """As :func:`write_whole`; returns the SHA-256 of what was written."""
    sha256 = ""

    def write_to(file: IO[bytes]) -> None:
        nonlocal sha256
        target = _Digesting(file)
        write(target)
        sha256 = target.sha256.hexdigest()

    write_whole(path, write_to)
    return sha256


def _schema(campaign: Campaign) -> Any:
    pyarrow, _ = parquet()
    kinds = {
        INTEGER: pyarrow.int64(),
        NUMBER: pyarrow.float64(),
        TEXT: pyarrow.string(),
        INTEGERS: pyarrow.list_(pyarrow.int64()),
    }
    return pyarrow.schema([(name, kinds[kind]) for name, kind in columns(campaign).items()])


def _stated(folder: Path) -> dict[str, Any]:
    """Files and digests that the manifest of a finished campaign states; nothing where there is none."""
    try:
        return dict(read_manifest(folder)["files"])
    except (FileNotFoundError, ValueError):
        return {}


def _is_as_stated(folder: Path, name: str, stated: dict[str, Any]) -> bool:
    file = folder / name
    return file.is_file() and digest(file) == stated.get(name, {}).get("sha256")


def _digests_if_whole(folder: Path, shard: int) -> dict[str, str]:
    """Digests of a shard's files if they are all there and unchanged; else nothing."""
    names = [shard_name(shard), rows_name(shard), digests_name(shard)]
    if not all((folder / name).is_file() for name in names):
        return {}
    found = {name: digest(folder / name) for name in names}
    lines = _digest_lines({name: found[name] for name in names[:2]})
    return found if (folder / names[2]).read_bytes() == lines else {}


def _finish(campaign: Campaign, folder: Path, digests: Mapping[int, Mapping[str, str]]) -> None:
    """Table of all rows, and the manifest, which comes last: with it the campaign is whole."""
    pyarrow, tables = parquet()

    def write(file: IO[bytes]) -> None:
        with tables.ParquetWriter(file, _schema(campaign)) as writer:
            for first in range(0, campaign.n_shards, _SHARDS_PER_GROUP):
                group = range(first, min(first + _SHARDS_PER_GROUP, campaign.n_shards))
                parts = [tables.read_table(folder / rows_name(shard)) for shard in group]
                writer.write_table(pyarrow.concat_tables(parts).combine_chunks())

    write_whole(folder / PARAMETERS, write)
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
    write_whole(folder / MANIFEST, lambda file: file.write(json_bytes(manifest)))


def _sync_folder(folder: Path) -> None:
    """Let the new name of a file survive a power cut too, where the system can."""
    if os.name != "posix":
        return
    held = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(held)
    finally:
        os.close(held)


def _bytes(number: float) -> str:
    for unit in ("bytes", "kB", "MB", "GB"):
        if number < 1000:
            return f"{number:.3g} {unit}"
        number /= 1000
    return f"{number:.4g} TB"
