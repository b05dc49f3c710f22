"""Recordings of a folder, described by a manifest."""

from __future__ import annotations

import csv
import io
import math
import os
import re
import warnings
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cyclofeat._base.files import write_whole
from cyclofeat._base.quantities import QUANTITIES, from_1, some_of
from cyclofeat.datasets.readers._columns import name_errors
from cyclofeat.datasets.readers._csv import TextLines, split_row
from cyclofeat.datasets.readers._read import RECORDINGS, SOURCES, file_path, read_stretches, write_recording
from cyclofeat.datasets.readers._words import WORN, check_no_bare_lobes
from cyclofeat.recordings import Recording

if TYPE_CHECKING:
    from cyclofeat.simulators.campaign import CampaignData

#: Name of the file that describes the recordings of its folder.
MANIFEST = "recordings.csv"
_BOOLEANS = {"true": True, "1": True, "yes": True, "false": False, "0": False, "no": False}


def _parse_lobes(cell: str) -> tuple[int, ...]:
    return tuple(int(lobe) - 1 for lobe in cell.replace(",", " ").replace(";", " ").split())


# Columns of a manifest: what their cells are, and what else they must be.
_COLUMNS: dict[str, tuple[Callable[[str], Any], Callable[[Any], bool], str]] = {
    **dict.fromkeys(
        ("file", "channel", "time_channel", "time_unit", "angle_channel", "angle_unit", "delimiter",
         "decimal", "gaps", "run", "source", "assembly", "angle_of"), (str, bool, "text"),
    ),
    **dict.fromkeys(
        ("pulses_per_turn", "counts_per_turn", "table_line"), (int, lambda x: x >= 1, "a whole number from 1")
    ),
    "quantity": (str, QUANTITIES.__contains__, f"one of {', '.join(QUANTITIES)}"),
    **dict.fromkeys(("sampling_rate", "speed"), (float, lambda x: 0 < x < math.inf, "a positive number")),
    "scale": (float, lambda x: x != 0 and math.isfinite(x), "a number other than 0"),
    "load": (float, math.isfinite, "a number"),
    "defect_count": (int, lambda x: x >= 0, "a whole number from 0"),
    "n_lobes": (int, lambda x: x >= 2, "a whole number from 2"),
    WORN: (
        _parse_lobes, lambda x: min(x, default=0) >= 0,
        "lobes counted from 1 and separated by spaces, like 1 5",
    ),
    "angle_is_absolute": (lambda cell: _BOOLEANS[cell.lower()], lambda x: True, "true or false"),
}  # fmt: skip
_ARGUMENTS = {"speed": "speed_rpm", "load": "load_nm", WORN: "worn_lobes"}  # with other names there


@dataclass(frozen=True)
class Entry:
    """One file to read, with arguments of :func:`read_recording` from its line of a folder's manifest."""

    path: Path
    arguments: dict[str, Any] = field(default_factory=dict)
    line: int | None = None  # of the manifest, if there is one
    reader: Callable[..., list[Recording]] = read_stretches

    def read(self, **arguments: Any) -> list[Recording]:
        """Read the recordings, several if gaps are cut; arguments given here precede the manifest's."""
        given = {key: value for key, value in arguments.items() if value is not None}
        return self.reader(self.path, **(self.arguments | given))


