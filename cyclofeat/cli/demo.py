"""``cyclofeat demo``: train on simulated assemblies, count surrogate recordings from files."""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from cyclofeat._base.progress import Progress, Steps
from cyclofeat._base.quantities import lobes_text
from cyclofeat.cli._options import add_target
from cyclofeat.cli._printing import Printed
from cyclofeat.cli.evaluate import cross_validate

if TYPE_CHECKING:
    from cyclofeat.counting import Evaluation
    from cyclofeat.recordings import Recording
    from cyclofeat.report import CountedRecording

_TRAINING_SEED = 1
_FILE_SEED = 2
_SECTIONS = 4  # recordings with pictures on the page of the counts


class Demonstration(NamedTuple):
    """Files written, recordings counted from them, evaluations of counters, and time taken in s."""

    model: Path
    pages: list[Path]
    counted: list[CountedRecording]
    scores: dict[str, Evaluation]
    seconds: float


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_target(parser, "--out", "folder", default="demo", help="folder to write (default: demo)")
    parser.add_argument("--jobs", type=int, default=-1, help="processes (default: all cores)")


def run(arguments: argparse.Namespace) -> Demonstration:
    return demonstrate(Path(arguments.out), n_jobs=arguments.jobs)


def demonstrate(
    folder: Path, *, n_jobs: int = -1, training_assemblies: int = 24, file_assemblies: int = 4
) -> Demonstration:
    """Train, write surrogate recordings, count them from their files, compare counters, write the pages.

    The folder then holds ``recordings/``, ``model.skops``, ``count.html`` and ``evaluation.html``. Assemblies
    are those of each defect count: to train on, and to count from files.
    """
    from cyclofeat.counting import LobeModel, Protocol
    from cyclofeat.datasets import read_recording, write_recording
    from cyclofeat.models import load_model, save_model
    from cyclofeat.models.persistence import check_model_path
    from cyclofeat.report import CountedRecording, check_page_path, write_count_report

    began = time.monotonic()
    (folder / "recordings").mkdir(parents=True, exist_ok=True)
    # Errors now rather than after the simulation.
    model_file = check_model_path(folder / "model.skops")
    pages = [check_page_path(folder / name) for name in ("count.html", "evaluation.html")]
    training = _simulated(training_assemblies, _TRAINING_SEED, n_jobs)
    files = []
    for recording in _simulated(file_assemblies, _FILE_SEED, n_jobs):
        files.append(folder / "recordings" / f"{recording.assembly}.npz")
        write_recording(files[-1], recording)
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
        settings = {"model file": model_file}
        write_count_report(model, counted, pages[0], settings=settings, most_sections=_SECTIONS)
    protocol = Protocol(random_state=0, n_jobs=n_jobs)
    scores = cross_validate(
        LobeModel(random_state=0), training, protocol, page=pages[1], files=f"none: {origin}"
    )
    return Demonstration(model_file, pages, counted, scores, time.monotonic() - began)


def _simulated(assemblies: int, seed: int, jobs: int) -> list[Recording]:
    from cyclofeat.datasets import make_rig_recordings
    from cyclofeat.simulators import Rig

    with Progress("simulating assemblies") as progress:
        return make_rig_recordings(
            assemblies, range(8), rig=Rig.r1(), random_state=seed, n_jobs=jobs, with_angle=True,
            progress=progress,
        )  # fmt: skip


def format_result(arguments: argparse.Namespace, result: Demonstration) -> Printed:
    n = len(result.counted)
    n_assemblies = next(iter(result.scores.values())).groups.size
    lines = [
        "Rig R1: brake rotor behind a compliant torque meter, drifting load, noise.",
        "All recordings here are SURROGATE: simulated torque, no measurement.",
        f"Trained on {n_assemblies} simulated assemblies of rig R1; model in {result.model}",
        "Counted from files (lobes counted from 1):",
    ]
    right = exact = refused = 0
    for one in result.counted:
        true, counted = one.recording, one.count
        right += true.defect_count == counted.defect_count
        refused += counted.refused
        exact += set(true.worn_lobes or ()) == set(counted.lobes)
        mark = "" if true.defect_count == counted.defect_count else "  <- wrong"
        mark += f"  refused: {counted.reason}" if counted.refused else ""
        lines.append(
            f"  {one.name:24s} true {true.defect_count} ({lobes_text(true.worn_lobes) or '-'})  "
            f"predicted {counted.defect_count} ({lobes_text(counted.lobes) or '-'}){mark}"
        )
    lines += [
        f"  counts right: {right / n:.3f}, exactly the right lobes: {exact / n:.3f}, of {n} recordings; "
        f"{refused} refused",
        f"Cross-validated over {n_assemblies} assemblies, the same folds for both (chance 0.125):",
        *(f"  {name:34s} {scores}" for name, scores in result.scores.items()),
        f"Pages: {', '.join(map(str, result.pages))}  ({result.seconds:.0f} s in all)",
    ]
    facts = {
        "counts_right": right / n,
        "exact_lobes": exact / n,
        "n_refused": refused,
        "n_recordings": n,
        "cross_validation": {name: scores.to_dict() for name, scores in result.scores.items()},
        "model": str(result.model),
        "pages": [str(page) for page in result.pages],
    }
    return Printed("\n".join(lines), facts)
