"""SQLite file with the counts of gearboxes."""

from __future__ import annotations

import hashlib
import json
import os
import sqlite3
import time as clock
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import fields
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from cyclofeat._base.displays import data_frame
from cyclofeat._base.files import check_parent
from cyclofeat._base.quantities import number_of
from cyclofeat.history.alarm import GearboxState, HistoryRow, state_of

if TYPE_CHECKING:
    import pandas as pd

    from cyclofeat.counting import LobeCount
    from cyclofeat.recordings import Recording

SCHEMA_VERSION = 1
# "cycf": says whose file it is.
_APPLICATION_ID = 0x63796366
_WAIT_S = 30.0
_DAMAGED = "{} is damaged ({}): restore a copy"
_TABLES = """
CREATE TABLE model (
    id INTEGER PRIMARY KEY,
    card_sha256 TEXT NOT NULL UNIQUE,
    description TEXT NOT NULL,
    scores TEXT  -- JSON of its cross-validation, or NULL
);
CREATE TABLE recording (
    id INTEGER PRIMARY KEY,
    time REAL NOT NULL,  -- s since 1970, UTC
    gearbox TEXT NOT NULL,
    file TEXT NOT NULL,
    model INTEGER NOT NULL REFERENCES model (id),
    counted_at REAL NOT NULL,
    defect_count INTEGER,  -- NULL where refused
    reason TEXT NOT NULL,  -- why refused
    mean REAL NOT NULL,
    deviation REAL NOT NULL,
    unit TEXT NOT NULL,
    answer TEXT NOT NULL,  -- JSON, as cyclofeat count prints it
    UNIQUE (gearbox, file, time, model)
);
CREATE INDEX recording_by_gearbox ON recording (gearbox, time, id);
"""
# What a state needs of an answer: the others take long to read.
_DEPTH = ("wear_um", "wear_um_low", "wear_um_high", "wear_um_coverage")
_WEAR = ", ".join(f"'{name}', json_extract(answer, '$.{name}')" for name in _DEPTH)
_ADD_MODEL = """
INSERT INTO model (card_sha256, description, scores) VALUES (?, ?, ?) ON CONFLICT (card_sha256) DO NOTHING
"""
_ADD = """
INSERT INTO recording
    (model, time, gearbox, file, counted_at, defect_count, reason, mean, deviation, unit, answer)
VALUES ((SELECT id FROM model WHERE card_sha256 = ?), ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)
ON CONFLICT DO UPDATE SET
    counted_at = excluded.counted_at, defect_count = excluded.defect_count, reason = excluded.reason,
    mean = excluded.mean, deviation = excluded.deviation, unit = excluded.unit, answer = excluded.answer
"""


