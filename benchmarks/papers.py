"""Compare the statements of both papers with this simulator's results: ``make papers``.

Writes the rows of docs/papers.rst to ``docs/papers_statements.csv``.
"""

from __future__ import annotations

import csv
import sys
from collections.abc import Callable, Iterable
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "examples" / "papers"))  # its scripts share numbers with the statements

from benchmarks import _paper_a as a  # noqa: E402
from benchmarks import _paper_b as b  # noqa: E402
from benchmarks._paper_b import Part  # noqa: E402

NOT_TESTABLE = "cannot be tested without their recordings"
AGREES = {True: "yes", False: "no", None: "not testable"}
# Source, script that draws it, function that compares.
STATEMENTS: dict[str, tuple[str, str, Callable[[], list[Part]]]] = {
    "B1": ("B fig. 3", "plot_b03_sleeve_forces", b.b1),
    "B2": ("B fig. 3", "plot_b03_sleeve_forces", b.b2),
    "B3": ("B fig. 4", "plot_b03_sleeve_forces", b.b3),
    "B4": ("B fig. 5", "plot_b05_torques", b.b4),
    "B5": ("B figs. 3-6", "plot_b05_torques", b.b5),
    "B6": ("B figs. 8, 9", "plot_b08_coherence", b.b6),
    "B7": ("B section 5", "plot_b18_minima_overlap", b.b7),
    "B8": ("B fig. 12", "plot_b10_scalograms", b.b8),
    "B9": ("B figs. 15-17", "plot_b15_removed_lobes", b.b9),
    "B10": ("B fig. 18", "plot_b18_minima_overlap", b.b10),
    "A1": ("A table 4", "plot_a05_torque", a.a1),
    "A2": ("A section 2", "plot_a21_methods", a.a2),
    "A3": ("A section 5.1", "plot_a09_wavelets", a.a3),
    "A4": ("A fig. 9", "plot_a09_wavelets", a.a4),
    "A5": ("A figs. 10, 11", "plot_a10_coherence", a.a5),
    "A6": ("A table 6", "plot_a12_entropy", a.a6),
    "A7": ("A table 5, fig. 14", "plot_a14_centroid", a.a7),
    "A8": ("A figs. 15-17", "plot_a15_narrowband", a.a8),
    "A9": ("A fig. 18", "plot_a12_entropy", a.a9),
    "A10": ("A fig. 19", "plot_a19_falling_entropy", a.a10),
    "A11": ("A fig. 20", "plot_a20_spectra", a.a11),
    "A12": ("A figs. 5-8", "plot_a07_simulated_torque", a.a12),
}


def verdict(parts: Iterable[Part]) -> str:
    """Return the verdict of a whole statement from those of its parts."""
    found = {agrees for _, _, agrees in parts}
    if found == {None}:
        return NOT_TESTABLE
    if len(found) > 1:
        return "partly"
    return "reproduced" if found == {True} else "contradicted"


def compared() -> dict[str, list[Part]]:
    """Return the parts of every statement by its number."""
    found = {}
    for number, (_, _, parts) in STATEMENTS.items():
        # numpy's truth values are not Python's bool.
        found[number] = [(claim, here, None if yes is None else bool(yes)) for claim, here, yes in parts()]
        print(f"{number:4} {verdict(found[number])}", flush=True)
        for claim, here, agrees in found[number]:
            print(f"     {claim}: {here} ({AGREES[agrees]})", flush=True)
    return found


def write_rows(found: dict[str, list[Part]], path: Path) -> None:
    """Write a row per statement in reStructuredText."""
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        for number, parts in found.items():
            source, script, _ = STATEMENTS[number]
            cells = "\n".join(f"* *{claim}*: {here} (**{AGREES[agrees]}**)" for claim, here, agrees in parts)
            link = f":ref:`{source} <sphx_glr_gallery_papers_{script}.py>`"
            writer.writerow([number, link, verdict(parts), cells])


if __name__ == "__main__":
    write_rows(compared(), ROOT / "docs" / "papers_statements.csv")
