"""``cyclofeat campaign``: many simulated assemblies from a design to files."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cyclofeat._progress import Progress

if TYPE_CHECKING:
    from cyclofeat.simulators import Campaign, CampaignData

TEXT = "simulate thousands of assemblies to files, resumable"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("design", nargs="?", metavar="DESIGN", help="design of the campaign, JSON")
    parser.add_argument(
        "--out", metavar="FOLDER", help="folder to write; one that holds a part of the campaign is completed"
    )
    where = parser.add_mutually_exclusive_group()
    where.add_argument("--jobs", type=int, default=-1, help="processes (default: all cores)")
    where.add_argument("--scheduler", metavar="ADDRESS", help="Dask scheduler whose workers simulate")
    parser.add_argument("--example", metavar="FILE", help="write a design to edit, and do nothing else")
    parser.add_argument("--verify", metavar="FOLDER", help="compare a finished campaign with its manifest")


def run(arguments: argparse.Namespace) -> int:
    """Run the command.

    Parameters
    ----------
    arguments : argparse.Namespace

    Returns
    -------
    int
        0, or 2 where not a single run reached its end.

    Raises
    ------
    ValueError, TypeError, OSError, ImportError
        As :meth:`cyclofeat.simulators.Campaign.run`.
    """
    from cyclofeat.datasets import rig_preset
    from cyclofeat.simulators import Campaign, load_campaign

    _check_arguments(arguments)
    if arguments.example is not None:
        _write_example(Path(arguments.example), arguments.json)
        return 0
    if arguments.verify is not None:
        return _report(arguments.verify, load_campaign(arguments.verify, verify=True), arguments.json)
    campaign = Campaign.from_json(arguments.design, preset=rig_preset)
    data = campaign.run(
        arguments.out,
        n_jobs=arguments.jobs,
        scheduler=arguments.scheduler,
        progress=Progress("simulating assemblies"),
    )
    return _report(arguments.out, data, arguments.json)


def _check_arguments(arguments: argparse.Namespace) -> None:
    alone = [name for name in ("example", "verify") if getattr(arguments, name) is not None]
    if alone:
        others = [name for name in ("example", "verify", "design", "out", "scheduler") if name != alone[0]]
        given = [name for name in others if getattr(arguments, name) is not None]
        if given:
            raise ValueError(f"--{alone[0]} goes alone, got {given[0]} {getattr(arguments, given[0])!r} too")
    elif arguments.design is None or arguments.out is None:
        raise ValueError(
            "campaign needs a design and --out FOLDER; 'cyclofeat campaign --example design.json' writes a "
            "design to edit"
        )


def example() -> Campaign:
    """A design that shows every kind of entry."""
    from cyclofeat.simulators import Campaign, Hum, Quantisation, Rig

    rig = Rig.r2().replace(name="example rig", effects=[Hum((0.05, 0.3)), Quantisation(0.05)])
    return Campaign(
        name="example",
        rig=rig,
        repeats=16,
        depth=(0.3, 1.0),
        parameters={
            "load_torque": (15.0, 25.0),
            "noise_nm": (0.05, 1.0, "log"),
            "effects.quantisation.lsb_nm": (0.01, 0.1, "log"),
        },
    )


def _write_example(path: Path, as_json: bool) -> None:
    if path.exists():
        raise FileExistsError(f"{path}: exists already; give a new name")
    campaign = example()
    campaign.to_json(path)
    if as_json:
        _print_json({"file": str(path), "n_runs": campaign.n_runs})
    else:
        print(f"{path}: a design of {campaign.n_runs} runs; run it: cyclofeat campaign {path} --out FOLDER")


def _report(folder: str, data: CampaignData, as_json: bool) -> int:
    status = data.manifest["status"]
    n_bytes = sum(file["bytes"] for file in data.manifest["files"].values())
    n_runs, n_samples = data.X.shape
    if as_json:
        _print_json(
            {
                "folder": str(folder),
                "n_runs": n_runs,
                "n_samples": n_samples,
                "sampling_rate": data.sampling_rate,
                "n_shards": data.campaign.n_shards,
                "bytes": n_bytes,
                "status": status,
            }
        )
    else:
        told = ", ".join(f"{number} {name}" for name, number in status.items())
        print(f"{folder}: {n_runs} runs of {n_samples} samples ({told}), {n_bytes / 1e6:.1f} MB")
        if not data.ok.all():
            first = int((~data.ok).nonzero()[0][0])
            print(f"first that failed, run {first} (counted from 0): {data.parameters['reason'][first]}")
    return 0 if data.ok.any() else 2


def _print_json(value: Any) -> None:
    print(json.dumps(value, indent=2))
