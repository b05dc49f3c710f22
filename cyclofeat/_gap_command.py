"""``cyclofeat gap``: where model and measurement disagree, what is missing, and the corrected model."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cyclofeat._reading import add_reading_options, entries, reading_arguments

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from cyclofeat.gap import DiscrepancyWorkflow, NuisancePrior
    from cyclofeat.recording import Recording
    from cyclofeat.simulators import CompositeSimulator

TEXT = "find where model and measurement disagree, name what is missing, correct the model"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("measured", nargs="+", metavar="MEASURED", help="recordings, or folders of them")
    parser.add_argument("--simulator", metavar="FILE", help="model, JSON (default: paper B's gearbox)")
    parser.add_argument(
        "--hold-out",
        metavar="FOLDER|SHARE",
        help="recordings on which the corrected model is judged: a folder, or a share of MEASURED like 0.4",
    )
    parser.add_argument("--out", metavar="FILE", help="report to write, .html")
    parser.add_argument("--save-simulator", metavar="FILE", help="corrected model to write, .json")
    parser.add_argument("--cache", metavar="FOLDER", help="keeps simulations and fits; a new run goes on")
    parser.add_argument("--effects", metavar="NAMES", help="effects considered, with commas (default: all)")
    parser.add_argument("--max-effects", type=int, default=2, choices=(1, 2))
    parser.add_argument("--alpha", type=float, default=0.03, help='chance of a false "disagree"')
    parser.add_argument(
        "--one-assembly",
        action="store_true",
        help="all recordings are of one gearbox that was not taken apart between them",
    )
    parser.add_argument("--draws", type=int, default=60, help="simulated parameter sets per effect")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=-1, help="processes (default: all cores)")
    add_reading_options(parser)


def run(arguments: argparse.Namespace) -> int:
    """Run the command.

    Parameters
    ----------
    arguments : argparse.Namespace

    Returns
    -------
    int
        0.

    Raises
    ------
    ValueError, TypeError, OSError, ImportError
        For files that cannot be read or written, and as :class:`cyclofeat.gap.DiscrepancyWorkflow`.
    """
    from cyclofeat.gap import DiscrepancyWorkflow
    from cyclofeat.recording import Windower, common_n_lobes
    from cyclofeat.simulators import CompositeSimulator

    for option in ("out", "save_simulator"):
        path = getattr(arguments, option)
        if path is not None and not Path(path).parent.is_dir():
            raise FileNotFoundError(
                f"folder {Path(path).parent} for --{option.replace('_', '-')} does not exist"
            )
    if arguments.out is not None:
        from cyclofeat.report._page import environment, target_of

        target_of(arguments.out)  # found out now rather than after hours
        environment()
    library = _library(arguments.effects)
    fit, hold = _split(arguments)
    speeds = {recording.input_speed_hz for recording in fit}
    if len(speeds) != 1 or None in speeds:
        raise ValueError("the recordings must state one nominal speed between them: give --speed (RPM)")
    (speed,) = speeds
    assert speed is not None
    n_lobes = common_n_lobes([*fit, *(hold or [])])
    simulator = None if arguments.simulator is None else CompositeSimulator.from_json(arguments.simulator)
    nuisance = _own_spread(simulator)
    of_model = (simulator or CompositeSimulator()).to_rig().gearbox.n_lobes
    if n_lobes != of_model:
        raise ValueError(
            f"the model's discs have {of_model} lobes, those of the recordings {n_lobes}: give --simulator "
            "with their gearbox, or --n-lobes"
        )
    windower = Windower(input_speed_hz=speed, reduction=n_lobes)
    given = _windows(windower, fit)
    held = None if hold is None else _windows(windower, hold)
    if held is not None and given["y"] is not None and held["y"] is None:
        raise ValueError("--hold-out must hold recordings that state defect_count, as those of MEASURED do")
    if held is not None and held["rate"] != given["rate"]:
        rates = f"{given['rate']:g} Hz, got {held['rate']:g} Hz"
        raise ValueError(f"--hold-out must hold recordings with the rate of MEASURED, {rates}")
    stated = {recording.assembly for recording in fit}
    one_assembly = arguments.one_assembly or (len(fit) > 1 and len(stated) == 1 and None not in stated)
    workflow = DiscrepancyWorkflow(
        given["rate"],
        simulator,
        nuisance,
        input_speed_hz=speed,
        alpha=arguments.alpha,
        one_assembly=one_assembly,
        library=library,
        max_effects=arguments.max_effects,
        n_draws=arguments.draws,
        random_state=arguments.seed,
        n_jobs=arguments.jobs,
        cache=arguments.cache,
        progress=lambda text: print(f"cyclofeat gap: {text}", file=sys.stderr, flush=True),
    )
    workflow.fit(
        given["X"],
        None if held is None else held["X"],
        y_fit=given["y"],
        groups_fit=given["groups"],
        angle_fit=given["angle"],
        y_hold=None if held is None or given["y"] is None else held["y"],
        groups_hold=None if held is None else held["groups"],
        angle_hold=None if held is None or given["angle"] is None else held["angle"],
    )
    if not one_assembly and None not in stated and len(stated) < len(fit):
        workflow.result_["warnings"].append(
            f"{len(fit)} recordings are of {len(stated)} assemblies, and each counts as one of its own: "
            "differences may look surer than they are"
        )
    if arguments.save_simulator is not None:
        workflow.simulator_.to_json(arguments.save_simulator)
    if arguments.out is not None:
        settings = {
            "model": arguments.simulator or "paper B's gearbox",
            "spread between assemblies": "the default prior's" if nuisance is None else "the model's own",
            "effects considered": "all" if library is None else ", ".join(library),
            "parameter sets per effect": f"{arguments.draws}",
            "recordings": f"{len(fit)}",
        }
        if hold is not None:
            settings["recordings held out"] = f"{len(hold)}"
        workflow.to_html(arguments.out, sources=[recording.source for recording in fit], settings=settings)
    if arguments.json:
        print(json.dumps(workflow.result_, indent=2))
    else:
        print(text_of(workflow))
        for option, word in (("out", "report"), ("save_simulator", "corrected model")):
            if getattr(arguments, option) is not None:
                print(f"{word}: {getattr(arguments, option)}")
    return 0


def _library(effects: str | None) -> list[str] | None:
    from cyclofeat.gap._names import different_names
    from cyclofeat.simulators import effect_library

    return (
        None if effects is None else list(different_names(effects.split(","), effect_library(), "--effects"))
    )


def _own_spread(simulator: CompositeSimulator | None) -> NuisancePrior | None:
    """The spread between assemblies that a rig's file states, as what may differ without being missing."""
    from cyclofeat.gap import NuisancePrior

    own = None if simulator is None else simulator.to_rig().tolerances
    return NuisancePrior(tolerances=own) if own is not None and own.has_spread else None


