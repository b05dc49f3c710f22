"""``cyclofeat campaign``: many simulated assemblies, from a design to files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from cyclofeat._base.progress import Progress
from cyclofeat._base.quantities import number_of
from cyclofeat.cli._options import Arguments, Parser, Printed
from cyclofeat.cli._rigs import add_effects

if TYPE_CHECKING:
    from cyclofeat.simulators import Campaign
    from cyclofeat.simulators.campaign import CampaignData


def add_arguments(parser: Parser) -> None:
    parser.add_argument("design", nargs="?", metavar="DESIGN", help="design of the campaign, JSON")
    parser.add_argument(
        "--out", metavar="FOLDER", help="folder to write; a campaign that it holds in part is completed"
    )
    where = parser.add_mutually_exclusive_group()
    parser.add_jobs(to=where)
    where.add_argument("--scheduler", metavar="ADDRESS", help="Dask scheduler whose workers simulate")
    parser.add_argument(
        "--kernel", choices=("exact", "batch", "auto"),
        help="kernel in place of the design's: many runs at once in single precision, where possible (auto) "
        "or always, with an error where impossible (batch); or one by one in double precision (exact)",
    )  # fmt: skip
    parser.add_target("--example", metavar="FILE", help="write a design to edit, and do nothing else")
    parser.add_argument("--verify", metavar="FOLDER", help="compare a finished campaign with its manifest")
    add_effects(parser)
    simulation = ("DESIGN", "--out", "--jobs", "--scheduler", "--kernel")
    parser.add_idle(*simulation, "--verify", "--effects-from", beside=["--example"])
    parser.add_idle(*simulation, beside=["--verify"])


def run(arguments: Arguments) -> Printed:
    """Simulate a campaign, verify one, or write an example of a design."""
    from cyclofeat.datasets import rig_preset
    from cyclofeat.simulators import Campaign, load_campaign, run_campaign

    if arguments.example is not None:
        path, design = str(Path(arguments.example)), example()
        n_runs = design.n_runs
        design.to_json(path)
        text = (
            f"{path}: a design of {number_of(n_runs, 'run')}; run it: cyclofeat campaign {path} --out FOLDER"
        )
        return Printed(text, {"file": path, "n_runs": n_runs})
    if arguments.verify is not None:
        with Progress("verifying the campaign"):
            return _print_campaign(arguments.verify, load_campaign(arguments.verify, verify=True))
    if arguments.design is None or arguments.out is None:
        raise ValueError(
            "campaign needs a design and --out FOLDER; 'cyclofeat campaign --example design.json' writes a "
            "design to edit"
        )
    campaign = Campaign.from_json(arguments.design, preset=rig_preset)
    if arguments.kernel is not None:
        campaign = campaign.replace(kernel=arguments.kernel)
    simulated_s = campaign.n_runs * campaign.duration
    arguments.note_simulation(simulated_s, in_batches=campaign.kernel != "exact")
    with Progress("simulating assemblies") as progress:
        data = run_campaign(
            campaign, arguments.out, n_jobs=arguments.n_jobs, scheduler=arguments.scheduler, progress=progress
        )
    return _print_campaign(arguments.out, data)


def example() -> Campaign:
    """Return a design that shows every kind of entry."""
    from cyclofeat.simulators import Campaign, GearboxParameter, Hum, Noise, Quantisation, Rig

    varied = (GearboxParameter("load_torque", (15.0, 25.0)), Noise((0.05, 1.0)), Quantisation((0.01, 0.1)))
    rig = Rig.r2().replace(name="example rig").with_effects(Hum((0.05, 0.3)), *varied)
    return Campaign(name="example", rig=rig, repeats=16, depth=(0.3, 1.0))


def _print_campaign(folder: str, result: CampaignData) -> Printed:
    n_runs, n_samples = result.X.shape
    counts = result.manifest["status"]
    size = sum(file["bytes"] for file in result.manifest["files"].values())
    status = ", ".join(f"{n} {name}" for name, n in counts.items())
    text = f"{folder}: {number_of(n_runs, 'run')} of {n_samples} samples ({status}), {size / 1e6:.1f} MB"
    if not result.ok.all():
        first = int(result.ok.argmin())
        reason = result.parameters["reason"][first]
        text += f"\nfirst that failed, run {first} (counted from 0): {reason}"
    facts = {
        "folder": folder,
        "n_runs": n_runs,
        "n_samples": n_samples,
        "sampling_rate": result.sampling_rate,
        "n_shards": result.campaign.n_shards,
        "bytes": size,
        "status": counts,
    }
    return Printed(text, facts, failed=not result.ok.any())
