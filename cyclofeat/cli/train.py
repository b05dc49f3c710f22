"""``cyclofeat train``: a model from labelled recordings, measured or simulated."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from cyclofeat._base.progress import Progress, Steps
from cyclofeat.cli._idle import add_idle
from cyclofeat.cli._ranges import range_of
from cyclofeat.cli._reading import READING, add_reading_options, read_all
from cyclofeat.cli._rigs import add_rig, rig_of
from cyclofeat.cli._table import Printed
from cyclofeat.cli._targets import add_target

if TYPE_CHECKING:
    from cyclofeat.counting import LobeModel
    from cyclofeat.recordings import Recording

__all__ = ["add_arguments", "printed", "run"]

_SIMULATION = (
    "--assemblies", "--windows", "--speeds", "--loads", "--max-count", "--lobes", "--kernel", "--jobs",
    "--rig", "--simulator",
)  # fmt: skip
# The rig states the rest.
_OF_FILES = tuple(option for option in READING if option not in ("--quantity", "--sampling-rate"))


# Simulated speeds and loads reach from the nominal ones over this to the nominal ones times this.
_RANGE = 1.25


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
    parser.add_argument(
        "--speeds", type=range_of("RPM"), metavar="LOW:HIGH",
        help="input speeds of the simulated assemblies in RPM, such as 100:1500 (default: 0.8 to 1.25 times "
        "the rig's)",
    )  # fmt: skip
    parser.add_argument(
        "--loads", type=range_of("Nm"), metavar="LOW:HIGH",
        help="their loads in Nm, such as 3:40 (default: 0.8 to 1.25 times the rig's)",
    )  # fmt: skip
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
    add_idle(parser, *_SIMULATION, beside=["recordings"])
    add_idle(parser, *_OF_FILES, without=["recordings"])


def run(arguments: argparse.Namespace) -> LobeModel:
    """Read or simulate recordings, train on them, and write the model."""
    from cyclofeat.counting import LobeModel
    from cyclofeat.models import save_model

    if arguments.recordings:
        recordings = read_all(arguments.recordings, arguments)
        origin = f"{len(recordings)} recordings from files"
    else:
        recordings, name = _simulated(arguments)
        origin = f"{len(recordings)} simulated assemblies of rig {name}, seed {arguments.seed}"
    with Steps() as step:
        step(f"training on {origin}")
        model = LobeModel.train(recordings, random_state=arguments.seed, description=origin)
    save_model(arguments.out, model)
    return model


def _simulated(arguments: argparse.Namespace) -> tuple[list[Recording], str]:
    """Return simulated recordings and the name of their rig."""
    from cyclofeat.datasets import make_rig_recordings
    from cyclofeat.simulators import Solver

    rig = rig_of(arguments, default="r2")
    if arguments.windows < 1:
        raise ValueError(f"--windows must be at least 1, got {arguments.windows}")
    sampling_rate = 25_600.0 if arguments.sampling_rate is None else arguments.sampling_rate
    gearbox = rig.gearbox
    with Progress("simulating assemblies") as progress:
        recordings = make_rig_recordings(
            arguments.assemblies,
            range(arguments.max_count + 1),
            rig=rig,
            lobes=arguments.lobes,
            speed_rpm=arguments.speeds or _around(60 * gearbox.input_speed_hz),
            load_nm=arguments.loads or _around(gearbox.load_torque),
            output_turns=arguments.windows,
            sampling_rate=sampling_rate,
            random_state=arguments.seed,
            n_jobs=arguments.jobs,
            with_angle=True,
            quantity=arguments.quantity or "output_torque",
            kernel=arguments.kernel,
            # Half the time of the midpoint rule; its error is far below the noise of any torque meter.
            solver=Solver(integrator="adams_bashforth"),
            progress=progress,
        )
    return recordings, rig.name


def _around(nominal: float) -> tuple[float, float]:
    """Return the default range about a nominal value."""
    return nominal / _RANGE, nominal * _RANGE


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
        f"for recordings {model.made_for()}; {located}\n"
        f"{accuracy}"
    )
    return Printed(text, {"file": arguments.out, **card})
