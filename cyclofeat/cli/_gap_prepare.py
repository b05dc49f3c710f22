"""``cyclofeat gap --prepare``: a posterior for a model of one's own, learned from simulated rigs."""

from __future__ import annotations

import argparse
import dataclasses
import importlib.util
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from cyclofeat._base.arguments import different_names
from cyclofeat._base.checks import whole
from cyclofeat._base.progress import Progress
from cyclofeat._base.quantities import in_words
from cyclofeat.cli._idle import add_idle
from cyclofeat.cli._reading import read_all
from cyclofeat.cli._table import Printed
from cyclofeat.cli._targets import add_target

if TYPE_CHECKING:
    from cyclofeat.gap.posterior import EffectPosterior
    from cyclofeat.gap.world import World
    from cyclofeat.simulators import Rig

PACKAGED = "packaged"  # word for the posterior that comes with the package

_MACHINES = 4000  # about an hour of two cores
_EPOCHS_ON = 12  # of networks that go on: with more they fit single rigs
_TRAINED_BY = ("jax", "optax")


@dataclass(frozen=True)
class Prepared:
    """A posterior and the file that it was written to."""

    path: Path
    posterior: EffectPosterior


def add_preparation(parser: argparse.ArgumentParser) -> None:
    """Add the options of a preparation."""
    add_target(
        parser,
        "--prepare",
        metavar="FILE",
        help="learn --posterior for the model from simulated rigs, at conditions like those of MEASURED if "
        "there are some (of input torque without them: --quantity input_torque), and write it to FILE, .npz; "
        "with --posterior, start from that one",
    )
    parser.add_argument(
        "--effects",
        metavar="NAMES",
        help="effects that --prepare learns, separated by commas (default: all that the model can have "
        "but lacks)",
    )
    parser.add_argument(
        "--machines",
        type=int,
        default=_MACHINES,
        metavar="N",
        help=f"simulated machines that --prepare learns from (default {_MACHINES}: about an hour on two "
        "cores); more of them can be added later with the same --cache",
    )
    add_idle(parser, "--machines", "--effects", without=["--prepare"])
    add_idle(
        parser, "--hold-out", "--out", "--save-simulator", "--simulated", "--alpha",
        "--one-assembly", "--check", beside=["--prepare"],
    )  # fmt: skip


def prepare(arguments: argparse.Namespace) -> Prepared:
    """Simulate rigs of the model, learn from them, and write the posterior."""
    if arguments.cache is None:
        raise ValueError(
            "--prepare needs --cache FOLDER: what is simulated is kept there if it is interrupted"
        )
    n_machines = whole("--machines", arguments.machines, 1)
    missing = [name for name in _TRAINED_BY if importlib.util.find_spec(name) is None]
    if missing:
        raise ImportError(f"--prepare needs {' and '.join(missing)}: pip install {' '.join(missing)}")
    from cyclofeat.gap.posterior import EffectPosterior
    from cyclofeat.gap.world import prepare_world
    from cyclofeat.simulators import Rig

    model = Rig() if arguments.simulator is None else Rig.from_json(arguments.simulator)
    world = world_of(arguments, model)
    start = None if arguments.posterior is None else read_posterior(arguments.posterior)
    if start is not None:  # before the simulations, which take an hour
        start.check_goes_on(world.cells, world.defect_counts, world.quantity)
    with Progress("cyclofeat gap: simulating machines, eight at a time") as progress:
        rigs = prepare_world(
            world,
            Path(arguments.cache) / "world",
            n_machines,
            n_jobs=arguments.jobs,
            progress=progress,
        )
    epochs = EffectPosterior().epochs if start is None else _EPOCHS_ON
    posterior = EffectPosterior(epochs=epochs, random_state=arguments.seed)
    with Progress("cyclofeat gap: learning from them") as progress:
        posterior.fit(rigs, start=start, progress=progress)
    return Prepared(posterior.save(arguments.prepare), posterior)


def read_posterior(named: str | None) -> EffectPosterior:
    """Return the posterior of a file, or the one that comes with the package."""
    from cyclofeat.gap.posterior import load_posterior

    try:
        return load_posterior() if named in (None, PACKAGED) else load_posterior(named)
    except FileNotFoundError as error:
        raise FileNotFoundError(
            f"no such posterior: {error.filename}; write one with --prepare FILE, and give --posterior FILE"
        ) from None


def world_of(arguments: argparse.Namespace, model: Rig) -> World:
    """Return the world of the model, around the conditions of the recordings where there are some."""
    from cyclofeat.gap import MeasuredRig
    from cyclofeat.gap.world import World

    quantity = arguments.quantity or World.quantity
    world = World(rig=model, quantity=quantity, random_state=arguments.seed)
    if arguments.measured:
        world = MeasuredRig.of(read_all(arguments.measured, arguments), model).world(world)
    if arguments.effects is None:
        return world
    known = {effect.effect_id: effect for effect in world.effects or ()}
    effects = [known[name] for name in different_names(arguments.effects.split(","), known, "--effects")]
    return dataclasses.replace(world, effects=effects, most=min(world.most, len(effects)))


def printed_preparation(prepared: Prepared) -> Printed:
    """Return what is printed of a preparation."""
    posterior = prepared.posterior
    world, n_rigs = posterior.world, posterior.n_rigs_
    facts = {
        "posterior": str(prepared.path),
        "quantity": world.quantity,
        "n_rigs": n_rigs,
        "effects": list(posterior.names_),
        "speeds_rpm": list(world.speeds_rpm),
        "loads_nm": list(world.loads_nm),
        "sampling_rate": world.sampling_rate,
    }
    speeds, loads = (" to ".join(f"{end:.4g}" for end in ends) for ends in (world.speeds_rpm, world.loads_nm))
    text = (
        f"{prepared.path}: {len(posterior.names_)} effects, learned from the {in_words(world.quantity)} of "
        f"{n_rigs} simulated rigs at {speeds} RPM, {loads} Nm and {world.sampling_rate:g} Hz"
    )
    return Printed(text, facts)
