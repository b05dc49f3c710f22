"""``cyclofeat demo``: train on simulated assemblies, count surrogate recordings from files."""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cyclofeat._base.progress import Progress, Steps
from cyclofeat._base.quantities import lobes_text
from cyclofeat.cli._options import Printed, add_jobs, add_target, note_duration
from cyclofeat.cli.evaluate import cross_validate, write_page

if TYPE_CHECKING:
    from cyclofeat.recordings import Recording
    from cyclofeat.report import CountedRecording

_TRAINING_SEED = 1
_FILE_SEED = 2
_DEMO_S = 160.0  # of one core
_SECTIONS = 4  # recordings with pictures on the page of the counts


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_target(parser, "--out", "folder", default="demo", help="folder to write (default: demo)")
    add_jobs(parser)


def run(
    arguments: argparse.Namespace, *, training_assemblies: int = 24, file_assemblies: int = 4
) -> Iterator[Printed]:
    """Train, write surrogate recordings, count them from their files, compare counters, write the pages.

    The folder then holds ``recordings/``, ``model.skops``, ``count.html`` and ``evaluation.html``. Assemblies
    are those of each defect count: to train on, and to count from files.
    """
    from cyclofeat.counting import LobeModel, Protocol
    from cyclofeat.datasets import read_recording
    from cyclofeat.datasets.readers import write_folder
    from cyclofeat.models import load_model, save_model
    from cyclofeat.models.persistence import check_model_path
    from cyclofeat.report import CountedRecording, check_page_path, write_count_report

    began, folder = time.monotonic(), Path(arguments.out)
    folder.mkdir(parents=True, exist_ok=True)
    # Errors now rather than after the simulation.
    model_file = check_model_path(folder / "model.skops")
    pages = [check_page_path(folder / name) for name in ("count.html", "evaluation.html")]
    note_duration("the demonstration", _DEMO_S, arguments.n_jobs)
    training = _simulate_assemblies(training_assemblies, _TRAINING_SEED, arguments.n_jobs)
    simulated = _simulate_assemblies(file_assemblies, _FILE_SEED, arguments.n_jobs)
    files = write_folder(folder / "recordings", simulated)
    origin = f"{len(training)} simulated assemblies of rig R1"
    with Steps() as step:
        step(f"training on {origin}")
        model = LobeModel(n_splits=0, random_state=0, description=origin)
        save_model(model_file, model.fit(training))
        step("counting recordings from files")
        # Count as a user would: from files, with the stored model.
        model = load_model(model_file)
        counted = [
            CountedRecording(file.name, recording, model.count(recording))
            for file, recording in zip(files, map(read_recording, files), strict=True)
        ]
    protocol = Protocol(random_state=0, n_jobs=arguments.n_jobs)
    candidate = LobeModel(random_state=0)
    scores = cross_validate(candidate, training, protocol)
    lines, facts = _score_counts(counted)
    lines = [
        "Rig R1: brake rotor behind a compliant torque meter, drifting load, noise.",
        "All recordings here are SIMULATED: simulated torque, no measurement.",
        f"Trained on {origin}; model in {model_file}",
        "Counted from files (lobes counted from 1):",
        *lines,
        f"Cross-validated over {len(training)} assemblies, the same folds for both (chance 0.125):",
        *(f"  {name:34s} {score}" for name, score in scores.items()),
    ]
    facts["cross_validation"] = {name: score.to_dict() for name, score in scores.items()}
    yield Printed("\n".join(lines), facts | {"model": str(model_file)})
    write_count_report(model, counted, pages[0], settings={"model file": model_file}, most_sections=_SECTIONS)
    settings = {"files": f"none: {origin}", "options of the model": repr(candidate)}
    write_page(scores, pages[1], training, protocol, settings)
    names = list(map(str, pages))
    yield Printed(f"Pages: {', '.join(names)}  ({time.monotonic() - began:.0f} s in all)", {"pages": names})


def _score_counts(counted: list[CountedRecording]) -> tuple[list[str], dict[str, Any]]:
    """Return lines that compare each count with the truth, and the shares that are right."""
    lines = []
    n, right, exact, refused = len(counted), 0, 0, 0
    for file in counted:
        true, count = file.recording, file.count
        right += true.defect_count == count.defect_count
        refused += count.refused
        exact += set(true.worn_lobes or ()) == set(count.lobes)
        mark = "" if true.defect_count == count.defect_count else "  <- wrong"
        mark += f"  refused: {count.reason}" if count.refused else ""
        lobes = [lobes_text(worn, true.n_lobes) or "-" for worn in (true.worn_lobes, count.lobes)]
        lines.append(
            f"  {file.name:24s} true {true.defect_count} ({lobes[0]})  "
            f"predicted {count.defect_count} ({lobes[1]}){mark}"
        )
    lines.append(
        f"  counts right: {right / n:.3f}, exactly the right lobes: {exact / n:.3f}, of {n} recordings; "
        f"{refused} refused"
    )
    return lines, {
        "counts_right": right / n, "exact_lobes": exact / n, "n_refused": refused, "n_recordings": n,
    }  # fmt: skip


def _simulate_assemblies(assemblies: int, seed: int, jobs: int) -> list[Recording]:
    from cyclofeat.datasets import make_rig_recordings
    from cyclofeat.simulators import Rig

    with Progress("simulating assemblies") as progress:
        return make_rig_recordings(
            assemblies, range(8), rig=Rig.r1(), random_state=seed, n_jobs=jobs, with_angle=True,
            progress=progress,
        )  # fmt: skip
