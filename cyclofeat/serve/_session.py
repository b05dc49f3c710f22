"""State of one server: model, recordings, jobs."""

from __future__ import annotations

from collections.abc import AsyncIterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cyclofeat.serve._commands import order
from cyclofeat.serve._jobs import Job, Jobs
from cyclofeat.serve._store import Store


@dataclass
class Session:
    """State of one server.

    Parameters
    ----------
    store : Store
    jobs : Jobs
    given : sequence of str
        Options that name the model, from the command line: ``--model FILE`` and what goes with it.
    """

    store: Store
    jobs: Jobs
    given: Sequence[str]
    uploaded: Path | None = None

    @property
    def model(self) -> Path | None:
        """The model file to count with: the uploaded one, else the one given; None for the packaged ones."""
        if self.uploaded is not None:
            return self.uploaded
        return Path(self.given[1]) if self.given else None

    def model_options(self) -> list[str]:
        """Return the options that name the model; empty for the packaged ones."""
        return list(self.given) if self.uploaded is None else ["--model", str(self.uploaded)]

    async def add_model(self, name: str, content: AsyncIterable[bytes]) -> None:
        """Store an uploaded model file, or the card that belongs to the one before."""
        self.uploaded = await self.store.add_model(name, content, self.uploaded)

    def start(self, asked: Mapping[str, Any]) -> Job:
        """Start the command that the page asks for."""
        return self.jobs.start(lambda folder: order(asked, self.store, self.model_options(), folder))

    def facts(self) -> dict[str, dict[str, Any]]:
        """Return what was last found in each file, by its path within the folder of recordings."""
        rows: dict[str, dict[str, Any]] = {}
        for job in self.jobs.jobs.values():
            if job.order.command == "inspect":
                rows |= {str(row["file"]): row for row in job.result if "file" in row}
        return rows
