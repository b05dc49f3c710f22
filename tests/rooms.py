"""The checkout: its rooms, and the file of each module by the module's name."""

from __future__ import annotations

from pathlib import Path

ROOT = Path(__file__).parents[1]
ROOMS = {
    "cyclofeat": ROOT / "cyclofeat",
    "cyclofeat.simulators": ROOT / "simulators",
    "cyclofeat.datasets": ROOT / "datasets",
}


def modules_of(rooms: dict[str, Path]) -> dict[str, Path]:
    """File of each module of some packages by its import name."""
    files: dict[str, Path] = {}
    for prefix, folder in rooms.items():
        for path in sorted(folder.rglob("*.py")):
            parts = path.relative_to(folder).with_suffix("").parts
            files[".".join([prefix, *parts]).removesuffix(".__init__")] = path
    return files


MODULES = modules_of(ROOMS)
