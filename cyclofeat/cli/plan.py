"""``cyclofeat plan``: the length of a recording that tells N worn lobes from N + 1, or which wear shows."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from cyclofeat._base.quantities import number_of
from cyclofeat.cli._options import Printed, add_idle, positive_number, whole_number
from cyclofeat.cli._rigs import add_rig, rig_of

if TYPE_CHECKING:
    from cyclofeat.counting import MeasurementPlan

_TABULATED_RPM = 500.0
_DEPTHS_UM = (5.0, 10.0, 20.0, 50.0, 100.0, 200.0)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--worn-count", dest="worn", type=int, required=True, metavar="N",
        help="tell N worn lobes from N + 1; with --wear, N worn lobes from none",
    )  # fmt: skip
    parser.add_argument(
        "--noise", dest="noise_nm", type=positive_number, required=True, metavar="NM",
        help="rms noise of the meter, Nm",
    )  # fmt: skip
    parser.add_argument("--confidence", type=float, default=0.95, help="wanted probability (default 0.95)")
    parser.add_argument("--depth", type=float, default=1.0, help="depth of the wear, 0.1 to 1 (default 1)")
    parser.add_argument(
        "--speed", dest="speed_rpm", type=positive_number, default=_TABULATED_RPM, metavar="RPM",
        help="input speed (default 500)",
    )  # fmt: skip
    parser.add_argument(
        "--wear",
        action="store_true",
        help="find the least depth of radial wear that shows, by a short simulation",
    )
    parser.add_argument(
        "--load", dest="load_nm", type=positive_number, metavar="NM", help="load, in Nm (default: the rig's)"
    )
    parser.add_argument(
        "--turns", dest="output_turns", type=whole_number(1), default=5, metavar="N",
        help="output turns recorded (default 5)",
    )  # fmt: skip
    add_rig(parser, "r1")
    add_idle(parser, "--depth", beside=["--wear"])
    add_idle(parser, "--load", "--turns", "--rig", without=["--wear"])


def run(arguments: argparse.Namespace) -> Printed:
    from cyclofeat.counting import plan_measurement

    typed = ["worn", "noise_nm", "confidence", "depth", "speed_rpm"]
    by_simulation: dict[str, Any] = {}
    if arguments.wear:
        typed += ["load_nm", "output_turns"]
        rig = rig_of(arguments, default="r1")
        by_simulation = {"depths_um": _DEPTHS_UM, "rig": rig, "random_state": 0, "n_jobs": -1}
    plan = plan_measurement(**{name: getattr(arguments, name) for name in typed}, **by_simulation)
    if plan.depths_um is None:
        lines = _table_lines(plan)
        if arguments.speed_rpm != _TABULATED_RPM:
            table = f"the table is of {_TABULATED_RPM:g} RPM"
            lines.append(f"  note: {table}; another speed is assumed to need as many turns")
        return Printed("\n".join(lines), plan.to_dict())
    assert isinstance(plan.probability, tuple)
    shows = f"no depth up to {plan.depths_um[-1]:g} um shows"
    if plan.least_um is not None:
        up_to = "or less " if plan.least_um == plan.depths_um[0] else ""
        shows = f"radial wear shows from {plan.least_um:.3g} um {up_to}on"
    shares = ", ".join(f"{d:g} um: {p:.2f}" for d, p in zip(plan.depths_um, plan.probability, strict=True))
    at = f"{plan.noise_nm:g} Nm noise, {plan.speed_rpm:g} RPM, {plan.load_nm:g} Nm"
    lines = [
        f"{shows} with {plan.confidence:g}, {number_of(plan.worn, 'worn lobe')} or none: {at}, "
        f"{_format_length(plan.turns, plan.seconds)}",
        f"  probability of telling worn from healthy: {shares}",
        f"  by the lobe lines of {plan.assemblies} simulated assemblies of rig {plan.rig}, healthy and worn",
        "  note: an ideal detector trained for this rig; counting the lobes takes deeper wear",
    ]
    return Printed("\n".join(lines), plan.to_dict())


def _table_lines(plan: MeasurementPlan) -> list[str]:
    pair = f"{plan.worn} from {plan.worn + 1} worn lobes at {plan.noise_nm:g} Nm noise, depth {plan.depth:g}"
    if plan.turns is not None:
        lines = [f"to tell {pair}: record {_format_length(plan.turns, plan.seconds)}"]
    elif plan.confidence > plan.reachable:
        lines = [
            f"to tell {pair}: cannot be promised with {plan.confidence:g}; {plan.assemblies} simulated "
            f"assemblies can show {plan.reachable:.3f} at most"
        ]
    else:
        longest = _format_length(plan.longest_turns, plan.longest_seconds)
        lines = [
            f"to tell {pair}: the table's longest recording, {longest}, is not enough for {plan.confidence:g}"
        ]
        if plan.largest_noise_nm is not None:
            lines.append(f"  it is enough at {plan.largest_noise_nm:g} Nm noise or less")
    lines.append(f"  probability {plan.probability:.3f} on {plan.assemblies} simulated assemblies of rig R1")
    if (plan.tabulated_noise_nm, plan.tabulated_depth) != (plan.noise_nm, plan.depth):
        entry = f"noise {plan.tabulated_noise_nm:g} Nm, depth {plan.tabulated_depth:g}"
        lines.append(f"  answered by the table's next worse entry: {entry}")
    lines.append("  note: simulated, on an assumed rig that the counter was trained for; no measurement")
    return lines


def _format_length(turns: int | None, seconds: float | None) -> str:
    assert turns is not None
    assert seconds is not None
    return f"{number_of(turns, 'output turn')} ({seconds:.3g} s)"
