"""``cyclofeat simulate``: simulated recordings, one in a file or many in a folder with their manifest."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from cyclofeat._base.progress import Progress
from cyclofeat._base.quantities import QUANTITIES, number_of
from cyclofeat.cli._options import Arguments, Parser, Printed, list_of, positive, range_of, whole_number
from cyclofeat.cli._rigs import add_machine, defects_of, machine_of, rig_of

if TYPE_CHECKING:
    from cyclofeat.recordings import Recording


def add_arguments(parser: Parser) -> None:
    parser.add_target(
        "--out", "recordings", required=True,
        help="file to write, .csv or .npz; with --count, a folder, with a manifest recordings.csv",
    )  # fmt: skip
    add_machine(parser, drawn=("--rig", "--quantity motor_current", "--count"))
    parser.add_argument(
        "--count", type=whole_number(1), metavar="N",
        help="recordings to write into a folder, each of another assembly of --rig (default for them: r2), "
        "shared out evenly over --worn-counts, --speeds and --loads",
    )  # fmt: skip
    parser.add_argument(
        "--worn-counts", type=list_of(whole_number(0)), metavar="N,N,...", default=range(8),
        help="numbers of worn lobes, side by side, with --count (default: 0,1,2,3,4,5,6,7)",
    )  # fmt: skip
    for option, unit, several in (("--speeds", "RPM", "400,500"), ("--loads", "Nm", "11,22")):
        parser.add_argument(
            option, type=list_of(range_of(unit)), metavar=unit, default=[None],
            help=f"{option[2:-1]} in {unit}; with --count several, such as {several}, or ranges LOW:HIGH "
            "(default: the rig's)",
        )  # fmt: skip
    parser.add_argument("--duration", type=positive, default=3.0, help="seconds (default 3)")
    parser.add_argument("--sampling-rate", type=positive, default=25_600.0, help="Hz (default 25600)")
    parser.add_argument(
        "--quantity", choices=QUANTITIES, default=QUANTITIES[0],
        help="quantity to record (default output_torque); for a current, a rig without a motor gets one",
    )  # fmt: skip
    parser.add_argument("--no-angle", action="store_true", help="do not write the shaft's angle")
    parser.add_idle("--worn-count", "--worn-lobes", "--removed-lobes", "--material", beside=["--count"])
    parser.add_idle("--worn-counts", without=["--count"])


def run(arguments: Arguments) -> Printed:
    """Write one recording, or a folder of many."""
    from cyclofeat.datasets import make_rig_recording, write_recording
    from cyclofeat.datasets.readers import one_line, write_folder
    from cyclofeat.recordings import Recording
    from cyclofeat.simulators import simulate
    from cyclofeat.simulators.sampling import draw_conditions

    file, (speed, *speeds), (load, *loads) = arguments.out, arguments.speeds, arguments.loads
    if (Path(file).suffix.lower() in (".csv", ".npz")) is (arguments.count is not None):
        raise ValueError(f"--out must end in .csv or .npz, or be a folder for --count N, got {file}")
    if arguments.count is not None:
        files = write_folder(file, _simulate_many(arguments))
        text = f"{file}: {number_of(len(files), 'recording')}, each of another assembly, and their manifest"
        return Printed(text, {"folder": file, "files": list(map(str, files))})
    if speeds or loads:
        raise ValueError("--speeds and --loads must be one number each without --count")
    with Progress(f"simulating {arguments.duration:g} s"):
        defects, (rig, drawn) = defects_of(arguments), machine_of(arguments)
        rig = draw_conditions(rig, speed, load, np.random.SeedSequence(arguments.random_state))
        length = {"duration": arguments.duration, "sampling_rate": arguments.sampling_rate}
        if not drawn:
            recording = Recording.from_run(
                simulate(rig.gearbox, defects, **length), quantity=arguments.quantity, assembly="nominal",
                run="simulated",
            )  # fmt: skip
        else:
            recording = make_rig_recording(
                rig, defects, **length, quantity=arguments.quantity, random_state=arguments.random_state,
                with_angle=True,
            )  # fmt: skip
    if arguments.no_angle:
        recording = recording.replace(angle=None, angle_is_absolute=False)
    write_recording(file, recording)
    return Printed(f"{file}: {one_line(recording)}", {"file": file, "defect_count": recording.defect_count})


def _simulate_many(arguments: Arguments) -> Iterator[Recording]:
    """Yield recordings with each number of worn lobes in turn, at the next speed and load each time."""
    from cyclofeat.datasets import make_rig_recordings

    conditions = list(itertools.product(arguments.speeds, arguments.loads))
    counts, total = arguments.worn_counts, arguments.count
    if total < len(counts) * len(conditions):
        least = f"{len(counts) * len(conditions)}, all of --worn-counts at each speed and load"
        raise ValueError(f"--count must be at least {least}, got {total}")
    rig = rig_of(arguments, default="r2")
    arguments.note_simulation(total * arguments.duration)
    with Progress("simulating assemblies") as progress:
        for done in range(0, total, len(counts)):
            speed, load = conditions[done // len(counts) % len(conditions)]
            recordings = make_rig_recordings(
                1, counts, rig=rig, speed_rpm=speed, load_nm=load, duration=arguments.duration,
                sampling_rate=arguments.sampling_rate, quantity=arguments.quantity,
                with_angle=not arguments.no_angle, random_state=arguments.random_state, n_jobs=-1,
                first_assembly=done // len(counts),
            )  # fmt: skip
            yield from recordings[: total - done]
            progress(min(done + len(counts), total), total)
