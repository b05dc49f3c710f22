"""``cyclofeat evaluate``: how often counters are right on assemblies that they have not seen."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cyclofeat._base.progress import Progress
from cyclofeat.cli._options import add_reading_options, add_target, read_all
from cyclofeat.cli._printing import Printed, note

if TYPE_CHECKING:
    from cyclofeat.counting import Evaluation, Protocol
    from cyclofeat.recordings import Recording

_MAIN, _BY_LOBE, _PAPERS = "lobe map", "lobes one by one", "Shannon entropy (papers)"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("files", nargs="*", metavar="FILE", help="labelled recordings or folders")
    parser.add_argument("--folds", type=int, default=5, help="number of folds (default 5)")
    parser.add_argument("--seed", type=int, default=0, help="seed of folds and counters (default 0)")
    parser.add_argument(
        "--jobs", type=int, default=-1, help="processes that fit folds side by side (default: all cores)"
    )
    add_target(
        parser,
        "--report",
        "page",
        metavar="FILE.html",
        help="page to write; takes longer: it has calibrated probabilities and, where files state worn lobes "
        "and an absolute angle, results for each lobe",
    )
    add_reading_options(parser)


def run(arguments: argparse.Namespace) -> dict[str, Evaluation]:
    """Evaluate the lobe counter and the papers' best feature on the same folds."""
    if not arguments.files:
        raise ValueError("evaluate needs labelled recording files")
    from cyclofeat.counting import Protocol

    protocol = Protocol(n_splits=arguments.folds, random_state=arguments.seed, n_jobs=arguments.jobs)
    recordings = read_all(arguments.files, arguments)
    files = ", ".join(arguments.files[:5]) + (", ..." if len(arguments.files) > 5 else "")
    thorough = bool(arguments.report)
    return cross_validated(recordings, protocol, page=arguments.report, files=files, thorough=thorough)


def cross_validated(
    recordings: Sequence[Recording],
    protocol: Protocol,
    *,
    page: str | Path | None,
    files: str,
    thorough: bool = False,
) -> dict[str, Evaluation]:
    """Return the evaluation of each counter on the same folds of the same windows; write the report ``page``.

    Recordings state ``assembly`` and ``defect_count``; ``files`` are those that were read. If ``thorough``,
    the probabilities are calibrated too and, where all recordings state worn lobes and an absolute angle, the
    counter that locates lobes is scored.
    """
    from cyclofeat.counting import (
        GroupCalibratedCounter,
        evaluate,
        make_entropy_counter,
        make_lobe_counter,
        passage_of_lobe_zero,
    )
    from cyclofeat.recordings import Windower
    from cyclofeat.recordings.recording import common_n_lobes, common_speed

    speed, n_lobes = common_speed(recordings), common_n_lobes(recordings)
    if speed is None:
        raise ValueError("the recordings state no nominal speed: give --speed (RPM)")
    windows = Windower(input_speed_hz=speed, reduction=n_lobes).windows(recordings)
    labels = windows.y
    if labels is None or windows.groups is None:
        raise ValueError("evaluate needs files that state defect_count and assembly, some do not")
    results: dict[str, Evaluation] = {}

    def add(name: str, counter: Any, X: Any, **more: Any) -> None:
        with Progress(name) as progress:
            timed = replace(protocol, progress=progress)
            results[name] = evaluate(counter, X, labels, windows.groups, protocol=timed, **more)

    machine: dict[str, Any] = {"input_speed_hz": speed, "n_lobes": n_lobes}
    counter = make_lobe_counter(windows.sampling_rate, **machine)
    # A lobe map learns nothing from other windows: made once, it serves every fold.
    with Progress("mapping lobes"):
        features = counter["lobe_map"].fit_transform(windows.X)
    # Calibrated as train does; it changes no count.
    add(_MAIN, GroupCalibratedCounter(counter["trees"]) if thorough else counter["trees"], features)
    worn = windows.worn_table(n_lobes) if thorough else None
    if worn is not None:
        by_lobe = make_lobe_counter(windows.sampling_rate, **machine, kind="lobes")
        passage = passage_of_lobe_zero(windows.start_angle, n_lobes)
        add(_BY_LOBE, by_lobe, windows.X, lobes=(worn, passage))
    add(_PAPERS, make_entropy_counter(windows.sampling_rate), windows.X)
    if page is not None:
        from cyclofeat.report import write_evaluation_report

        n_splits, seed = protocol.n_splits, protocol.random_state
        n_samples = windows.X.shape[1]
        with Progress("writing the report"):
            written = write_evaluation_report(
                results,
                page,
                sources=[recording.source for recording in recordings],
                folds=f"{n_splits} folds, assemblies of every count shared out by the seed {seed}",
                settings={
                    "files": files,
                    "recordings": len(recordings),
                    "one window": f"one output turn, {n_samples} samples at {windows.sampling_rate:g} Hz",
                    "nominal speed": f"{60 * speed:g} RPM",
                    f"probabilities of the {_MAIN}": ("" if thorough else "not ") + "calibrated",
                },
            )
        note(f"report: {written}")
    return results


def printed(arguments: argparse.Namespace, results: dict[str, Evaluation]) -> Printed:
    main = results[_MAIN]
    n_windows = main.labels.size
    lines = [f"{n_windows} windows, folds by assembly; 95 % bootstrap intervals over assemblies"]
    lines += [f"{name:26s} {scores}" for name, scores in results.items()]
    lines.append(f"confusion matrix of the {_MAIN} (rows true, columns predicted):")
    lines.append(str(main.confusion))
    return Printed("\n".join(lines), {name: scores.to_dict() for name, scores in results.items()})
