"""A finished campaign, memory-mapped."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from cyclofeat._base.frames import frame
from cyclofeat.simulators.campaign._design import Campaign
from cyclofeat.simulators.campaign._run import OK
from cyclofeat.simulators.campaign._store import (
    DESIGN,
    MANIFEST,
    PARAMETERS,
    digest,
    parquet,
    read_design,
    read_manifest,
    shard_file,
)

if TYPE_CHECKING:
    import pandas as pd


class Shards:
    """Rows of several ``.npy`` files of float32 as one two-dimensional array, read on demand.

    A single row is memory-mapped; other selections and ``numpy.asarray`` copy.

    Parameters
    ----------
    paths : sequence of path
        Files, each of shape (n, n_samples).
    sizes : sequence of int
        Number of rows in each.
    n_samples : int

    Examples
    --------
    >>> import pathlib, tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     paths = [pathlib.Path(folder) / name for name in ("a.npy", "b.npy")]
    ...     np.save(paths[0], np.array([[1, 2], [3, 4]], dtype=np.float32))
    ...     np.save(paths[1], np.array([[5, 6]], dtype=np.float32))
    ...     X = Shards(paths, [2, 1], 2)
    ...     X.shape, X[[2, 0]].tolist(), X[1:, 1].tolist()
    ((3, 2), [[5.0, 6.0], [1.0, 2.0]], [4.0, 6.0])
    """

    dtype = np.dtype(np.float32)
    ndim = 2

    def __init__(self, paths: Sequence[str | os.PathLike[str]], sizes: Sequence[int], n_samples: int) -> None:
        self.paths = tuple(Path(path) for path in paths)
        self._ends = np.cumsum(sizes)
        self.shape = (int(self._ends[-1]), int(n_samples))

    def __repr__(self) -> str:
        return f"<Shards of shape {self.shape}, {self.dtype}, in {len(self.paths)} files>"

    def __len__(self) -> int:
        return self.shape[0]

    def __iter__(self) -> Iterator[NDArray[np.float32]]:
        for shard in range(len(self.paths)):
            yield from self._shard(shard)

    def __getitem__(self, key: Any) -> Any:
        rows, rest = (key[0], key[1:]) if isinstance(key, tuple) else (key, ())
        if len(rest) > 1 or rows is None or rows is Ellipsis:
            raise IndexError(f"Shards take rows, or rows and samples, got {key!r}")
        samples = rest[0] if rest else slice(None)
        if isinstance(rows, (int, np.integer)) and not isinstance(rows, bool):
            row = self._row(int(rows))
            return row[samples] if rest else row
        taken = np.arange(len(self))[rows]  # numpy's rules for slices, masks and lists
        if taken.ndim != 1:
            raise IndexError(f"Shards take one or a list of rows, got shape {taken.shape}")
        if isinstance(samples, (slice, int, np.integer)):
            return self._rows(taken, samples)
        return self._rows(taken, slice(None))[:, samples]

    def __array__(self, dtype: DTypeLike | None = None, copy: bool | None = None) -> NDArray[Any]:
        if copy is False:
            raise ValueError("Shards lie in several files: an array of them is always a copy")
        return np.asarray(self[:], dtype=dtype)

    def _shard(self, shard: int) -> Any:
        return np.load(self.paths[shard], mmap_mode="r", allow_pickle=False)

    def _row(self, index: int) -> Any:
        if not -len(self) <= index < len(self):
            raise IndexError(f"row {index} is out of bounds for {len(self)} rows")
        index %= len(self)
        shard = int(np.searchsorted(self._ends, index, side="right"))
        return self._shard(shard)[index - self._begin(shard)]

    def _rows(self, taken: NDArray[np.intp], samples: Any) -> NDArray[np.float32]:
        width = np.empty((0, self.shape[1]), dtype=self.dtype)[:, samples].shape[1:]
        copy = np.empty((len(taken), *width), dtype=self.dtype)
        shards = np.searchsorted(self._ends, taken, side="right")
        for shard in np.unique(shards).tolist():
            inside = shards == shard
            copy[inside] = self._shard(shard)[:, samples][taken[inside] - self._begin(shard)]
        return copy

    def _begin(self, shard: int) -> int:
        return int(self._ends[shard - 1]) if shard else 0


@dataclass(frozen=True)
class CampaignData:
    """A finished campaign; its torque is a surrogate for measured torque.

    Attributes
    ----------
    X : memmap or Shards, shape (n_runs, n_samples)
        Output torque in Nm, float32; NaN in the rows of failed runs.
    y : ndarray of int, shape (n_runs,)
        Number of worn lobes.
    groups : ndarray of str, shape (n_runs,)
        Assembly of each run.
    ok : ndarray of bool, shape (n_runs,)
        Runs that reached their end: ``X[ok], y[ok], groups[ok]`` hold no NaN.
    parameters : dict from str to ndarray, shape (n_runs,)
        One value per run: labels (``worn_lobes_from_1``, ``wheels_from_1``, ``depth``), ``status``,
        ``reason``, true values of the assembly (``true_speed_rpm``, ...) and the parameters of the rig's
        effects (``effects.<effect>.<parameter>``).
    sampling_rate : float
        In Hz.
    campaign : Campaign
        The design.
    manifest : dict
        What ``manifest.json`` holds.
    """

    X: Any = field(repr=False)
    y: NDArray[np.int64] = field(repr=False)
    groups: NDArray[np.str_] = field(repr=False)
    ok: NDArray[np.bool_] = field(repr=False)
    parameters: dict[str, NDArray[Any]] = field(repr=False)
    sampling_rate: float
    campaign: Campaign
    manifest: dict[str, Any] = field(repr=False)

    def to_frame(self) -> pd.DataFrame:
        """Return ``parameters`` as a data frame, one row per run.

        Raises
        ------
        ImportError
            If pandas is not installed.
        """
        return frame(self.parameters)


def load_campaign(path: str | os.PathLike[str], *, verify: bool = False) -> CampaignData:
    """Open a finished campaign; torque stays on disk until it is used.

    Parameters
    ----------
    path : path
        Folder of the campaign.
    verify : bool
        Compare every file with its SHA-256 in the manifest, not only its size.

    Raises
    ------
    FileNotFoundError
        If there is no campaign, or a file of it is missing; the message names it.
    ValueError
        If the campaign is not finished, or a file was changed; the message names it.
    ImportError
        If pyarrow is not installed.

    Examples
    --------
    >>> import tempfile
    >>> from cyclofeat.simulators import Campaign, run_campaign
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     _ = run_campaign(Campaign(rig="R0", defect_counts=(0, 2), repeats=1, duration=0.1), folder)
    ...     data = load_campaign(folder, verify=True)
    ...     data.y.tolist(), data.groups.tolist()
    ([0, 2], ['campaign-0-0000000', 'campaign-0-0000001'])
    """
    folder = Path(path)
    if not (folder / DESIGN).is_file():
        raise FileNotFoundError(f"{folder}: holds no campaign (no {DESIGN})")
    _, tables = parquet()
    campaign, _ = read_design(folder)
    if not (folder / MANIFEST).is_file():
        names = [shard_file(shard, "sha256") for shard in range(campaign.n_shards)]
        finished = sum((folder / name).is_file() for name in names)
        raise ValueError(
            f"{folder}: the campaign is not finished, {finished} of {campaign.n_shards} shards are there: "
            "run it again to go on"
        )
    manifest = read_manifest(folder)
    _check_files(folder, manifest, verify)
    table = tables.read_table(folder / PARAMETERS)
    columns = {name: table.column(name).to_numpy() for name in ("defect_count", "assembly", "status")}
    paths = [folder / shard_file(shard, "npy") for shard in range(campaign.n_shards)]
    sizes = [campaign.shard_size(shard) for shard in range(campaign.n_shards)]
    shards = Shards(paths, sizes, campaign.n_samples)
    return CampaignData(
        X=shards if len(paths) > 1 else np.load(paths[0], mmap_mode="r", allow_pickle=False),
        y=columns["defect_count"].astype(np.int64),
        groups=columns["assembly"].astype(np.str_),
        ok=columns["status"] == OK,
        parameters={name: table.column(name).to_numpy() for name in table.column_names},
        sampling_rate=campaign.sampling_rate,
        campaign=campaign,
        manifest=manifest,
    )


def _check_files(folder: Path, manifest: dict[str, Any], verify: bool) -> None:
    """Raise an error unless all files have the sizes (with ``verify``, the digests) of the manifest."""
    wrong = []
    for name, stated in manifest["files"].items():
        file = folder / name
        if not file.is_file():
            wrong.append(f"{name} is missing")
        elif file.stat().st_size != stated["bytes"]:
            wrong.append(f"{name} was changed: {file.stat().st_size} bytes instead of {stated['bytes']}")
        elif verify and digest(file) != stated["sha256"]:
            wrong.append(f"{name} was changed: its SHA-256 is not the manifest's")
    if wrong:
        more = f" (and {len(wrong) - 1} more)" if len(wrong) > 1 else ""
        kind = FileNotFoundError if all(text.endswith("is missing") for text in wrong) else ValueError
        raise kind(f"{folder}: {wrong[0]}{more}; run the campaign again to mend it")
