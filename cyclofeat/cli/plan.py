"""``cyclofeat plan``: the length of a recording that tells N worn lobes from N + 1, or which wear shows."""

from __future__ import annotations

from typing import Any

from cyclofeat.cli._options import Arguments, Parser, Printed, positive, whole_number
from cyclofeat.cli._rigs import add_rig, rig_of

_TABULATED_RPM = 500.0
_DEPTHS_UM = (5.0, 10.0, 20.0, 50.0, 100.0, 200.0)


def add_arguments(parser: Parser) -> None:
    parser.add_argument(
        "--worn-count", dest="worn", type=int, required=True, metavar="N",
        help="tell N worn lobes from N + 1; with --wear, N worn lobes from none",
    )  # fmt: skip
    parser.add_argument(
        "--noise", dest="noise_nm", type=positive, required=True, metavar="NM",
        help="rms noise of the meter, Nm",
    )  # fmt: skip
    parser.add_argument("--confidence", type=float, default=0.95, help="wanted probability (default 0.95)")
    parser.add_argument("--depth", type=float, default=1.0, help="depth of the wear, 0.1 to 1 (default 1)")
    parser.add_argument(
        "--speed", dest="speed_rpm", type=positive, default=_TABULATED_RPM, metavar="RPM",
        help="input speed (default 500)",
    )  # fmt: skip
    parser.add_argument(
        "--wear",
        action="store_true",
        help="find the least depth of radial wear that shows, by a short simulation",
    )
    parser.add_argument(
        "--load", dest="load_nm", type=positive, metavar="NM", help="load, in Nm (default: the rig's)"
    )
    parser.add_argument(
        "--turns", dest="output_turns", type=whole_number(1), default=5, metavar="N",
        help="output turns recorded (default 5)",
    )  # fmt: skip
    add_rig(parser, "r1")
    parser.add_idle("--depth", beside=["--wear"])
    parser.add_idle("--load", "--turns", "--rig", without=["--wear"])


def run(arguments: Arguments) -> Printed:
    from cyclofeat.counting import plan_measurement

    typed = ["worn", "noise_nm", "confidence", "depth", "speed_rpm"]
    by_simulation: dict[str, Any] = {}
    if arguments.wear:
        typed += ["load_nm", "output_turns"]
        rig = rig_of(arguments, default="r1")
        by_simulation = {"depths_um": _DEPTHS_UM, "rig": rig, "random_state": 0, "n_jobs": -1}
    plan = plan_measurement(**{name: getattr(arguments, name) for name in typed}, **by_simulation)
    lines = [str(plan)]
    if plan.depths_um is None and arguments.speed_rpm != _TABULATED_RPM:
        table = f"the table is of {_TABULATED_RPM:g} RPM"
        lines.append(f"  note: {table}; another speed is assumed to need as many turns")
    return Printed("\n".join(lines), plan.to_dict())