def text_of(workflow: DiscrepancyWorkflow) -> str:
    """The result in a few lines."""
    from cyclofeat.simulators import effect_library

    result = workflow.result_
    words = {
        "disagree": "model and measurement disagree",
        "equivalent": "model and measurement agree within the margins",
        "unresolved": "no disagreement found; more recordings could show one",
    }
    lines = [f"{words[result['verdict']]} (p = {result['p']:.2g}, adjusted over all comparisons)"]
    for effect in result["effects"]:
        kind = effect_library()[effect["id"]]
        lines.append(f"missing: {effect['id']} ({effect['probability']:.0%}): {kind.summary()}")
        for name, value in effect["theta"].items():
            low, high = effect["interval"][name]
            unit = kind.parameters[name].unit
            doubt = "" if effect["identifiable"][name] else "; these recordings hardly tell it"
            lines.append(f"  {name} = {value:.3g} ({low:.3g} to {high:.3g}) {unit}{doubt}")
    if len(result["tie_group"]) > 1:
        lines.append(f"looks the same: {', '.join(result['tie_group'][1:])}")
    if result["effects"] and result["next_measurement"]:
        lines.append(f"to be sure, measure: {result['next_measurement']}")
    if result["unknown"]:
        lines.append("no effect of the library explains all of it")
    if result["grr"] is not None:
        grr = result["grr"]["all"]
        if grr is None:
            lines.append("held out: too little disagreement to state how far it shrank")
        else:
            low, high = result["grr"].get("ci", (float("nan"),) * 2)
            within = f" ({low:.0%} to {high:.0%})" if low <= high else ""
            lines.append(f"held out: {grr:.0%} of the gap closed{within}")
    return "\n".join([*lines, *(f"note: {warning}" for warning in result["warnings"])])


def _split(arguments: argparse.Namespace) -> tuple[list[Recording], list[Recording] | None]:
    """Recordings to fit and to judge on."""
    options = reading_arguments(arguments)
    recordings = _read(arguments.measured, options)
    if arguments.hold_out is None:
        return recordings, None
    try:
        share = float(arguments.hold_out)
    except ValueError:
        return recordings, _read([arguments.hold_out], options)
    if not 0 < share < 1:
        raise ValueError(f"--hold-out must be a folder or a share between 0 and 1, got {arguments.hold_out}")
    # An assembly is held out as a whole.
    known = all(recording.assembly is not None for recording in recordings)
    assemblies: dict[Any, list[int]] = {}
    for i, recording in enumerate(recordings):
        assemblies.setdefault(recording.assembly if known else i, []).append(i)
    # Every count gives its share, so that both parts hold the same classes.
    random = np.random.default_rng(arguments.seed)
    by_count: dict[Any, list[list[int]]] = {}
    for members in [list(assemblies.values())[k] for k in random.permutation(len(assemblies))]:
        by_count.setdefault(tuple({recordings[i].defect_count for i in members}), []).append(members)
    order = [members for alike in by_count.values() for members in alike]
    held = {i for k in range(int(share * len(order))) for i in order[int(k / share)]}
    if not held or len(held) == len(recordings):
        raise ValueError(
            f"--hold-out {share:g} leaves {len(recordings) - len(held)} of {len(recordings)} recordings to "
            f"fit, of {len(assemblies)} assemblies each held out as a whole: more are needed"
        )
    parts = [[r for i, r in enumerate(recordings) if (i in held) == inside] for inside in (False, True)]
    return parts[0], parts[1]


def _read(paths: Sequence[str], options: dict[str, Any]) -> list[Recording]:
    return [entry.read(**options) for entry in entries(paths)]


def _windows(windower: Any, recordings: list[Recording]) -> dict[str, Any]:
    """Windows, the recording of each, counts and angles where all recordings have them."""
    cut = windower.windows(recordings)
    angle: NDArray[np.float64] | None = None
    # The tachometer may have been on a disc: what is compared is the input's angle.
    angles = [
        turned
        for recording in recordings
        if (turned := recording.input_angle(windower.reduction)) is not None
    ]
    if len(angles) == len(recordings):
        n = cut.X.shape[1]
        starts = np.round(cut.start_s * cut.sampling_rate).astype(int)
        angle = np.array([angles[i][k : k + n] for i, k in zip(cut.recording, starts, strict=True)])
    return {"X": cut.X, "y": cut.y, "groups": cut.recording, "angle": angle, "rate": cut.sampling_rate}
