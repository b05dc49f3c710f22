"""The ``cyclofeat`` command."""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from cyclofeat import (
    __version__,
    _animate_command,
    _campaign_command,
    _count_command,
    _evaluate_command,
    _gap_command,
    _inspect_command,
    _plan_command,
    _simulate_command,
    _watch_command,
)
from cyclofeat._progress import Progress
from cyclofeat._reading import add_reading_options, in_options, read_all

_BAD_INPUT = 2


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


def _train(arguments: argparse.Namespace) -> int:
    from cyclofeat.counting import LobeModel, score_text
    from cyclofeat.datasets import make_rig_recordings
    from cyclofeat.persistence import check_model_path, save_model

    check_model_path(arguments.out)  # found out now rather than after the simulation
    if arguments.recordings:
        recordings = read_all(arguments.recordings, arguments)
        origin = f"{len(recordings)} recordings from files"
    else:
        rig = _simulate_command.rig_of(arguments, default="r2")
        if arguments.windows < 1:
            raise ValueError(f"--windows must be at least 1, got {arguments.windows}")
        sampling_rate = 25_600.0 if arguments.sampling_rate is None else arguments.sampling_rate
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
    model = LobeModel.train(recordings, random_state=arguments.seed, description=origin)
    save_model(arguments.out, model)
    if arguments.json:
        _print_json({"file": str(arguments.out), **model.card})
    else:
        print(f"{arguments.out}: counts {model.card['classes']}, trained on {origin}")
        located = "locates lobes"
        if model.locator is None:
            located = "does not locate lobes (not all state worn_lobes and an absolute angle)"
        speed_rpm = 60 * model.input_speed_hz
        print(f"for recordings at {model.sampling_rate:g} Hz and {speed_rpm:g} RPM; {located}")
        scores = model.card["cross_validation"]
        if scores is None:
            print("too few assemblies per count to cross-validate (5 needed): accuracy unknown")
        else:
            print(f"cross-validated over {scores['n_assemblies']} assemblies: {score_text(scores)}")
    return 0


def _demo(arguments: argparse.Namespace) -> int:
    from cyclofeat._demo import run_demo

    return run_demo(Path(arguments.out), n_jobs=arguments.jobs)


def _print_json(value: Any) -> None:
    print(json.dumps(value, indent=2))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="cyclofeat",
        description="Count and locate the worn lobes of a cycloidal disc from windows of output torque.",
    )
    parser.add_argument("--version", action="version", version=__version__)
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    _simulate_command.add_arguments(
        _command(commands, "simulate", _simulate_command.run, _simulate_command.TEXT)
    )

    _animate_command.add_arguments(_command(commands, "animate", _animate_command.run, _animate_command.TEXT))

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
    _simulate_command.add_rig(train, "r2")
    add_reading_options(train, sampling_rate=False)

    _count_command.add_arguments(_command(commands, "count", _count_command.run, _count_command.TEXT))

    _watch_command.add_arguments(_command(commands, "watch", _watch_command.run, _watch_command.TEXT))

    _evaluate_command.add_arguments(
        _command(commands, "evaluate", _evaluate_command.run, _evaluate_command.TEXT)
    )

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