class History:
    """SQLite file with one row per recording.

    Several processes can write to one file, and be killed while they do: a row is there whole or not at all.
    The file must lie on a local disk, since the journal of the write-ahead log is shared memory. A file that
    is counted again by the same model keeps its one row, with the last answer.

    Parameters
    ----------
    path : path-like
        Made where it does not exist.
    create : bool, default=True
        False: ``FileNotFoundError`` where it does not exist, ``ValueError`` where it is empty.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> from cyclofeat import Recording
    >>> from cyclofeat.counting import LobeCount
    >>> count = LobeCount(1, {0: 0.1, 1: 0.9}, (3,), (), False, 2)
    >>> recording = Recording([22.0, 22.4, 21.8], 2.0)
    >>> with tempfile.TemporaryDirectory() as folder, History(pathlib.Path(folder, "a.sqlite")) as history:
    ...     history.add("press 4", "monday.csv", 1.7e9, count, recording, {})
    ...     history.write()
    ...     history.state("press 4").defect_count, history.rows("press 4")[0].answer["probability"]
    (1, {'0': 0.1, '1': 0.9})
    """

    def __init__(self, path: str | os.PathLike[str], *, create: bool = True) -> None:
        self.path = Path(path)
        if self.path.is_dir():
            raise IsADirectoryError(f"{self.path} is a folder: a history is a file")
        if not create:
            if not self.path.exists():
                raise FileNotFoundError(f"no such history: {self.path}")
            if not self.path.stat().st_size:
                raise ValueError(f"{self.path} is no history: it is empty")
        check_parent(self.path, "the history")
        self._pending: list[tuple[tuple[Any, ...], tuple[Any, ...]]] = []
        with self._name_errors(), ExitStack() as on_error:
            # Not as a name alone: SQLite takes some for a database in memory.
            place = self.path.absolute()
            self._connection = sqlite3.connect(place, timeout=_WAIT_S, isolation_level=None)
            on_error.callback(self.close)
            # Make the tables in a new file, and check those of an old one.
            execute = self._connection.execute
            if self._is_new():
                # Before the first transaction: this setting belongs to the file.
                execute("PRAGMA journal_mode = WAL")
                with self._connection:
                    execute("BEGIN IMMEDIATE")
                    if self._is_new():  # no other process has been faster
                        for statement in _TABLES.split(";")[:-1]:
                            execute(statement)
                        execute(f"PRAGMA application_id = {_APPLICATION_ID}")
                        execute(f"PRAGMA user_version = {SCHEMA_VERSION}")
            version = execute("PRAGMA user_version").fetchone()[0]
            if execute("PRAGMA application_id").fetchone()[0] != _APPLICATION_ID:
                raise ValueError(f"{self.path} is a database of something else: name another file")
            if version != SCHEMA_VERSION:
                raise ValueError(
                    f"{self.path} is a history of version {version}, but {SCHEMA_VERSION} can be read: "
                    "update cyclofeat"
                )
            # Now, with its indices: a damaged page would else be met in the middle of the work, or never.
            if (fault := execute("PRAGMA integrity_check(1)").fetchone()[0]) != "ok":
                raise ValueError(_DAMAGED.format(self.path, " ".join(fault.split())))
            on_error.pop_all()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __str__(self) -> str:
        states = map(self.state, self.gearboxes())
        lines = [f"{one.gearbox}: {number_of(one.n_recordings, 'recording')}; {one}" for one in states]
        return "\n  ".join([f"History {self.path}", *lines])

    def close(self) -> None:
        """Close the file; rows that were not written are lost."""
        self._connection.close()

    def add(
        self,
        gearbox: str,
        file: str,
        time: float,
        count: LobeCount,
        recording: Recording,
        card: Mapping[str, Any],
    ) -> None:
        """Add a recording, for the next :meth:`write`.

        Parameters
        ----------
        gearbox, file : str
            Names of the gearbox and of the recording's file.
        time : float
            Time of the recording, in s since 1970.
        count : LobeCount
            Answer of a model.
        recording : Recording
        card : mapping
            :attr:`LobeModel.card` of that model.
        """
        if not gearbox:
            raise ValueError("gearbox must be a name, got an empty one")
        text = json.dumps(card, sort_keys=True, default=str)
        key = hashlib.sha256(text.encode()).hexdigest()
        scores = card.get("cross_validation")
        model = (key, str(card.get("description", "")), None if scores is None else json.dumps(scores))
        torque = recording.for_counting().torque
        row = (
            # A name in an old encoding, "Prüfstand" in Latin-1 for example, cannot be written as it is.
            key, float(time), gearbox, file.encode(errors="backslashreplace").decode(), clock.time(),
            None if count.refused else count.defect_count,
            count.reason, float(torque.mean()), float(torque.std()), recording.unit,
            json.dumps(count.to_dict() | {"source": recording.source}, allow_nan=False),
        )  # fmt: skip
        self._pending.append((model, row))

    def write(self) -> None:
        """Write the rows added since the last call; after an OSError the next call tries again."""
        if not self._pending:
            return
        with self._name_errors(), self._connection:
            self._connection.execute("BEGIN IMMEDIATE")  # after other processes that write
            self._connection.executemany(_ADD_MODEL, [model for model, _ in self._pending])
            self._connection.executemany(_ADD, [row for _, row in self._pending])
        self._pending.clear()

    def gearboxes(self) -> list[str]:
        """Return the names of all gearboxes, sorted.

        Returns
        -------
        list of str
        """
        rows = self._select_rows("SELECT DISTINCT gearbox FROM recording ORDER BY gearbox")
        return [name for (name,) in rows]

    def rows(self, gearbox: str, last: int | None = None) -> list[HistoryRow]:
        """Return the recordings of a gearbox in the order of time.

        Parameters
        ----------
        gearbox : str
        last : int, optional
            How many of the last ones. Default: all.

        Returns
        -------
        list of HistoryRow
        """
        return self._read_rows(gearbox, -1 if last is None else last)

    def to_frame(self, gearbox: str) -> pd.DataFrame:
        """Return the recordings of a gearbox as a table.

        Parameters
        ----------
        gearbox : str

        Returns
        -------
        pandas.DataFrame
            One row per recording in the order of time: ``time`` (UTC), ``file``, ``model``, ``defect_count``
            (missing where refused), ``wear_um`` (missing where none was seen or stated), ``reason``,
            ``mean``, ``deviation``, ``unit``.
        """
        rows = [vars(row) | {"wear_um": row.answer.get("wear_um")} for row in self.rows(gearbox)]
        names = ("file", "model", "defect_count", "wear_um", "reason", "mean", "deviation", "unit")
        table: dict[str, list[Any]] = {"time": [datetime.fromtimestamp(row["time"], UTC) for row in rows]}
        table |= {name: [row[name] for row in rows] for name in names}
        return data_frame(table).astype({"defect_count": "Int64", "wear_um": "float64"})

    def state(
        self, gearbox: str, *, false_alarms_per_month: float = 0.1, recordings_per_month: float | None = None
    ) -> GearboxState:
        """Return the state of a gearbox, by the recordings of the model that counted last.

        Parameters
        ----------
        gearbox : str
        false_alarms_per_month : float, default=0.1
            From which the rule of the alarm follows, see :func:`choose_rule`.
        recordings_per_month : float, optional
            Default: as frequent as they were, if they span at least an hour.

        Returns
        -------
        GearboxState
        """
        rows = self._read_rows(gearbox, answer=f"json_object({_WEAR})")
        if not rows:
            known = ", ".join(self.gearboxes()) or "none"
            raise ValueError(f"gearbox must be one of the history, {known}, got {gearbox!r}")
        model = rows[-1].model
        ((scores,),) = self._select_rows("SELECT scores FROM model WHERE id = ?", (model,))
        return state_of(
            [row for row in rows if row.model == model], None if scores is None else json.loads(scores),
            false_alarms_per_month=false_alarms_per_month, recordings_per_month=recordings_per_month,
        )  # fmt: skip

    def _is_new(self) -> bool:
        return not self._connection.execute("SELECT count(*) FROM sqlite_schema").fetchone()[0]

    def _read_rows(self, gearbox: str, last: int = -1, answer: str = "answer") -> list[HistoryRow]:
        *columns, _ = (column.name for column in fields(HistoryRow))
        rows = self._select_rows(
            f"SELECT {', '.join(columns)}, {answer} FROM recording WHERE gearbox = ? "
            "ORDER BY time DESC, id DESC LIMIT ?",
            (gearbox, last),
        )
        return [HistoryRow(*(*others, json.loads(answer))) for *others, answer in reversed(rows)]

    def _select_rows(self, statement: str, values: Sequence[Any] = ()) -> list[Any]:
        with self._name_errors():
            return self._connection.execute(statement, values).fetchall()

    @contextmanager
    def _name_errors(self) -> Iterator[None]:
        """Raise errors of SQLite as OSError, and ValueError for a file that is no database."""
        try:
            yield
        except sqlite3.OperationalError as error:
            raise OSError(f"history {self.path}: {error}") from error
        except sqlite3.DatabaseError as error:
            damaged = error.sqlite_errorcode == sqlite3.SQLITE_CORRUPT
            text = _DAMAGED if damaged else "{} is no history ({}): name another file"
            raise ValueError(text.format(self.path, error)) from error
