"""``cyclofeat evaluate``: how often counters are right on assemblies that they have not seen."""

from __future__ import annotations

import argparse
import json
import sys
from typing import TYPE_CHECKING, Any

from cyclofeat._progress import Progress
from cyclofeat._reading import add_reading_options, read_all

if TYPE_CHECKING:
    from cyclofeat.counting import Evaluation
    from cyclofeat.recording import Recording, WindowSet

TEXT = "cross-validate with whole assemblies held out"
_MAIN = "lobe map"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``evaluate``."""
    parser.add_argument("files", nargs="*", metavar="FILE", help="labelled recordings or folders")
    parser.add_argument("--dataset", choices=("oedi",), help="measured gearbox vibration: load level")
    parser.add_argument("--data", help="file of the data set, outside a checkout")
    parser.add_argument("--folds", type=int, default=5)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--jobs", type=int, default=-1, help="processes that fit folds side by side (default: all cores)"
    )
    parser.add_argument(
        "--report",
        metavar="FILE.html",
        help="write a report; takes longer: calibrated probabilities and, where files state worn lobes and "
        "an absolute angle, for the lobes one by one",
    )
    add_reading_options(parser)


def run(arguments: argparse.Namespace) -> int:
    """Evaluate the counter and the papers' one on the same folds."""
    if arguments.dataset == "oedi":
        return _load_levels(arguments)
    if not arguments.files:
        raise ValueError("evaluate needs labelled recording files, or --dataset oedi")
    from cyclofeat.counting._model import common_speed
    from cyclofeat.recording import Windower, common_n_lobes

    if arguments.report:
        from cyclofeat.report._page import target_of

        target_of(arguments.report)  # found out now rather than after the folds
    recordings = read_all(arguments.files, arguments)
    speed = common_speed(recordings)
    n_lobes = common_n_lobes(recordings)
    windows = Windower(input_speed_hz=speed, reduction=n_lobes).windows(recordings)
    if windows.y is None or windows.groups is None:
        raise ValueError("evaluate needs files that state defect_count and assembly, some do not")
    assert speed is not None  # the windower would have raised
    results = _results(arguments, windows, speed, n_lobes)
    if arguments.report:
        _write_report(arguments, recordings, windows, results)
    if arguments.json:
        print(json.dumps({name: result.to_dict() for name, result in results.items()}, indent=2))
    else:
        print(f"{len(windows)} windows, folds by assembly; 95 % bootstrap intervals over assemblies")
        for name, result in results.items():
            print(f"{name:26s} {result}")
        print(f"confusion matrix of the {_MAIN} (rows true, columns predicted):")
        print(results[_MAIN].confusion)
    return 0


def _load_levels(arguments: argparse.Namespace) -> int:
    if arguments.report:
        raise ValueError("--report goes with labelled torque recordings, not with --dataset")
    from cyclofeat.counting import evaluate_load_levels
    from cyclofeat.datasets import load_oedi_gearbox

    levels = evaluate_load_levels(load_oedi_gearbox(arguments.data), random_state=arguments.seed)
    print(json.dumps(levels.to_dict(), indent=2) if arguments.json else levels.table())
    return 0


def _results(
    arguments: argparse.Namespace, windows: WindowSet, speed: float, n_lobes: int
) -> dict[str, Evaluation]:
    from cyclofeat.counting import (
        GroupCalibratedCounter,
        evaluate,
        make_entropy_counter,
        make_lobe_counter,
        passage_of_lobe_zero,
    )
    from cyclofeat.counting._model import worn_of_windows

    labels = windows.y
    assert labels is not None  # run has looked

    def evaluated(name: str, counter: Any, X: Any, **more: Any) -> Evaluation:
        return evaluate(
            counter, X, labels, windows.groups, n_splits=arguments.folds, random_state=arguments.seed,
            n_jobs=arguments.jobs, progress=Progress(name), **more,
        )  # fmt: skip

    counter = make_lobe_counter(windows.sampling_rate, input_speed_hz=speed, n_lobes=n_lobes)
    # A lobe map learns nothing from other windows: made once, it serves every fold.
    features = counter["lobe_map"].fit_transform(windows.X)
    trees = counter["trees"]
    if arguments.report:
        # As train does; it changes no count.
        trees = GroupCalibratedCounter(trees)
    results = {_MAIN: evaluated(_MAIN, trees, features)}
    worn = worn_of_windows(windows, n_lobes) if arguments.report else None
    if worn is not None:
        lobes = make_lobe_counter(windows.sampling_rate, input_speed_hz=speed, n_lobes=n_lobes, kind="lobes")
        passage = passage_of_lobe_zero(windows.start_angle, n_lobes)
        name = "lobes one by one"
        results[name] = evaluated(name, lobes, windows.X, worn=worn, passage=passage)
    name = "Shannon entropy (papers)"
    results[name] = evaluated(name, make_entropy_counter(windows.sampling_rate), windows.X)
    return results


def _write_report(
    arguments: argparse.Namespace,
    recordings: list[Recording],
    windows: WindowSet,
    results: dict[str, Evaluation],
) -> None:
    from cyclofeat.report import write_evaluation_report

    assert windows.y is not None  # checked before the folds were made
    assert windows.groups is not None
    speed = recordings[0].speed_rpm
    path = write_evaluation_report(
        arguments.report,
        results,
        windows.y,
        windows.groups,
        sources=[recording.source for recording in recordings],
        folds=f"{arguments.folds} folds, assemblies of every count shared out by the seed {arguments.seed}",
        settings={
            "files": ", ".join(arguments.files[:5]) + (", ..." if len(arguments.files) > 5 else ""),
            "recordings": len(recordings),
            "one window": f"one output turn, {windows.X.shape[1]} samples at {windows.sampling_rate:g} Hz",
            "nominal speed": f"{speed:g} RPM",
        },
    )
    print(f"report: {path}", file=sys.stderr)
