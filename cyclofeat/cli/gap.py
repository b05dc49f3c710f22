"""``cyclofeat gap``: where model and measurement disagree, all that is missing, and the corrected model."""

from __future__ import annotations

import argparse
import contextlib
from pathlib import Path
from typing import TYPE_CHECKING

from cyclofeat._base.arguments import ArgumentError
from cyclofeat._base.progress import Progress, Steps
from cyclofeat.cli._gap_check import add_check, check, printed_check
from cyclofeat.cli._gap_prepare import (
    PACKAGED,
    Prepared,
    add_preparation,
    prepare,
    printed_preparation,
    read_posterior,
)
from cyclofeat.cli._gap_printing import gap_lines
from cyclofeat.cli._idle import add_idle
from cyclofeat.cli._reading import READING, add_reading_options, option_of, read_all
from cyclofeat.cli._rigs import add_effects
from cyclofeat.cli._table import Printed
from cyclofeat.cli._targets import add_target, check_folder

if TYPE_CHECKING:
    from cyclofeat.gap import GapCheck, GapResult, GapSettings
    from cyclofeat.gap.posterior import EffectPosterior
    from cyclofeat.recordings import Recording

__all__ = ["add_arguments", "printed", "run"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "measured",
        nargs="*",
        metavar="MEASURED",
        help="recordings of one rig, or folders of them, at one or several speeds and loads",
    )
    parser.add_argument("--simulator", metavar="FILE", help="model, JSON (default: paper B's gearbox)")
    parser.add_argument(
        "--posterior",
        metavar="FILE",
        help="posterior that --prepare has learned for the model, .npz; or 'packaged' (the default): the "
        "posterior for paper B's gearbox that comes with the package",
    )
    parser.add_argument(
        "--simulated",
        metavar="FOLDER",
        help="recordings of another simulator: show where MEASURED differs from them, and name no effects",
    )
    parser.add_argument(
        "--hold-out",
        metavar="FOLDER|SHARE|speed|load",
        help="recordings on which the corrected model is judged: a folder, a share of MEASURED like 0.4, or "
        "those at the middle of at least three speeds or loads",
    )
    add_target(parser, "--out", "page", metavar="FILE", help="page to write, .html")
    add_target(
        parser,
        "--save-simulator",
        metavar="FILE",
        help="corrected model to write, .json, with the effects and sizes that the recordings leave possible",
    )
    add_check(parser)
    add_preparation(parser)
    parser.add_argument(
        "--cache", metavar="FOLDER", help="folder that keeps simulations, so that a new run resumes"
    )
    add_effects(parser)
    parser.add_argument(
        "--alpha", type=float, default=0.03, help='chance of a false "disagree" (default 0.03)'
    )
    parser.add_argument(
        "--one-assembly",
        action="store_true",
        help="all recordings are of one gearbox that was not taken apart between them",
    )
    parser.add_argument("--seed", type=int, default=0, help="seed of all simulations (default 0)")
    parser.add_argument("--jobs", type=int, default=-1, help="processes (default: all cores)")
    add_reading_options(parser)
    add_idle(
        parser, "--simulator", "--posterior", "--hold-out", "--save-simulator", "--one-assembly", "--cache",
        "--jobs", beside=["--simulated"],
    )  # fmt: skip
    add_idle(parser, "--effects-from", without=["--simulator", "--posterior"])
    add_idle(parser, "--quantity", without=["MEASURED", "--prepare"])
    add_idle(parser, *(option for option in READING if option != "--quantity"), without=["MEASURED"])


def run(arguments: argparse.Namespace) -> GapResult | GapCheck | Prepared:
    """Compare, name, correct, judge, and write report and corrected model; or only prepare, or check."""
    if arguments.cache is not None:
        check_folder("--cache", Path(arguments.cache))
    if arguments.prepare is not None:
        return prepare(arguments)
    if arguments.check:
        return check(arguments, _posterior(arguments))
    if not arguments.measured:
        raise ValueError("MEASURED must name recordings, or folders of them")
    recordings = read_all(arguments.measured, arguments)
    if arguments.simulated is None:
        result, settings = _found(arguments, recordings)
    else:
        result, settings = _compared(arguments, recordings)
    if arguments.save_simulator is not None:
        (result.posterior_rig or result.rig).to_json(arguments.save_simulator)
    if arguments.out is not None:
        from cyclofeat.report import write_gap_report

        sources = [recording.source for recording in recordings]
        with Progress("cyclofeat gap: writing the report"):
            write_gap_report(result, arguments.out, sources=sources, settings=settings)
    return result


