"""``cyclofeat simulate``: one simulated recording, written to a file."""

from __future__ import annotations

import argparse

from cyclofeat._base.progress import Progress
from cyclofeat._base.quantities import QUANTITIES
from cyclofeat.cli._options import Printed, add_target, positive_number
from cyclofeat.cli._rigs import add_machine, defects_of, gearbox_of, rig_of_machine


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_target(parser, "--out", required=True, help="file to write, .csv or .npz")
    add_machine(parser, drawn=("--rig", "--quantity motor_current"))
    parser.add_argument("--duration", type=positive_number, default=3.0, help="seconds (default 3)")
    parser.add_argument("--sampling-rate", type=positive_number, default=25_600.0, help="Hz (default 25600)")
    parser.add_argument(
        "--quantity", choices=QUANTITIES, default=QUANTITIES[0],
        help="quantity to record (default output_torque); for a current, a rig without a motor gets one",
    )  # fmt: skip
    parser.add_argument("--no-angle", action="store_true", help="do not write the shaft's angle")


def run(arguments: argparse.Namespace) -> Printed:
    from cyclofeat.datasets import make_rig_recording, write_recording
    from cyclofeat.datasets.readers import one_line
    from cyclofeat.recordings import Recording
    from cyclofeat.simulators import simulate

    defects = defects_of(arguments)
    rig = rig_of_machine(arguments)
    length = {"duration": arguments.duration, "sampling_rate": arguments.sampling_rate}
    with Progress(f"simulating {arguments.duration:g} s"):
        if rig is None:
            simulated = simulate(gearbox_of(arguments), defects, **length)
            recording = Recording.from_run(
                simulated, quantity=arguments.quantity, assembly="nominal", run="simulated"
            )
        else:
            recording = make_rig_recording(
                rig, defects, **length, quantity=arguments.quantity, random_state=arguments.random_state,
                with_angle=True,
            )  # fmt: skip
    if arguments.no_angle:
        recording = recording.replace(angle=None, angle_is_absolute=False)
    write_recording(arguments.out, recording)
    file = arguments.out
    return Printed(f"{file}: {one_line(recording)}", {"file": file, "defect_count": recording.defect_count})
