"""``cyclofeat animate``: a page that shows the gearbox turning."""

from __future__ import annotations

from pathlib import Path

from cyclofeat._base.progress import Progress
from cyclofeat.cli._options import Arguments, Parser, Printed, note, positive
from cyclofeat.cli._rigs import add_machine, defects_of, machine_of

# Forces of every sample at the papers' rate would fill the memory while the machine settles.
_SAMPLING_RATE = 6400.0
_LONGEST = 20.0


def add_arguments(parser: Parser) -> None:
    parser.add_target("--out", "page", required=True, metavar="FILE.html", help="page to write")
    add_machine(parser)
    parser.add_argument(
        "--duration", type=positive, help="simulated seconds, up to 20 (default: one output turn)"
    )
    parser.add_argument(
        "--frames", type=int, default=720, help="instants at which forces are shown (default 720)"
    )


def run(arguments: Arguments) -> Printed:
    """Simulate the assembly that ``simulate`` makes of the same options, and write the page."""
    from cyclofeat.report import write_animation
    from cyclofeat.simulators.sampling import recording_seed

    machine, drawn = machine_of(arguments)
    duration = arguments.duration or machine.gearbox.n_lobes / machine.gearbox.input_speed_hz
    if duration > _LONGEST:
        raise ValueError(f"--duration must be at most {_LONGEST:g} s, got {duration:g}")
    with Progress(f"simulating {duration:.4g} s and drawing"):
        shown = machine.simulate(
            defects_of(arguments),
            duration=duration,
            sampling_rate=_SAMPLING_RATE,
            random_state=recording_seed(arguments.random_state, machine.name, 0) if drawn else 0,
            start_angle=None if drawn else 0.0,
            forces=True,
            points=True,
        )
        write_animation(shown, arguments.out, frames=arguments.frames)
    note("open the page in a browser; it needs no network")
    file, frames = str(Path(arguments.out)), arguments.frames
    duration = shown.torque_out.size / shown.sampling_rate
    return Printed(
        f"{file}: {duration:.4g} s of the machine in {frames} frames",
        {"file": file, "defect_count": shown.defects.defect_count, "duration_s": duration, "frames": frames},
    )
