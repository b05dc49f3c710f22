"""``cyclofeat gap``: where model and measurement disagree, all that is missing, and the corrected model."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cyclofeat._base.checks import different_names
from cyclofeat._base.progress import Progress, Steps
from cyclofeat._base.quantities import beyond_text, in_words, number_of, unit_text
from cyclofeat._base.training import import_jax
from cyclofeat.cli._options import Arguments, Parser, Printed, check_folder, note, whole_number
from cyclofeat.cli._rigs import add_effects

if TYPE_CHECKING:
    from cyclofeat.gap import Condition, EffectPosterior, World
    from cyclofeat.recordings import Recording
    from cyclofeat.simulators import Rig

PACKAGED = "packaged"  # word for the posterior that comes with the package
_RECORDINGS, _RIGS = 12, 240
_MACHINES = 4000  # about an hour of two cores
_COMPARISON_S = 150.0  # of one core
_OF_GAP = (
    "--hold-out", "--out", "--save-simulator", "--train", "--simulated", "--alpha", "--one-assembly",
)  # fmt: skip


def add_check(parser: Parser) -> None:
    parser.add_argument(
        "--check",
        action="store_true",
        help="state which effects recordings like MEASURED could reveal, from which size on, and how often "
        "the posterior is right; without MEASURED, the same for planned recordings (one or two minutes on "
        "two cores)",
    )
    parser.add_argument(
        "--recordings", type=whole_number(1), default=_RECORDINGS, metavar="N",
        help="planned recordings, at the middle speed and load that the posterior knows "
        f"(default {_RECORDINGS})",
    )  # fmt: skip
    parser.add_argument(
        "--rigs", type=whole_number(1), default=_RIGS, metavar="N",
        help=f"simulated rigs with known effects that --check uses (default {_RIGS}); more rigs give "
        "more precise sizes",
    )  # fmt: skip
    parser.add_idle("--recordings", beside=["MEASURED"])
    parser.add_idle("--recordings", "--rigs", without=["--check"])
    parser.add_idle(*_OF_GAP, "--cache", beside=["--check"])


def run_check(arguments: Arguments) -> Printed:
    """Check the recordings named, or as many planned ones."""
    from cyclofeat.gap import Condition, check_recordings
    from cyclofeat.gap.posterior.of_model import posterior_of_world
    from cyclofeat.simulators import Rig

    model, posterior = _model_and_posterior(arguments)
    if posterior is None:
        world = world_of(arguments, model or Rig())
        with Steps() as steps:
            posterior = posterior_of_world(world, n_jobs=arguments.n_jobs, progress=steps)

    recordings: list[Recording] | list[Condition]
    if arguments.measured:
        recordings = arguments.read_all(arguments.measured)
    else:
        middle = Condition(sum(posterior.world.speeds_rpm) / 2, sum(posterior.world.loads_nm) / 2)
        recordings = [middle] * arguments.recordings
    with Progress("simulating rigs") as progress:
        result = check_recordings(
            recordings, posterior=posterior, n_rigs=arguments.rigs, random_state=arguments.random_state,
            n_jobs=arguments.n_jobs, progress=progress,
        )  # fmt: skip
    lines = [str(result)]
    for effect in sorted(result.effects, key=lambda effect: -effect.recall):
        if not effect.n:
            continue
        half = beyond_text(effect.half_below, effect.half_above)
        most, unit = beyond_text(effect.most_below, effect.most_above), unit_text(effect.unit)
        text = f"{effect.effect}: found in {effect.recall:.0%} of {effect.n}"
        if half:
            text += f"; in half with {effect.parameter} {half}{unit}"
            text += f", in 9 of 10 {most}{unit}" if most else ""
        elif effect.recall < 1:
            text += f"; no {effect.parameter} is found in half"
        confused = f"; taken for {', '.join(effect.confused_with)}" if effect.confused_with else ""
        lines.append(text + confused)
    if result.wrong:
        wrong = ", ".join(f"{name} ({n})" for name, n in result.wrong.items())
        lines.append(f"named although absent: {wrong}")
    return Printed("\n  ".join(lines), result.to_dict())


def add_preparation(parser: Parser) -> None:
    parser.add_target(
        "--prepare", metavar="FILE",
        help="learn --posterior for the model from simulated rigs, at conditions like those of MEASURED if "
        "there are some (of input torque without them: --quantity input_torque), and write it to FILE, .npz; "
        "with --posterior, start from that one",
    )  # fmt: skip
    parser.add_argument(
        "--effects",
        metavar="NAMES",
        help="effects that --prepare learns, separated by commas (default: all that the model can have "
        "but lacks)",
    )
    parser.add_argument(
        "--machines", type=whole_number(1), default=_MACHINES, metavar="N",
        help=f"simulated machines that --prepare learns from (default {_MACHINES}: about an hour on two "
        "cores); more of them can be added later with the same --cache",
    )  # fmt: skip
    parser.add_idle("--machines", "--effects", without=["--prepare"])
    parser.add_idle(*_OF_GAP, "--check", beside=["--prepare"])


def prepare_posterior(arguments: Arguments) -> Printed:
    """Simulate rigs of the model, learn from them, and write the posterior."""
    if arguments.cache is None:
        raise ValueError(
            "--prepare needs --cache FOLDER: what is simulated is kept there if it is interrupted"
        )
    import_jax()  # or an error before the work
    from cyclofeat.gap import EffectPosterior, prepare_world
    from cyclofeat.gap.posterior.effect_posterior import check_start
    from cyclofeat.simulators import Rig

    model = Rig() if arguments.simulator is None else Rig.from_json(arguments.simulator)
    world = world_of(arguments, model)
    start = None if arguments.posterior is None else read_posterior(arguments.posterior)
    if start is not None:  # before the simulations, which take an hour
        check_start(start, world.cells, world.defect_counts)
    with Progress("simulating machines, eight at a time") as progress:
        folder = Path(arguments.cache) / "world"
        rigs = prepare_world(world, folder, arguments.machines, n_jobs=arguments.n_jobs, progress=progress)
    posterior = EffectPosterior(random_state=arguments.random_state)
    with Progress("learning from them") as progress:
        posterior.fit(rigs, start=start, progress=progress)
    path = posterior.save(arguments.prepare)
    facts = {
        "posterior": str(path), "quantity": world.quantity, "n_rigs": posterior.n_rigs_,
        "effects": list(posterior.names_), "speeds_rpm": list(world.speeds_rpm),
        "loads_nm": list(world.loads_nm), "sampling_rate": world.sampling_rate,
    }  # fmt: skip
    speeds, loads = (" to ".join(f"{end:.4g}" for end in ends) for ends in (world.speeds_rpm, world.loads_nm))
    text = (
        f"{path}: {number_of(len(posterior.names_), 'effect')}, learned from the "
        f"{in_words(world.quantity)} of {posterior.n_rigs_} simulated rigs at {speeds} RPM, {loads} Nm and "
        f"{world.sampling_rate:g} Hz"
    )
    return Printed(text, facts)


def read_posterior(named: str) -> EffectPosterior:
    """Return the posterior of a file, or the one that comes with the package."""
    from cyclofeat.gap import load_posterior

    try:
        return load_posterior() if named == PACKAGED else load_posterior(named)
    except FileNotFoundError as error:
        raise FileNotFoundError(
            f"no such posterior: {error.filename}; write one with --prepare FILE, and give --posterior FILE"
        ) from None


def world_of(arguments: Arguments, model: Rig) -> World:
    """Return the world of the model, around the conditions of the recordings where there are some."""
    from cyclofeat.gap import World
    from cyclofeat.gap.measured import MeasuredRig

    quantity = arguments.quantity or World.quantity
    world = World(rig=model, quantity=quantity, random_state=arguments.random_state)
    if arguments.measured:
        world = MeasuredRig.of(arguments.read_all(arguments.measured), model).world(world)
    if arguments.effects is None:
        return world
    known = {effect.effect_id: effect for effect in world.effects or ()}
    effects = [known[name] for name in different_names(arguments.effects.split(","), known, "--effects")]
    return dataclasses.replace(world, effects=effects, most=min(world.most, len(effects)))


def add_arguments(parser: Parser) -> None:
    parser.add_argument(
        "measured",
        nargs="*",
        metavar="MEASURED",
        help="recordings of one rig, or folders of them, at one or several speeds and loads",
    )
    parser.add_argument("--simulator", metavar="FILE", help="model, JSON (default: paper B's gearbox)")
    parser.add_argument(
        "--posterior",
        metavar="FILE",
        help="posterior that --prepare has learned for the model, .npz, or 'packaged', the one for paper B's "
        "gearbox that comes with the package (default: packaged where it fits model and MEASURED; else one "
        "is learned first, in some ten minutes of two cores, and kept)",
    )
    parser.add_argument(
        "--simulated",
        metavar="FOLDER",
        help="recordings of another simulator: show where MEASURED differs from them, and name no effects",
    )
    parser.add_argument(
        "--hold-out", dest="by", metavar="FOLDER|SHARE|speed|load",
        help="recordings on which the corrected model is judged: a folder, a share of MEASURED like 0.4, or "
        "those at the middle of at least three speeds or loads",
    )  # fmt: skip
    parser.add_target("--out", "page", metavar="FILE", help="page to write, .html")
    parser.add_target(
        "--save-simulator", metavar="FILE",
        help="corrected model to write, .json, with the effects and sizes that the recordings leave possible",
    )  # fmt: skip
    parser.add_target(
        "--train", "model", metavar="FILE",
        help="train a counter on the corrected model, write it, and try it on all recordings beside the "
        "packaged one (about four minutes on two cores)",
    )  # fmt: skip
    add_check(parser)
    add_preparation(parser)
    parser.add_argument(
        "--cache", metavar="FOLDER", help="folder that keeps simulations, so that a new run resumes"
    )
    add_effects(parser)
    parser.add_argument(
        "--alpha", type=float, default=0.03, help='chance of a false "disagree" (default 0.03)'
    )
    parser.add_argument(
        "--one-assembly",
        action="store_true",
        help="all recordings are of one gearbox that was not taken apart between them",
    )
    parser.add_seed("all simulations")
    parser.add_jobs()
    parser.add_reading_options(recordings="MEASURED")
    parser.add_idle(
        "--simulator", "--posterior", "--hold-out", "--save-simulator", "--one-assembly", "--cache",
        "--jobs", beside=["--simulated"],
    )  # fmt: skip
    parser.add_idle("--train", without=["--save-simulator"])
    parser.add_idle("--effects-from", without=["--simulator", "--posterior"])
    parser.add_idle("--quantity", without=["MEASURED", "--prepare"])


def run(arguments: Arguments) -> Iterator[Printed]:
    """Compare, name, correct, judge, then write corrected model and report; or only prepare, or check."""
    if arguments.cache is not None:
        check_folder("--cache", Path(arguments.cache))
    if arguments.prepare is not None:
        yield prepare_posterior(arguments)
        return
    if arguments.check:
        yield run_check(arguments)
        return
    if not arguments.measured:
        raise ValueError("MEASURED must name recordings, or folders of them")
    from cyclofeat.gap import GapSettings, compare_recordings, find_gap

    typed = ("alpha", "one_assembly", "random_state", "n_jobs", "cache")
    gap_settings = GapSettings(
        **{name: getattr(arguments, name) for name in typed}, pictures=arguments.out is not None
    )
    recordings = arguments.read_all(arguments.measured)
    if arguments.simulated is None:
        model, posterior = _model_and_posterior(arguments)
        fitted, held_out = _split_recordings(arguments, recordings)
        arguments.note_duration("the comparison", _COMPARISON_S)
        with Steps() as steps:
            result = find_gap(
                fitted, held_out, model=model, posterior=posterior, settings=gap_settings, progress=steps
            )
        settings = {
            "model": arguments.simulator or arguments.posterior or "paper B's gearbox",
            "effects considered": ", ".join(row.effect for row in result.effects),
            "recordings": f"{len(fitted)}",
        }
        if held_out is not None:
            settings["recordings held out"] = f"{len(held_out)}"
    else:
        simulated = arguments.read_all([arguments.simulated])
        with Progress("comparing recordings"):
            result = compare_recordings(recordings, simulated, settings=gap_settings)
        settings = {
            "recordings": f"{len(recordings)}",
            "simulated recordings": f"{len(simulated)} of {arguments.simulated}",
        }
    yield Printed(str(result), result.to_dict())
    if arguments.save_simulator is not None:
        settings["corrected model"] = arguments.save_simulator
        (result.posterior_rig or result.rig).to_json(arguments.save_simulator)
        yield Printed(f"corrected model: {arguments.save_simulator}", {})
        if result.named and arguments.train is None:
            train = f"next: cyclofeat train --rig {arguments.save_simulator} --out counter.skops"
            yield Printed("\n".join(filter(None, [train, result.caution])), {})
    counters: list[dict[str, Any]] = []
    if arguments.train is not None:
        counters = try_counters(arguments, recordings)
        lines = [
            f"{row['counter']}: {row['n'] - row['refused']} counted, {row['refused']} refused"
            + ("" if row["right"] is None else f", {row['right']} of {row['n']} right")
            for row in counters
        ]
        yield Printed("\n".join(lines), {"counters": counters})
    if arguments.out is not None:
        from cyclofeat.report import write_gap_report

        sources = [recording.source for recording in recordings]
        with Progress("writing the report"):
            write_gap_report(result, arguments.out, sources=sources, settings=settings, counters=counters)
        yield Printed(f"report: {arguments.out}", {})


def try_counters(arguments: Arguments, recordings: list[Recording]) -> list[dict[str, Any]]:
    """Train a counter on the corrected model, and count the recordings with it and with the packaged one."""
    from cyclofeat.cli import make_parser, train
    from cyclofeat.models import load_default_model, load_model

    rate = min(25_600.0, *(recording.sampling_rate for recording in recordings))
    most = max(7, *(recording.defect_count or 0 for recording in recordings))
    options = {
        "--rig": arguments.save_simulator, "--out": arguments.train, "--sampling-rate": rate,
        "--max-count": most, "--seed": arguments.random_state, "--jobs": arguments.n_jobs,
        "--quantity": recordings[0].quantity,
    }  # fmt: skip
    note("training a counter on the corrected model: about four minutes on two cores")
    words = [str(word) for option in options.items() for word in option]
    train.run(make_parser(["train"]).parse_args(["train", *words]))
    models = {
        "trained on the corrected model": load_model(arguments.train),
        "packaged counter": load_default_model(recordings[0].quantity),
    }
    known, rows = all(recording.defect_count is not None for recording in recordings), []
    for name, model in models.items():
        try:
            pairs = [(model.count(recording), recording) for recording in recordings]
        except ValueError as error:  # of a model for other gearboxes
            note(f"{name}: {error}")
            continue
        right = [not count.refused and count.defect_count == one.defect_count for count, one in pairs]
        refused = sum(count.refused for count, _ in pairs)
        right_ones = sum(right) if known else None
        rows.append({"counter": name, "n": len(pairs), "right": right_ones, "refused": refused})
    return rows


def _model_and_posterior(arguments: Arguments) -> tuple[Rig | None, EffectPosterior | None]:
    """Return the model and the posterior as far as they are named."""
    from cyclofeat.gap.posterior.of_model import is_of_model
    from cyclofeat.simulators import Rig

    model = None if arguments.simulator is None else Rig.from_json(arguments.simulator)
    if arguments.posterior is None:
        return model, None
    posterior = read_posterior(arguments.posterior)
    if model is not None and not is_of_model(posterior, model):
        packaged = arguments.posterior == PACKAGED
        raise ValueError(
            f"{'the packaged posterior' if packaged else arguments.posterior} was learned from another "
            f"model than {arguments.simulator}: leave --posterior out, or write its own with --prepare FILE"
        )
    return model, posterior


def _split_recordings(
    arguments: Arguments, recordings: list[Recording]
) -> tuple[list[Recording], list[Recording] | None]:
    """Return the recordings to fit, and those to judge on."""
    from cyclofeat.gap import hold_out

    if arguments.by is None:
        return recordings, None
    by: float | str = arguments.by
    with contextlib.suppress(ValueError):
        by = float(by)
    if isinstance(by, str) and by not in ("speed", "load"):
        return recordings, arguments.read_all([by])
    return hold_out(recordings, by, random_state=arguments.random_state)