def _found(arguments: argparse.Namespace, recordings: list[Recording]) -> tuple[GapResult, dict[str, str]]:
    """Return what the model lacks, and the settings that the page lists."""
    from cyclofeat.gap import find_gap

    posterior = _posterior(arguments)
    fitted, held_out = _split(arguments, recordings)
    with Steps("cyclofeat gap") as steps:
        result = find_gap(
            fitted, held_out, posterior=posterior, settings=_settings(arguments), progress=steps
        )
    settings = {
        "model": arguments.simulator or arguments.posterior or "paper B's gearbox",
        "effects considered": ", ".join(posterior.names_),
        "recordings": f"{len(fitted)}",
    }
    if held_out is not None:
        settings["recordings held out"] = f"{len(held_out)}"
    return result, settings


def _compared(arguments: argparse.Namespace, recordings: list[Recording]) -> tuple[GapResult, dict[str, str]]:
    """Return where the recordings differ from those of another simulator."""
    from cyclofeat.gap import compare_recordings

    simulated = read_all([arguments.simulated], arguments)
    with Progress("cyclofeat gap: comparing recordings"):
        result = compare_recordings(recordings, simulated, settings=_settings(arguments))
    return result, {
        "recordings": f"{len(recordings)}",
        "simulated recordings": f"{len(simulated)} of {arguments.simulated}",
    }


def _settings(arguments: argparse.Namespace) -> GapSettings:
    from cyclofeat.gap import GapSettings

    return GapSettings(
        alpha=arguments.alpha,
        pictures=arguments.out is not None,
        one_assembly=arguments.one_assembly,
        random_state=arguments.seed,
        n_jobs=arguments.jobs,
        cache=arguments.cache,
    )


def _posterior(arguments: argparse.Namespace) -> EffectPosterior:
    """Return the posterior named, or the one that comes with the package, of the model."""
    from cyclofeat.simulators import Rig

    posterior = read_posterior(arguments.posterior)
    if arguments.simulator is None:
        return posterior
    learned, model = posterior.world.rig, Rig.from_json(arguments.simulator)
    # Speed and load are those of the recordings; a name is no property.
    set_points = {name: getattr(learned.gearbox, name) for name in ("input_speed", "load_torque")}
    if model.replace(gearbox=model.gearbox.replace(**set_points), name=learned.name) != learned:
        packaged = arguments.posterior in (None, PACKAGED)
        raise ValueError(
            f"{'the packaged posterior' if packaged else arguments.posterior} was learned from another "
            f"model than {arguments.simulator}: write its own with --prepare FILE, and give --posterior FILE"
        )
    return posterior


def _split(
    arguments: argparse.Namespace, recordings: list[Recording]
) -> tuple[list[Recording], list[Recording] | None]:
    """Return the recordings to fit, and those to judge on."""
    from cyclofeat.gap import hold_out

    if arguments.hold_out is None:
        return recordings, None
    by: float | str = arguments.hold_out
    with contextlib.suppress(ValueError):
        by = float(by)
    if isinstance(by, str) and by not in ("speed", "load"):
        return recordings, read_all([by], arguments)
    try:
        return hold_out(recordings, by, random_state=arguments.seed)
    except ArgumentError as error:
        raise ValueError(error.spelled(_option)) from None


def _option(argument: str, rest: str) -> str:
    """Return the option of an argument of :func:`hold_out`."""
    return "--hold-out" if argument == "by" else option_of(argument, rest)


def printed(arguments: argparse.Namespace, result: GapResult | GapCheck | Prepared) -> Printed:
    from cyclofeat.gap import GapCheck

    if isinstance(result, Prepared):
        return printed_preparation(result)
    if isinstance(result, GapCheck):
        return printed_check(result)
    lines = gap_lines(result)
    if arguments.out is not None:
        lines.append(f"report: {arguments.out}")
    if arguments.save_simulator is not None:
        lines.append(f"corrected model: {arguments.save_simulator}")
    return Printed("\n".join(lines), result.to_dict())
