"""Options of commands that simulate: the rig, its gearbox and its worn lobes."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from cyclofeat.cli._options import Arguments, Parser, whole_number

if TYPE_CHECKING:
    from cyclofeat.simulators import LobeDefects, Rig

_RIGS = ("r0", "r1", "r2", "published")
_LOBES = ("--worn-count", "--worn-lobes", "--removed-lobes")


def add_machine(parser: Parser, *, drawn: Sequence[str] = ("--rig",)) -> None:
    """Add the options that state which gearbox is simulated, with which lobes worn.

    ``drawn`` are the options that make ``--seed`` draw something.
    """
    kind = parser.add_mutually_exclusive_group()
    kind.add_argument(
        "--worn-count", type=whole_number(0), metavar="N", help="number of worn lobes, side by side"
    )
    kind.add_argument(
        "--worn-lobes", type=_lobes_from_0, metavar="LOBES", help="worn lobes, counted from 1, like 1,5"
    )
    kind.add_argument(
        "--removed-lobes", type=_lobes_from_0, metavar="LOBES", help="removed lobes, counted from 1"
    )
    parser.add_argument(
        "--wheels", choices=("both", "1", "2"), default="both",
        help="wheels that have these lobes (default: both)",
    )  # fmt: skip
    parser.add_argument("--depth", type=float, default=1.0, help="depth of the wear, 0 to 1 (default 1)")
    parser.add_argument(
        "--wear-um", type=float, metavar="UM", help="radial wear in um, 0 to 200, in place of --depth"
    )
    parser.add_argument(
        "--material", choices=("steel", "abs"), default="steel",
        help="material of the gearbox (default: steel)",
    )  # fmt: skip
    parser.add_seed("assembly, drift and noise", default=1000)
    parser.add_idle("--depth", "--wear-um", beside=["--removed-lobes"])
    parser.add_idle("--depth", beside=["--wear-um"])
    parser.add_idle("--depth", "--wear-um", "--wheels", without=_LOBES)
    parser.add_idle("--material", beside=["--rig"])  # which states its own gearbox
    parser.add_idle("--seed", without=drawn)
    add_rig(parser, "the papers' free output without errors")


def add_rig(parser: Parser, default: str) -> None:
    parser.add_argument(
        "--rig",
        metavar="RIG",
        help="r0, r1, r2 (rigs of the toolkit), published (the statistics of published measurements), or a "
        "JSON file that describes gearbox, rig and effects, such as a corrected model of cyclofeat gap: each "
        f"assembly draws from its ranges and variants (default: {default})",
    )
    add_effects(parser)
    parser.add_idle("--effects-from", without=["--rig"])
    parser.add_idle("--effects-from", beside=[f"--rig {name}" for name in _RIGS])  # they name none


def add_effects(parser: Parser) -> None:
    parser.add_argument(
        "--effects-from", metavar="FILE.py", action="append", default=[],
        help="Python file with effects and simulators of your own, which rigs may then name "
        "(may be given several times)",
    )  # fmt: skip


def defects_of(arguments: Arguments) -> LobeDefects:
    from cyclofeat.simulators import LobeDefects

    wheels = {"both": (0, 1), "1": (0,), "2": (1,)}[arguments.wheels]
    if arguments.removed_lobes is not None:
        return LobeDefects.removed(arguments.removed_lobes, wheels=wheels)
    worn = arguments.worn_count if arguments.worn_lobes is None else arguments.worn_lobes
    if worn is None:
        return LobeDefects.healthy()
    depth = arguments.depth if arguments.wear_um is None else None
    return LobeDefects.worn(worn, wheels=wheels, depth=depth, wear_um=arguments.wear_um)


def _lobes_from_0(text: str) -> tuple[int, ...]:
    """Return lobes counted from 0, which an option counts from 1."""
    try:
        numbers = tuple(int(part) - 1 for part in text.split(","))
    except ValueError:
        numbers = ()
    if not numbers or min(numbers) < 0 or len(set(numbers)) < len(numbers):
        raise argparse.ArgumentTypeError(f"must list different lobes counted from 1, like 1,5, got {text!r}")
    return numbers


def machine_of(arguments: Arguments) -> tuple[Rig, bool]:
    """Return the rig named, or the bare gearbox; and whether parts of it are drawn by the seed."""
    from cyclofeat.simulators import CycloidalGearbox, Rig

    if arguments.rig is not None:
        return rig_of(arguments), True
    gearbox = CycloidalGearbox.abs() if arguments.material == "abs" else CycloidalGearbox.steel()
    motor = getattr(arguments, "quantity", "") == "motor_current"  # which is drawn
    return Rig(gearbox, name="nominal"), motor


def rig_of(arguments: Arguments, default: str = "") -> Rig:
    """Return the rig named or described, else the one of the name ``default``."""
    from cyclofeat.datasets import rig_preset
    from cyclofeat.simulators import Rig

    name = arguments.rig or default
    if name.lower() in _RIGS:
        return rig_preset(name)
    if not Path(name).exists():
        names = ", ".join(_RIGS)
        raise FileNotFoundError(f"--rig must be {names} or a description of a rig, no such file: {name}")
    return Rig.from_json(name)