def read_folder(path: str | os.PathLike[str], **arguments: Any) -> list[Recording]:
    """Read the recordings of a folder, with the labels that its manifest states.

    Parameters
    ----------
    path : path
        Folder. If it holds a file ``recordings.csv``, that is its manifest: a CSV file with one line per
        recording and the columns ``file`` (within the folder), ``speed`` (RPM of the input), ``load`` (Nm),
        ``worn_lobes_from_1`` (separated by spaces), other arguments of :func:`read_recording`, and labels of
        :class:`~cyclofeat.recordings.Recording`. An empty cell states nothing.
        Without a manifest all files that :func:`read_recording` knows are read, by name, but for ``.txt``,
        ``.dat`` and ``.log``; of a campaign (:func:`cyclofeat.simulators.run_campaign`) all runs that reached
        their end.
    **arguments
        Arguments of :func:`read_recording` for all recordings; they precede the manifest.

    Returns
    -------
    list of Recording
        In the manifest's order; with ``gaps="cut"`` all stretches of each file.

    Warns
    -----
    UserWarning
        If the folder holds recordings that its manifest does not name.

    Examples
    --------
    >>> import tempfile, pathlib
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     folder = pathlib.Path(folder)
    ...     _ = (folder / "a.csv").write_text("torque [Nm]\\n21.9\\n22.1\\n")
    ...     _ = (folder / "recordings.csv").write_text(
    ...         "file,sampling_rate,worn_lobes_from_1,assembly,speed\\na.csv,25600,1 5,A1,500\\n"
    ...     )
    ...     (recording,) = read_folder(folder)
    >>> recording.assembly, recording.worn_lobes, recording.speed_rpm
    ('A1', (0, 4), 500.0)
    """
    recordings, wrong = [], []
    for entry in folder_entries(path):
        try:
            recordings += entry.read(**arguments)
        except (ValueError, TypeError, OSError) as error:
            if entry.line is None:
                raise
            wrong.append(f"line {entry.line}: {error}")
    if wrong:
        raise ValueError(f"{MANIFEST}: {some_of(wrong, 10, separator='; ')}")
    return recordings


def write_folder(path: str | os.PathLike[str], recordings: Iterable[Recording]) -> list[Path]:
    """Write recordings as ``<assembly>.npz``, and last the manifest of their labels; return the files."""
    folder, files = file_path(path), []
    folder.mkdir(parents=True, exist_ok=True)
    text = io.StringIO(newline="")
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(["file", "quantity", "speed", "load", "defect_count", WORN, "assembly", "source"])
    for recording in recordings:
        files.append(folder / (re.sub(r"[^\w.-]", "_", str(recording.assembly)) + ".npz"))
        write_recording(files[-1], recording)
        worn = " ".join(map(str, from_1(recording.worn_lobes or ())))
        rows.writerow([
            files[-1].name, recording.quantity, recording.speed_rpm, recording.load_nm,
            recording.defect_count, worn, recording.assembly, recording.source,
        ])  # fmt: skip
    write_whole(folder / MANIFEST, lambda file: file.write(text.getvalue().encode()))
    return files


def folder_entries(path: str | os.PathLike[str]) -> list[Entry]:
    """List the recordings of a folder, by its manifest or its files' names, without reading them.

    Parameters and errors are those of :func:`read_folder`.
    """
    folder = file_path(path)
    if not folder.exists():
        raise FileNotFoundError(f"no such folder: {folder}")
    if not folder.is_dir():
        raise ValueError(f"{folder} is no folder; use read_recording for a file")
    if (folder / "campaign.json").is_file():
        from cyclofeat.simulators import load_campaign

        data = load_campaign(folder)
        if n_failed := int((~data.ok).sum()):
            warnings.warn(f"{folder}: {n_failed} runs that failed are not read", stacklevel=3)
        runs = data.ok.nonzero()[0].tolist()
        return [Entry(folder / f"{run:07d}", reader=partial(_read_run, data, run)) for run in runs]
    known = (file for file in folder.iterdir() if file.name.lower().endswith(RECORDINGS))
    files = sorted(file for file in known if file.name != MANIFEST)
    if (folder / MANIFEST).is_file():
        with name_errors(MANIFEST):
            entries = _read_manifest(folder)
        if left_out := {file.name for file in files} - {entry.path.name for entry in entries}:
            shown = ", ".join(sorted(left_out)[:5]) + (", ..." if len(left_out) > 5 else "")
            warnings.warn(f"{MANIFEST} does not name {shown}: not read", stacklevel=3)
        return entries
    if not files:
        *others, last = SOURCES
        known_kinds = f"{', '.join(others)} or {last} recordings"
        raise ValueError(f"folder {folder} holds no {known_kinds}; {MANIFEST} may name other texts")
    return [Entry(file) for file in files]


