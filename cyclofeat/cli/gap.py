"""``cyclofeat gap``: where model and measurement disagree, the missing effect, and the corrected model."""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
from typing import TYPE_CHECKING, cast

import numpy as np

from cyclofeat._base.arguments import ArgumentError, different_names
from cyclofeat.cli._gap_printing import gap_lines
from cyclofeat.cli._idle import refuse_idle
from cyclofeat.cli._printing import note
from cyclofeat.cli._reading import add_reading_options, option_of, read_all
from cyclofeat.cli._rigs import add_effects
from cyclofeat.cli._table import Printed
from cyclofeat.cli._targets import add_target

if TYPE_CHECKING:
    from cyclofeat.gap import Comparison, GapResult, ProofRow, Windows
    from cyclofeat.gap._answer import JointGap
    from cyclofeat.recordings import Recording, Windower
    from cyclofeat.simulators import Rig

__all__ = ["add_arguments", "printed", "run"]

# Options that ask for a model.
_MODEL_ONLY = ("simulator", "hold_out", "out", "save_simulator", "cache", "effects", "one_assembly")
_VERDICTS = {
    "disagree": "model and measurement disagree",
    "equivalent": "model and measurement agree within the margins",
    "unresolved": "no disagreement found; more recordings could show one",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("measured", nargs="+", metavar="MEASURED", help="recordings, or folders of them")
    parser.add_argument(
        "--simulated",
        metavar="FOLDER",
        help="recordings of another simulator: where they and MEASURED differ, at one or several speeds and "
        "loads, is found, and nothing named",
    )
    parser.add_argument("--simulator", metavar="FILE", help="model, JSON (default: paper B's gearbox)")
    parser.add_argument(
        "--hold-out",
        metavar="FOLDER|SHARE|speed|load",
        help="recordings on which the corrected model is judged: a folder, a share of MEASURED like 0.4, or "
        "those at the middle one of at least three speeds or loads",
    )
    add_target(parser, "--out", "page", metavar="FILE", help="report to write, .html")
    add_target(parser, "--save-simulator", metavar="FILE", help="corrected model to write, .json")
    parser.add_argument(
        "--cache", metavar="FOLDER", help="folder that keeps simulations and fits, so that a new run resumes"
    )
    parser.add_argument(
        "--effects",
        metavar="NAMES",
        help="effects considered, with commas (default: all that the model can have)",
    )
    add_effects(parser)
    parser.add_argument(
        "--max-effects", type=int, default=2, choices=(1, 2), help="missing effects at most (default 2)"
    )
    parser.add_argument(
        "--alpha", type=float, default=0.03, help='chance of a false "disagree" (default 0.03)'
    )
    parser.add_argument(
        "--one-assembly",
        action="store_true",
        help="all recordings are of one gearbox that was not taken apart between them",
    )
    parser.add_argument(
        "--draws", type=int, default=60, help="simulated parameter sets per effect (default 60)"
    )
    parser.add_argument("--seed", type=int, default=0, help="of all simulations (default 0)")
    parser.add_argument("--jobs", type=int, default=-1, help="processes (default: all cores)")
    add_reading_options(parser)


def run(arguments: argparse.Namespace) -> GapResult | JointGap:
    """Compare, name, fit, judge, and write the report and the corrected model."""
    from cyclofeat import gap
    from cyclofeat.simulators import Rig, effect_library

    if arguments.simulated is not None:
        return _compared(arguments)
    library = None
    if arguments.effects is not None:
        library = different_names(arguments.effects.split(","), effect_library(), "--effects")
    model = Rig() if arguments.simulator is None else Rig.from_json(arguments.simulator)
    recordings, held_out = _split(arguments)
    comparison, windows, windows_held_out = _comparison(arguments, model, recordings, held_out)
    result = gap.find_gap(
        comparison,
        windows,
        windows_held_out,
        settings=gap.GapSettings(
            alpha=arguments.alpha,
            library=library,
            max_effects=arguments.max_effects,
            n_draws=arguments.draws,
            pictures=arguments.out is not None,
        ),
        progress=lambda text: note(f"cyclofeat gap: {text}"),
    )
    assemblies = {recording.assembly for recording in recordings}
    if not comparison.one_assembly and None not in assemblies and len(assemblies) < len(recordings):
        warning = (
            f"{len(recordings)} recordings are of {len(assemblies)} assemblies, and each counts as one of "
            "its own: differences may look surer than they are"
        )
        result = dataclasses.replace(result, warnings=(*result.warnings, warning))
    if arguments.save_simulator is not None:
        result.rig.to_json(arguments.save_simulator)
    if arguments.out is not None:
        from cyclofeat.report import write_gap_report

        settings = {
            "model": arguments.simulator or "paper B's gearbox",
            "spread between assemblies": _spread(model),
            "effects considered": "all that the model can have" if library is None else ", ".join(library),
            "parameter sets per effect": f"{arguments.draws}",
            "recordings": f"{len(recordings)}",
        }
        if held_out is not None:
            settings["recordings held out"] = f"{len(held_out)}"
        sources = [recording.source for recording in recordings]
        write_gap_report(result, arguments.out, sources=sources, settings=settings)
    return result


def _compared(arguments: argparse.Namespace) -> JointGap:
    """Return where the recordings differ from those of another simulator."""
    from cyclofeat.gap import GapSettings, compare_recordings

    refuse_idle(arguments, _MODEL_ONLY, "with --simulated")
    measured, simulated = (
        read_all(paths, arguments) for paths in (arguments.measured, [arguments.simulated])
    )
    settings = GapSettings(alpha=arguments.alpha, random_state=arguments.seed, pictures=False)
    return compare_recordings(measured, simulated, settings=settings)


def _comparison(
    arguments: argparse.Namespace,
    model: Rig,
    recordings: list[Recording],
    held_out: list[Recording] | None,
) -> tuple[Comparison, Windows, Windows | None]:
    """Return the comparison, and the windows to fit and to judge on."""
    from cyclofeat.gap import Comparison
    from cyclofeat.recordings import Windower, common_n_lobes

    speeds = {recording.input_speed_hz for recording in recordings}
    speed = speeds.pop()
    if speeds or speed is None:
        raise ValueError("the recordings must state one nominal speed between them: give --speed (RPM)")
    n_lobes = common_n_lobes([*recordings, *(held_out or [])])
    if n_lobes != model.gearbox.n_lobes:
        raise ValueError(
            f"the model's discs have {model.gearbox.n_lobes} lobes, those of the recordings {n_lobes}: give "
            "--simulator with their gearbox, or --n-lobes"
        )
    windower = Windower(input_speed_hz=speed, reduction=n_lobes)
    windows, sampling_rate = _windows(recordings, windower)
    windows_held_out = None
    if held_out is not None:
        windows_held_out, rate = _windows(held_out, windower)
        if windows.y is not None and windows_held_out.y is None:
            raise ValueError(
                "--hold-out must hold recordings that state defect_count, as those of MEASURED do"
            )
        if rate != sampling_rate:
            raise ValueError(
                "--hold-out must hold recordings with the rate of MEASURED, "
                f"{sampling_rate:g} Hz, got {rate:g} Hz"
            )
        # Compare what both parts state.
        y = None if windows.y is None else windows_held_out.y
        angle = None if windows.angle is None else windows_held_out.angle
        windows_held_out = dataclasses.replace(windows_held_out, y=y, angle=angle)
    assemblies = {recording.assembly for recording in recordings}
    one = len(recordings) > 1 and len(assemblies) == 1 and None not in assemblies
    comparison = Comparison(
        sampling_rate=sampling_rate,
        rig=model,
        duration=np.shape(windows.X)[1] / sampling_rate,
        input_speed_hz=speed,
        tachometer=windows.angle is not None,
        one_assembly=arguments.one_assembly or one,
        random_state=arguments.seed,
        n_jobs=arguments.jobs,
        cache=arguments.cache,
    )
    return comparison, windows, windows_held_out


def _windows(recordings: list[Recording], windower: Windower) -> tuple[Windows, float]:
    """Return windows, with counts and angles where all recordings have them, and their sampling rate."""
    from cyclofeat.gap import Windows

    cut = windower.windows(recordings)
    # The tachometer may have been on a disc: the angle of the input is compared.
    angles = [recording.input_angle(windower.reduction) for recording in recordings]
    known = [angle for angle in angles if angle is not None]
    angle = None
    if len(known) == len(angles):
        starts = np.round(cut.start_s * cut.sampling_rate).astype(int)
        n = cut.X.shape[1]
        angle = np.array([known[i][k : k + n] for i, k in zip(cut.recording, starts, strict=True)])
    return Windows(cut.X, cut.y, cut.recording, angle), cut.sampling_rate


def _spread(rig: Rig) -> str:
    """Say where the spread between assemblies comes from."""
    from cyclofeat.gap import MAY_DIFFER

    stated = {effect.effect_id for effect in rig.effects}
    added = [effect.effect_id for effect in MAY_DIFFER if effect.effect_id not in stated]
    if len(added) == len(MAY_DIFFER):
        return "the default prior's"
    return "the model's own" + (f", and the default prior's {', '.join(added)}" if added else "")


def _split(arguments: argparse.Namespace) -> tuple[list[Recording], list[Recording] | None]:
    """Return the recordings to fit, and those to judge on."""
    from cyclofeat.gap import hold_out

    recordings = read_all(arguments.measured, arguments)
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


def printed(arguments: argparse.Namespace, result: GapResult | JointGap) -> Printed:
    if arguments.simulated is not None:
        return Printed("\n".join(gap_lines(cast("JointGap", result))), result.to_dict())
    return _printed(arguments, cast("GapResult", result))


def _printed(arguments: argparse.Namespace, result: GapResult) -> Printed:
    from cyclofeat.simulators import effect_library

    lines = [f"{_VERDICTS[result.verdict]} (p = {result.where.p:.2g}, adjusted over all comparisons)"]
    for effect in result.effects:
        name = effect.effect_id
        lines.append(f"missing: {name} ({result.probability(name):.0%}): {effect_library()[name].summary()}")
        for row in result.parameters_of(name):
            doubt = "" if row.identifiable else "; poorly identified by these recordings"
            interval = f"({row.low:.3g} to {row.high:.3g}) {row.unit}"
            lines.append(f"  {row.name} = {row.value:.3g} {interval}{doubt}")
    if len(result.tie_group) > 1:
        lines.append(f"looks the same: {', '.join(result.tie_group[1:])}")
    if result.effects and result.next_measurement:
        lines.append(f"to be sure, measure: {result.next_measurement}")
    if result.unknown:
        lines.append("no effect of the library explains all of it")
    if result.proof is not None:
        lines.append(f"held out: {_reduction_text(result.proof.result)}")
    lines += [f"note: {warning}" for warning in result.warnings]
    if arguments.out is not None:
        lines.append(f"report: {arguments.out}")
    if arguments.save_simulator is not None:
        lines.append(f"corrected model: {arguments.save_simulator}")
    return Printed("\n".join(lines), result.to_dict())


def _reduction_text(closed: ProofRow) -> str:
    """Return how far the gap closed."""
    if np.isnan(closed.grr):
        return "too little disagreement to state how far it shrank"
    within = f" ({closed.low:.0%} to {closed.high:.0%})" if closed.low <= closed.high else ""
    return f"{closed.grr:.0%} of the gap closed{within}"
