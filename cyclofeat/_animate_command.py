"""``cyclofeat animate``: the gearbox turning, as a page to look at."""

from __future__ import annotations

import argparse
import json
import sys
from typing import TYPE_CHECKING

from cyclofeat import _simulate_command

if TYPE_CHECKING:
    from cyclofeat.simulators import SimulationRun

TEXT = "simulate the gearbox and write a page that shows it turning, with its forces and its torque"
# Forces of every sample at the papers' rate would fill the memory while the machine settles.
_SAMPLING_RATE = 6400.0
_LONGEST = 20.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``animate``."""
    parser.add_argument("--out", required=True, metavar="FILE.html", help="page to write")
    _simulate_command.add_machine(parser)
    parser.add_argument("--duration", type=float, help="seconds of the machine (default: one output turn)")
    parser.add_argument("--frames", type=int, default=720, help="moments at which forces are shown (720)")


def run(arguments: argparse.Namespace) -> int:
    """Simulate, settled, and write the page."""
    from cyclofeat.report import write_animation
    from cyclofeat.report._page import target_of

    target_of(arguments.out)  # found out now rather than after the simulation
    shown = _simulated(arguments)
    source = "simulated" if _simulate_command.rig_of_machine(arguments) is None else "surrogate"
    path = write_animation(arguments.out, shown, frames=arguments.frames, source=source)
    found = {
        "file": str(path),
        "defect_count": shown.defects.defect_count,
        "duration_s": shown.torque_out.size / shown.sampling_rate,
        "frames": arguments.frames,
    }
    if arguments.json:
        print(json.dumps(found, indent=2))
    else:
        print(f"{path}: {found['duration_s']:.4g} s of the machine in {arguments.frames} frames")
        print("open it in a browser; it needs no network", file=sys.stderr)
    return 0


def _simulated(arguments: argparse.Namespace) -> SimulationRun:
    """The same assembly as ``simulate`` makes of these options, after its start has died away."""
    from cyclofeat.datasets._surrogate import assembly_seed
    from cyclofeat.simulators import CompositeSimulator

    rig = _simulate_command.rig_of_machine(arguments)
    gearbox = _simulate_command.gearbox_of(arguments) if rig is None else rig.gearbox
    duration = arguments.duration
    if duration is None:
        duration = gearbox.n_lobes / gearbox.input_speed_hz
    if not 0 < duration <= _LONGEST:
        raise ValueError(f"--duration must be above 0 and up to {_LONGEST:g} s, got {duration:g}")
    return CompositeSimulator(gearbox if rig is None else rig).simulate(
        _simulate_command.defects_of(arguments),
        duration=duration,
        sampling_rate=_SAMPLING_RATE,
        seed=0 if rig is None else assembly_seed(rig, arguments.seed, 0),
        start_angle=0.0 if rig is None else None,
        forces=True,
        points=True,
    )