def _read_run(data: CampaignData, run: int, path: Path, **arguments: Any) -> list[Recording]:
    """Return the recording of a campaign's run, at its nominal speed and load, without an angle."""
    row, gearbox = {name: values[run] for name, values in data.parameters.items()}, data.campaign.rig.gearbox
    speed, load = (
        row.get(f"effects.gearbox_parameter_{name}.value", getattr(gearbox, name))
        for name in ("input_speed", "load_torque")
    )
    recording = Recording(
        data.X[run], data.sampling_rate, assembly=str(row["assembly"]), run=path.name, source="surrogate",
        worn_lobes=row[WORN] - 1, speed_rpm=round(30 * speed / math.pi, 6), load_nm=load,
        n_lobes=gearbox.n_lobes, meta={name: x for name, x in row.items() if isinstance(x, float) and x == x},
    )  # fmt: skip
    for name, value in arguments.items():
        if value != getattr(recording, name, None):
            raise ValueError(f"{path}: {name}= contradicts the campaign, or has no effect: leave it out")
    return [recording]


def _read_manifest(folder: Path) -> list[Entry]:
    lines = [(number, line) for number, line in enumerate(TextLines(folder / MANIFEST), 1) if line.strip()]
    if not lines:
        raise ValueError(f"the file is empty; its first line names the columns: {', '.join(_COLUMNS)}")
    (first, names_line), *rows = lines
    delimiter = next((d for d in "\t;," if d in names_line), ",")
    names = [name.strip().lower() for name in split_row(names_line, delimiter)]
    with name_errors(f"line {first}"):
        check_no_bare_lobes(names)
        for name in names:
            if name not in _COLUMNS:
                raise ValueError(f"unknown column {name!r}; known are {', '.join(_COLUMNS)}")
            if names.count(name) > 1:
                raise ValueError(f"column {name!r} is there {names.count(name)} times")
        if "file" not in names:
            raise ValueError(f"no column 'file'; columns are {', '.join(names)}")
    entries: list[Entry] = []
    wrong: list[str] = []
    lines_of: dict[tuple[Any, ...], int] = {}
    for number, line in rows:
        cells = [cell.strip() for cell in split_row(line, delimiter)]
        try:
            if len(cells) != len(names):
                raise ValueError(f"{len(names)} columns are right, got {len(cells)}")
            entry = _parse_row(folder, dict(zip(names, cells, strict=True)), number, delimiter)
            key = (entry.path, *map(entry.arguments.get, ("channel", "quantity")))
            if (line_before := lines_of.setdefault(key, number)) != number:
                raise ValueError(f"{entry.path.name} is there already, in line {line_before}")
            entries.append(entry)
        except ValueError as error:
            wrong.append(f"line {number}: {error}")
    if wrong:
        raise ValueError(some_of(wrong, 10, separator="; "))
    if not entries:
        raise ValueError("it names no recording")
    return entries


def _parse_row(folder: Path, row: dict[str, str], line: int, delimiter: str) -> Entry:
    file, arguments = row.pop("file"), dict[str, Any]()
    if not file:
        raise ValueError("file is missing")
    if not (folder / file).is_file():
        raise ValueError(f"no such file: {file}")
    for name, cell in row.items():
        if not cell:
            continue
        convert, is_right, right = _COLUMNS[name]
        decimal_comma = convert is float and delimiter != ","
        try:
            value = convert(cell.replace(",", ".") if decimal_comma else cell)
            # Python takes 1_000 for a number, other programs do not.
            fits = is_right(value) and (convert is str or "_" not in cell)
        except (ValueError, KeyError):
            fits = False
        if not fits:
            raise ValueError(f"{name} must be {right}, got {cell!r}")
        arguments[_ARGUMENTS.get(name, name)] = value
    count, worn = arguments.get("defect_count"), arguments.get("worn_lobes")
    if count is not None and worn is not None and count != len(worn):
        raise ValueError(f"defect_count must be the number of {WORN}, got {count} and {row[WORN]!r}")
    return Entry(folder / file, arguments, line)
