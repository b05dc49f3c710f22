"""``cyclofeat simulate``: one recording of a gearbox, and the options that say which gearbox."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from cyclofeat.simulators import CycloidalGearbox, LobeDefects, Rig

TEXT = "simulate one recording and write it to a file"
_RIGS = ("r0", "r1", "r2", "published")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``simulate``."""
    parser.add_argument("--out", required=True, help="file to write, .csv or .npz")
    add_machine(parser)
    parser.add_argument("--duration", type=float, default=3.0, help="seconds (default 3)")
    parser.add_argument("--sampling-rate", type=float, default=25_600.0, help="Hz (default 25600)")
    parser.add_argument("--no-angle", action="store_true", help="leave the shaft's angle out")


def add_machine(parser: argparse.ArgumentParser) -> None:
    """Add what says which gearbox is simulated, with which lobes worn."""
    kind = parser.add_mutually_exclusive_group()
    kind.add_argument("--worn", metavar="LOBES", help="worn lobes: a count (3) or a list from 0 (0,4)")
    kind.add_argument("--removed", metavar="LOBES", help="removed lobes: a count or a list from 0")
    parser.add_argument("--wheels", choices=("both", "0", "1"), default="both", help="wheels carrying them")
    parser.add_argument("--depth", type=float, default=1.0, help="severity of the wear, 0 to 1")
    parser.add_argument("--material", choices=("steel", "abs"), default="steel")
    parser.add_argument("--seed", type=int, default=1000, help="of assembly, drift and noise (default 1000)")
    add_rig(parser, "the papers' free output without errors")


def add_rig(parser: argparse.ArgumentParser, default: str) -> None:
    """Add what names a rig."""
    group = parser.add_mutually_exclusive_group()
    group.add_argument(
        "--rig",
        metavar="RIG",
        help="r0, r1, r2 (rigs of the toolkit), published (the statistics of published measurements), or a "
        f"file: the readable description of gearbox, rig and effects in JSON (default: {default})",
    )
    group.add_argument("--simulator", metavar="FILE", help="such a file too")


def run(arguments: argparse.Namespace) -> int:
    """Simulate, write, and say what was written."""
    from cyclofeat.datasets import one_line, write_recording
    from cyclofeat.recording import Recording
    from cyclofeat.simulators import simulate

    defects = defects_of(arguments)
    rig = rig_of_machine(arguments)
    if rig is None:
        gearbox = gearbox_of(arguments)
        run = simulate(gearbox, defects, duration=arguments.duration, sampling_rate=arguments.sampling_rate)
        recording = Recording.from_run(run, assembly="nominal", run="simulated")
    else:
        from cyclofeat.datasets import make_rig_recording

        recording = make_rig_recording(
            rig,
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
        print(json.dumps({"file": str(arguments.out), "defect_count": recording.defect_count}, indent=2))
    else:
        print(f"{arguments.out}: {one_line(recording)}")
    return 0


def defects_of(arguments: argparse.Namespace) -> LobeDefects:
    """Worn or removed lobes."""
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


def gearbox_of(arguments: argparse.Namespace) -> CycloidalGearbox:
    """The papers' gearbox of the material asked for."""
    from cyclofeat.simulators import CycloidalGearbox

    return CycloidalGearbox.abs() if arguments.material == "abs" else CycloidalGearbox.steel()


def rig_of_machine(arguments: argparse.Namespace) -> Rig | None:
    """The rig named; None for the bare gearbox."""
    if arguments.simulator is None and arguments.rig is None:
        return None
    if arguments.material != "steel":
        raise ValueError("--material goes without --rig and --simulator: these state their own gearbox")
    return rig_of(arguments)


def rig_of(arguments: argparse.Namespace, default: str | None = None) -> Rig:
    """The rig named or described, else the one of the name ``default``."""
    from cyclofeat.datasets import rig_preset
    from cyclofeat.simulators import Rig

    if arguments.simulator is not None:
        return Rig.from_json(arguments.simulator)
    name = arguments.rig or default
    assert name is not None
    if name.lower() in _RIGS:
        return rig_preset(name)
    if not Path(name).exists():
        raise FileNotFoundError(
            f"--rig must be {', '.join(_RIGS)} or a description of a rig, no such file: {name}"
        )
    return Rig.from_json(name)
