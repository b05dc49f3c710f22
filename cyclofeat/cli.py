"""The ``cyclofeat`` command: simulate, inspect, train, count, watch, evaluate, plan, campaign, gap, demo."""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cyclofeat import (
    __version__,
    _campaign_command,
    _gap_command,
    _inspect_command,
    _plan_command,
    _watch_command,
)
from cyclofeat._progress import Progress
from cyclofeat._reading import FILES, add_reading_options, entries, in_options, reading_arguments

if TYPE_CHECKING:
    from cyclofeat.recording import Recording
    from cyclofeat.simulators import LobeDefects, Rig

_BAD_INPUT = 2
_RIGS = {"r0": "R0", "r1": "R1", "r2": "R2", "published": "published"}


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line.

    Parameters
    ----------
    argv : sequence of str, optional
        Arguments without the program's name; default ``sys.argv[1:]``.

    Returns
    -------
    int
        0 on success, 2 for bad input (with one line on standard error that says what).
    """
    arguments = _parser().parse_args(argv)
    # Imported late: --help and --version answer at once.
    from cyclofeat.simulators import SimulationFailed

    try:
        command: Callable[[argparse.Namespace], int] = arguments.command
        return command(arguments)
    except BrokenPipeError:
        # The reader (head, less) has seen enough; nothing more may be written, not even at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except (ValueError, TypeError, OSError, ImportError, SimulationFailed) as error:
        return _fail(in_options(str(error)) if "reads" in arguments else str(error))
    except MemoryError as error:
        return _fail(f"not enough memory: {error}")
    except KeyboardInterrupt:
        print("cyclofeat: interrupted", file=sys.stderr)
        return 130


def _fail(message: str) -> int:
    print(f"cyclofeat: error: {' '.join(message.split())}", file=sys.stderr)
    return _BAD_INPUT


def _simulate(arguments: argparse.Namespace) -> int:
    from cyclofeat.datasets import one_line, write_recording
    from cyclofeat.recording import Recording
    from cyclofeat.simulators import CycloidalGearbox, simulate

    defects = _defects(arguments)
    if arguments.simulator is None and arguments.rig is None:
        gearbox = CycloidalGearbox.abs() if arguments.material == "abs" else CycloidalGearbox.steel()
        run = simulate(gearbox, defects, duration=arguments.duration, sampling_rate=arguments.sampling_rate)
        recording = Recording.from_run(run, assembly="nominal", run="simulated")
    else:
        from cyclofeat.datasets import make_rig_recording

        if arguments.material != "steel":
            raise ValueError("--material goes without --rig and --simulator: these state their own gearbox")
        recording = make_rig_recording(
            _rig(arguments),
            defects,
            duration_s=arguments.duration,
            sampling_rate=arguments.sampling_rate,
            random_state=arguments.seed,
            with_angle=True,
        )
    if arguments.no_angle:
        recording = recording.replace(angle=None, angle_is_absolute=False)
    write_recording(arguments.out, recording)
    if arguments.json:
        _print_json({"file": str(arguments.out), "defect_count": recording.defect_count})
    else:
        print(f"{arguments.out}: {one_line(recording)}")
    return 0


def _defects(arguments: argparse.Namespace) -> LobeDefects:
    from cyclofeat.simulators import LobeDefects

    wheels = {"both": (0, 1), "0": (0,), "1": (1,)}[arguments.wheels]
    if arguments.removed is not None:
        return LobeDefects.removed(_lobes(arguments.removed), wheels=wheels)
    if arguments.worn is not None:
        return LobeDefects.worn(_lobes(arguments.worn), wheels=wheels, depth=arguments.depth)
    return LobeDefects.healthy()


def _lobes(text: str) -> int | tuple[int, ...]:
    """A count ("3") or a list of lobes counted from 0 ("0,4")."""
    try:
        numbers = tuple(int(part) for part in text.split(",") if part.strip())
    except ValueError:
        numbers = ()
    if not numbers:
        raise ValueError(f"lobes must be a count like 3 or a list counted from 0 like 0,4, got {text!r}")
    return numbers[0] if "," not in text else numbers


def _rig(arguments: argparse.Namespace, default: str | None = None) -> Rig:
    from cyclofeat.datasets import rig_preset
    from cyclofeat.simulators import Rig

    if arguments.simulator is not None:
        return Rig.from_json(arguments.simulator)
    name = arguments.rig or default
    assert name is not None
    if name in _RIGS:
        return rig_preset(_RIGS[name])
    if not Path(name).exists():
        raise FileNotFoundError(
            f"--rig must be {', '.join(_RIGS)} or a description of a rig, no such file: {name}"
        )
    return Rig.from_json(name)


def _train(arguments: argparse.Namespace) -> int:
    from cyclofeat.counting import LobeModel, score_text
    from cyclofeat.datasets import make_rig_recordings
    from cyclofeat.persistence import check_model_path, save_model

    check_model_path(arguments.out)  # found out now rather than after the simulation
    if arguments.recordings:
        recordings = _read_all(arguments.recordings, arguments)
        origin = f"{len(recordings)} recordings from files"
    else:
        rig = _rig(arguments, default="r2")
        if arguments.windows < 1:
            raise ValueError(f"--windows must be at least 1, got {arguments.windows}")
        sampling_rate = arguments.sampling_rate or 25_600.0
        turn_s = rig.gearbox.n_lobes * 2 * math.pi / rig.gearbox.input_speed
        recordings = make_rig_recordings(
            arguments.assemblies,
            range(arguments.max_count + 1),
            rig=rig,
            lobes=arguments.lobes,
            duration_s=arguments.windows * math.ceil(turn_s * sampling_rate - 1e-6) / sampling_rate,
            sampling_rate=sampling_rate,
            random_state=arguments.seed,
            n_jobs=arguments.jobs,
            with_angle=True,
            progress=Progress("simulating assemblies"),
        )
        origin = f"{len(recordings)} simulated assemblies of rig {rig.name}, seed {arguments.seed}"
    print(f"training on {origin}", file=sys.stderr)
    speed = recordings[0].input_speed_hz
    model = LobeModel.train(recordings, input_speed_hz=speed, random_state=arguments.seed, description=origin)
    save_model(arguments.out, model)
    if arguments.json:
        _print_json({"file": str(arguments.out), **model.card})
    else:
        print(f"{arguments.out}: counts {model.card['classes']}, trained on {origin}")
        print(
            f"for recordings at {model.sampling_rate:g} Hz and {60 * model.input_speed_hz:g} RPM; "
            f"{'locates lobes' if model.locator is not None else 'does not locate lobes'}"
        )
        scores = model.card["cross_validation"]
        if scores is None:
            print("too few assemblies per count to cross-validate (5 needed): accuracy unknown")
        else:
            print(f"cross-validated over {scores['n_assemblies']} assemblies: {score_text(scores)}")
    return 0


def _count(arguments: argparse.Namespace) -> int:
    from cyclofeat.datasets import one_line

    model = _watch_command.read_model(arguments)
    results: list[dict[str, Any]] = []
    failed = False
    options = reading_arguments(arguments)
    for entry in entries(arguments.files):
        path = entry.path
        # One bad file must not cost the others their result.
        try:
            recording = entry.read(**options)
            if not arguments.json:
                print(f"{path}: {one_line(recording)}")
            recording = _watch_command.without_start(recording, arguments.skip)
            result = model.count(recording)
        except (ValueError, TypeError, OSError, ImportError) as error:
            failed = True
            message = in_options(" ".join(str(error).split()))
            results.append({"file": str(path), "error": message})
            _fail(message if message.startswith(str(path)) else f"{path}: {message}")
            continue
        turn = model.n_lobes / model.input_speed_hz
        # Rounding of a window to whole samples leaves a residue that is no time.
        unused = max(0.0, round(recording.duration - result.n_windows * turn, 6))
        results.append({"file": str(path), **result.to_dict(), "window_s": turn, "unused_s": unused})
        if not arguments.json:
            _print_count(results[-1])
    if arguments.json:
        _print_json(results)
    return _BAD_INPUT if failed else 0


def _print_count(result: dict[str, Any]) -> None:
    count = result["defect_count"]
    refused = f", refused: {result['reason']}" if result["refused"] else ""
    print(f"  worn lobes: {count} (probability {result['probability'][str(count)]:.2f}){refused}")
    if result["lobes"]:
        # People count from 1.
        print(f"  positions:  {', '.join(str(lobe + 1) for lobe in result['lobes'])} (counted from 1)")
    windows = f"{result['n_windows']} window{'' if result['n_windows'] == 1 else 's'}"
    length = f"one output turn ({result['window_s']:.4g} s)"
    print(f"  from {windows} of {length}, {result['unused_s']:.3g} s unused")
    for warning in result["warnings"]:
        print(f"  note: {warning}")


def _evaluate(arguments: argparse.Namespace) -> int:
    if arguments.dataset == "oedi":
        from cyclofeat.counting import evaluate_load_levels
        from cyclofeat.datasets import load_oedi_gearbox

        levels = evaluate_load_levels(load_oedi_gearbox(arguments.data), random_state=arguments.seed)
        if arguments.json:
            _print_json(levels.to_dict())
        else:
            print(levels.table())
        return 0
    if not arguments.files:
        raise ValueError("evaluate needs labelled recording files, or --dataset oedi")
    from cyclofeat.counting import evaluate, make_entropy_counter, make_lobe_counter
    from cyclofeat.recording import Windower

    recordings = _read_all(arguments.files, arguments)
    speed = recordings[0].input_speed_hz
    windows = Windower(input_speed_hz=speed).windows(recordings)
    if windows.y is None or windows.groups is None:
        raise ValueError("evaluate needs files that state defect_count and assembly, some do not")
    assert speed is not None  # the windower would have raised
    counters = {
        "lobe map": make_lobe_counter(windows.sampling_rate, input_speed_hz=speed),
        "Shannon entropy (papers)": make_entropy_counter(windows.sampling_rate),
    }
    results = {
        name: evaluate(
            counter, windows.X, windows.y, windows.groups, n_splits=arguments.folds,
            random_state=arguments.seed, progress=Progress(name),
        )
        for name, counter in counters.items()
    }  # fmt: skip
    if arguments.json:
        _print_json({name: result.to_dict() for name, result in results.items()})
    else:
        print(f"{len(windows)} windows, folds by assembly; 95 % bootstrap intervals over assemblies")
        for name, result in results.items():
            print(f"{name:26s} {result}")
        print("confusion matrix of the lobe map (rows true, columns predicted):")
        print(results["lobe map"].confusion)
    return 0


def _demo(arguments: argparse.Namespace) -> int:
    from cyclofeat._demo import run_demo

    return run_demo(Path(arguments.out), n_jobs=arguments.jobs)


def _read_all(paths: Sequence[str], arguments: argparse.Namespace) -> list[Recording]:
    options = reading_arguments(arguments)
    return [entry.read(**options) for entry in entries(paths)]


def _print_json(value: Any) -> None:
    print(json.dumps(value, indent=2))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="cyclofeat",
        description="Count and locate the worn lobes of a cycloidal disc from windows of output torque.",
    )
    parser.add_argument("--version", action="version", version=__version__)
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    simulate = _command(commands, "simulate", _simulate, "simulate one recording and write it to a file")
    simulate.add_argument("--out", required=True, help="file to write, .csv or .npz")
    kind = simulate.add_mutually_exclusive_group()
    kind.add_argument("--worn", metavar="LOBES", help="worn lobes: a count (3) or a list from 0 (0,4)")
    kind.add_argument("--removed", metavar="LOBES", help="removed lobes: a count or a list from 0")
    simulate.add_argument("--wheels", choices=("both", "0", "1"), default="both", help="wheels carrying them")
    simulate.add_argument("--depth", type=float, default=1.0, help="severity of the wear, 0 to 1")
    simulate.add_argument("--material", choices=("steel", "abs"), default="steel")
    simulate.add_argument("--duration", type=float, default=3.0, help="seconds (default 3)")
    simulate.add_argument("--sampling-rate", type=float, default=25_600.0, help="Hz (default 25600)")
    simulate.add_argument(
        "--seed", type=int, default=1000, help="of assembly, drift and noise (default 1000)"
    )
    simulate.add_argument("--no-angle", action="store_true", help="leave the shaft's angle out")
    _add_rig(simulate, "the papers' free output without errors")

    _inspect_command.add_arguments(_command(commands, "inspect", _inspect_command.run, _inspect_command.TEXT))

    train = _command(commands, "train", _train, "train a model and write it to a file")
    train.add_argument(
        "--out", required=True, help="model file to write: model.skops (safe) or model.joblib (a pickle)"
    )
    train.add_argument("recordings", nargs="*", help="labelled recordings or folders; default: simulate them")
    train.add_argument("--assemblies", type=int, default=40, help="assemblies per count (default 40)")
    train.add_argument("--windows", type=int, default=2, help="output turns of each simulated assembly (2)")
    train.add_argument("--max-count", type=int, default=7, help="largest number of worn lobes (default 7)")
    train.add_argument(
        "--lobes", choices=("consecutive", "random", "mixed"), default="consecutive",
        help="worn lobes of the simulated assemblies: neighbours (default), any, or half of each",
    )  # fmt: skip
    train.add_argument("--sampling-rate", type=float, help="Hz; of simulated recordings 25600 by default")
    train.add_argument("--seed", type=int, default=0)
    train.add_argument("--jobs", type=int, default=-1, help="processes (default: all cores)")
    _add_rig(train, "r2")
    add_reading_options(train, sampling_rate=False)

    count = _command(commands, "count", _count, "count the worn lobes of recordings")
    count.add_argument("files", nargs="+", metavar="FILE", help=FILES)
    _watch_command.add_model_options(count)
    add_reading_options(count)

    _watch_command.add_arguments(_command(commands, "watch", _watch_command.run, _watch_command.TEXT))

    evaluate = _command(commands, "evaluate", _evaluate, "cross-validate with whole assemblies held out")
    evaluate.add_argument("files", nargs="*", metavar="FILE", help="labelled recordings or folders")
    evaluate.add_argument("--dataset", choices=("oedi",), help="measured gearbox vibration: load level")
    evaluate.add_argument("--data", help="file of the data set, outside a checkout")
    evaluate.add_argument("--folds", type=int, default=5)
    evaluate.add_argument("--seed", type=int, default=0)
    add_reading_options(evaluate)

    _plan_command.add_arguments(_command(commands, "plan", _plan_command.run, _plan_command.TEXT))

    _campaign_command.add_arguments(
        _command(commands, "campaign", _campaign_command.run, _campaign_command.TEXT)
    )

    _gap_command.add_arguments(_command(commands, "gap", _gap_command.run, _gap_command.TEXT))

    demo = _command(commands, "demo", _demo, "train, write surrogate recordings, count them, report")
    demo.add_argument("--out", default="demo", help="folder to write (default: demo)")
    demo.add_argument("--jobs", type=int, default=-1, help="processes (default: all cores)")
    return parser


def _command(commands: Any, name: str, run: Callable[..., int], text: str) -> argparse.ArgumentParser:
    parser: argparse.ArgumentParser = commands.add_parser(name, help=text, description=text)
    parser.set_defaults(command=run)
    if name != "demo":
        parser.add_argument("--json", action="store_true", help="print JSON for programs")
    return parser


def _add_rig(parser: argparse.ArgumentParser, default: str) -> None:
    group = parser.add_mutually_exclusive_group()
    group.add_argument(
        "--rig",
        metavar="RIG",
        help="r0, r1, r2 (rigs of the toolkit), published (the statistics of published measurements), or a "
        f"file: the readable description of gearbox, rig and effects in JSON (default: {default})",
    )
    group.add_argument("--simulator", metavar="FILE", help="such a file too")
