"""``cyclofeat train``: a model from labelled recordings, measured or simulated."""

from __future__ import annotations

import argparse
import math
from typing import TYPE_CHECKING

from cyclofeat._base.progress import Progress
from cyclofeat.cli._idle import refuse_idle
from cyclofeat.cli._printing import note
from cyclofeat.cli._reading import READING, add_reading_options, nominal_speed, read_all
from cyclofeat.cli._rigs import add_rig, rig_of
from cyclofeat.cli._table import Printed
from cyclofeat.cli._targets import add_target

if TYPE_CHECKING:
    from cyclofeat.counting import LobeModel
    from cyclofeat.recordings import Recording

__all__ = ["add_arguments", "printed", "run"]

_SIMULATION = (
    "assemblies",
    "windows",
    "max_count",
    "lobes",
    "kernel",
    "jobs",
    "rig",
    "simulator",
    "effects_from",
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_target(
        parser, "--out", "model", required=True,
        help="model file to write: model.skops (safe) or model.joblib (a pickle)",
    )  # fmt: skip
    parser.add_argument(
        "recordings", nargs="*", help="labelled recordings or folders (default: simulated ones)"
    )
    parser.add_argument("--assemblies", type=int, default=40, help="assemblies per count (default 40)")
    parser.add_argument("--windows", type=int, default=2, help="output turns of each simulated assembly (2)")
    parser.add_argument("--max-count", type=int, default=7, help="largest number of worn lobes (default 7)")
    parser.add_argument(
        "--lobes", choices=("consecutive", "random", "mixed"), default="consecutive",
        help="worn lobes of the simulated assemblies: neighbours (default), any, or half of each",
    )  # fmt: skip
    parser.add_argument(
        "--sampling-rate", type=float, metavar="HZ", help="in Hz; of simulated recordings 25600 by default"
    )
    parser.add_argument("--seed", type=int, default=0, help="of simulation and training (default 0)")
    parser.add_argument(
        "--kernel", choices=("exact", "batch", "auto"), default="auto",
        help="of the simulation: many assemblies at once in single precision where that is possible (auto, "
        "default; batch makes it an error where it is not), or one by one in double precision (exact)",
    )  # fmt: skip
    parser.add_argument("--jobs", type=int, default=-1, help="threads of the simulation (default: all cores)")
    add_rig(parser, "r2")
    add_reading_options(parser, sampling_rate=False)


def run(arguments: argparse.Namespace) -> LobeModel:
    """Read or simulate recordings, train on them, and write the model."""
    from cyclofeat.counting import LobeModel
    from cyclofeat.models import save_model

    if arguments.recordings:
        refuse_idle(arguments, _SIMULATION, "with recordings from files")
        recordings = read_all(arguments.recordings, arguments)
        nominal_speed(recordings)  # an error that names the option
        origin = f"{len(recordings)} recordings from files"
    else:
        recordings, name = _simulated(arguments)
        origin = f"{len(recordings)} simulated assemblies of rig {name}, seed {arguments.seed}"
    note(f"training on {origin}")
    model = LobeModel.train(recordings, random_state=arguments.seed, description=origin)
    save_model(arguments.out, model)
    return model


def _simulated(arguments: argparse.Namespace) -> tuple[list[Recording], str]:
    """Return simulated recordings and the name of their rig."""
    from cyclofeat.datasets import make_rig_recordings
    from cyclofeat.simulators import Solver

    refuse_idle(arguments, READING, "without recordings: it is the rig's")
    rig = rig_of(arguments, default="r2")
    if arguments.windows < 1:
        raise ValueError(f"--windows must be at least 1, got {arguments.windows}")
    sampling_rate = 25_600.0 if arguments.sampling_rate is None else arguments.sampling_rate
    turn = rig.gearbox.n_lobes * 2 * math.pi / rig.gearbox.input_speed  # s
    recordings = make_rig_recordings(
        arguments.assemblies,
        range(arguments.max_count + 1),
        rig=rig,
        lobes=arguments.lobes,
        duration=arguments.windows * math.ceil(turn * sampling_rate - 1e-6) / sampling_rate,
        sampling_rate=sampling_rate,
        random_state=arguments.seed,
        n_jobs=arguments.jobs,
        with_angle=True,
        kernel=arguments.kernel,
        # Half the time of the midpoint rule; its error is far below the noise of any torque meter.
        solver=Solver(integrator="adams_bashforth"),
        progress=Progress("simulating assemblies"),
    )
    return recordings, rig.name


def printed(arguments: argparse.Namespace, model: LobeModel) -> Printed:
    from cyclofeat.counting import score_text

    card = model.card
    located = "locates lobes"
    if model.locator is None:
        located = "does not locate lobes (not all state worn_lobes and an absolute angle)"
    scores = card["cross_validation"]
    if scores is None:
        accuracy = "too few assemblies per count to cross-validate (5 needed): accuracy unknown"
    else:
        accuracy = f"cross-validated over {scores['n_assemblies']} assemblies: {score_text(scores)}"
    text = (
        f"{arguments.out}: counts {card['classes']}, trained on {card['description']}\n"
        f"for recordings at {model.sampling_rate:g} Hz and {60 * model.input_speed_hz:g} RPM; {located}\n"
        f"{accuracy}"
    )
    return Printed(text, {"file": arguments.out, **card})
