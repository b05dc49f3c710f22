"""``cyclofeat train``: a model from labelled recordings, measured or simulated."""

from __future__ import annotations

import argparse
import warnings
from typing import TYPE_CHECKING

from cyclofeat._base.checks import whole
from cyclofeat._base.progress import Progress, Steps
from cyclofeat._base.quantities import number_of, rig_in_words
from cyclofeat._base.training import import_jax
from cyclofeat.cli._options import Arguments, Parser, Printed, note, positive, range_of, whole_number
from cyclofeat.cli._rigs import add_rig, rig_of

if TYPE_CHECKING:
    from cyclofeat.counting import LobeModel
    from cyclofeat.recordings import Recording

_SIMULATION = (
    "--assemblies", "--windows", "--speeds", "--loads", "--max-count", "--lobes", "--mixed-wear", "--kernel",
    "--jobs", "--rig",
)  # fmt: skip
_OF_COUNTER = (
    "--counter", "--samples-per-turn", "--wear", "--mixed-wear", "--coarser", "--max-count",
    "--lobes",
)  # fmt: skip

# Simulated speeds and loads reach from the nominal ones over the first to the nominal ones times it; from the
# lowest to the highest at which the rig was recorded, the second.
_RANGE, _RECORDED_RANGE = 1.25, 1.1
# Output turns of a simulated assembly; early wear hardly shows in one turn.
_TURNS, _TURNS_FOR_WEAR = 2, 5
# Largest share by which a motor turns less under load than at its nominal speed.
_SLIP = 0.03
# Seconds of a core to simulate a turn in a batch and to learn it.
_TURN_S = 0.06
# Share of the simulated worn assemblies that have radial wear, of --mixed-wear; the others have the chord.
_RADIAL_SHARE = 1 / 3
# Samples per input turn of windows, cyclofeat.recordings.windower.SAMPLES_PER_TURN, which loads late.
_PER_TURN = 128


def add_arguments(parser: Parser) -> None:
    parser.add_target(
        "--out", "model", required=True,
        help="model file to write: model.skops (safe) or model.joblib (a pickle)",
    )  # fmt: skip
    parser.add_argument(
        "recordings", nargs="*", help="labelled recordings or folders (default: simulated ones)"
    )
    parser.add_argument(
        "--assemblies", type=whole_number(1), default=100, metavar="N",
        help="assemblies per count (default 100)",
    )  # fmt: skip
    parser.add_argument(
        "--windows", type=whole_number(1), metavar="N",
        help="output turns of each simulated assembly (default: 2; 5 with --wear)",
    )  # fmt: skip
    parser.add_argument(
        "--speeds", type=range_of("RPM"), metavar="LOW:HIGH",
        help="input speeds of the simulated assemblies in RPM, such as 100:1500 (default: 0.8 to 1.25 times "
        "the rig's, or those at which it was recorded)",
    )  # fmt: skip
    parser.add_argument(
        "--loads", dest="load_nm", type=range_of("Nm"), metavar="LOW:HIGH",
        help="loads of the simulated assemblies in Nm, such as 3:40 (default: 0.8 to 1.25 times the rig's, "
        "or those at which it was recorded)",
    )  # fmt: skip
    parser.add_argument("--max-count", type=int, default=7, help="largest number of worn lobes (default 7)")
    parser.add_argument(
        "--lobes", choices=("consecutive", "random", "mixed"), default="consecutive",
        help="worn lobes of the simulated assemblies: neighbours (default), any, or half of each",
    )  # fmt: skip
    wear = add_counter_options(parser)
    wear.add_argument(
        "--mixed-wear", type=range_of("um", 200), metavar="LOW:HIGH",
        help="about a third of the simulated worn assemblies have radial wear, such as 60:200 um, the others "
        "the papers' chord; both are counted, no depth is learned",
    )  # fmt: skip
    _add_models(parser)
    parser.add_argument(
        "--sampling-rate", type=positive, metavar="HZ",
        help="sampling rate in Hz (default for simulated recordings: 25600). The model counts recordings "
        "with this rate or a higher one",
    )  # fmt: skip
    parser.add_seed("simulation and training")
    parser.add_argument(
        "--kernel", choices=("exact", "batch", "auto"), default="auto",
        help="many assemblies at once in single precision: where possible (auto, the default) or always, "
        "with an error where impossible (batch); or one by one in double precision (exact)",
    )  # fmt: skip
    parser.add_jobs("threads of the simulation")
    add_rig(parser, "r2")
    parser.add_reading_options(sampling_rate=False, recordings="recordings")
    parser.add_idle(*_SIMULATION, beside=["recordings"])
    parser.add_idle(*_OF_COUNTER, beside=["--domain-of"])


def _add_models(parser: Parser) -> None:
    parser.add_argument(
        "--coarser", metavar="MODEL",
        help="model with fewer samples per turn, which the file is to hold too: it counts the recordings "
        "that do not hold as many",
    )  # fmt: skip
    parser.add_argument(
        "--domain-of", metavar="MODEL",
        help="keep the counter of this model, and learn only which recordings are like its training data",
    )  # fmt: skip


def add_counter_options(parser: Parser) -> argparse._MutuallyExclusiveGroup:
    """Add the options that choose what is trained; return the group of options about wear."""
    parser.add_argument(
        "--counter", choices=("trees", "rows"), default="trees",
        help="trees (default), or rows: more accurate for neighbouring worn lobes, above all at many speeds "
        "and loads, and for early wear (--wear) of some 500 --assemblies and more; takes minutes to learn",
    )  # fmt: skip
    parser.add_argument(
        "--samples-per-turn", type=whole_number(1), metavar="N", default=_PER_TURN,
        help="samples per input turn of the windows (default 128: 44 lobe lines). With --counter rows, 256 "
        "hold 88, more accurate at low speeds; recordings to be counted must hold as many",
    )  # fmt: skip
    parser.add_argument(
        "--epochs", type=whole_number(1), metavar="N",
        help="times that --counter rows sees each window, in other variants (default 40, more where they are "
        "few); of ten thousand and more, 80 count better, in twice the time",
    )  # fmt: skip
    parser.add_idle("--epochs", without=["--counter rows"])
    wear = parser.add_mutually_exclusive_group()
    wear.add_argument(
        "--wear", dest="wear_um", type=range_of("um", 200), metavar="LOW:HIGH",
        help="learn the depth of radial wear, such as 5:200 um, and count from all windows of a recording at "
        "once; simulated lobes then have such wear in place of the papers' chord",
    )  # fmt: skip
    return wear


def untrained_model(arguments: Arguments) -> LobeModel:
    """Return the model that the options choose, to be trained on recordings."""
    from cyclofeat.counting import LobeModel
    from cyclofeat.recordings.windower import lobe_windower

    if arguments.counter == "rows":
        import_jax()  # or an error before the work
    elif arguments.samples_per_turn > _PER_TURN:
        raise ValueError(
            f"--samples-per-turn takes at most {_PER_TURN} without --counter rows, got "
            f"{arguments.samples_per_turn}"
        )
    windower = None
    if arguments.samples_per_turn != _PER_TURN:
        windower = lobe_windower(samples_per_turn=arguments.samples_per_turn)
    return LobeModel(
        windower, arguments.counter, epochs=arguments.epochs, wear_um=arguments.wear_um,
        random_state=arguments.random_state,
    )  # fmt: skip


def run(arguments: Arguments) -> Printed:
    """Read or simulate recordings, train on them, and write the model."""
    from cyclofeat.models import load_model, save_model

    coarser = None if arguments.coarser is None else load_model(arguments.coarser)
    trained = None if arguments.domain_of is None else load_model(arguments.domain_of)
    if trained is not None:
        arguments.samples_per_turn = trained.samples_per_turn_
        arguments.quantity = arguments.quantity or trained.card_["quantity"]
    model = untrained_model(arguments) if trained is None else trained
    if arguments.recordings:
        recordings = arguments.read_all(arguments.recordings)
        origin = f"{number_of(len(recordings), 'recording')} from files"
    else:
        recordings, name = _simulated_recordings(arguments)
        origin = (
            f"{len(recordings)} simulated assemblies of {rig_in_words(name)}, seed {arguments.random_state}"
        )
        if arguments.mixed_wear is not None:
            n_radial = sum(bool((recording.meta or {}).get("wear_um")) for recording in recordings)
            low, high = arguments.mixed_wear
            origin += f", {n_radial} of them with radial wear of {low:g} to {high:g} um"
    with Steps() as step:
        if trained is None:
            step(f"training on {origin}")
            model.set_params(description=origin).fit(recordings)
        else:
            step(f"learning the domain from {origin}")
            model = trained.learn_domain(recordings)
    save_model(arguments.out, model)  # what was learned is kept where the other does not match
    if coarser is not None:
        model = model.with_coarser(coarser)
        save_model(arguments.out, model)
    card, lines = model.card_, [f"{arguments.out}: {model}"]
    if model.locator_ is None:
        lines.append("note: lobes are located if all recordings state worn_lobes and an absolute angle")
    if card["cross_validation"] is None:
        lines.append("note: too few assemblies per count to cross-validate, 5 needed")
    learned = {} if model.wear_ is None else model.wear_.summary()
    if (error := learned.get("median_relative_error")) is not None:
        lines.append(f"median error of depths that show, on assemblies held out: {100 * error:.0f} %")
    if (accuracy := learned.get("accuracy")) is not None:
        lines.append(f"counts right with all windows at once, of all depths: {accuracy:.3f}")
    if "domain" in card:
        lines.append(f"domain learned from {card['domain']}")
    return Printed("\n  ".join(lines), {"file": arguments.out, **card})


def _simulated_recordings(arguments: Arguments) -> tuple[list[Recording], str]:
    """Return simulated recordings and the name of their rig."""
    from cyclofeat.counting import samples_per_turn_at
    from cyclofeat.datasets import make_rig_recordings
    from cyclofeat.recordings.windower import lobe_windower
    from cyclofeat.simulators import Solver

    rig = rig_of(arguments, default="r2")
    turns = arguments.windows or (_TURNS if arguments.wear_um is None else _TURNS_FOR_WEAR)
    if arguments.counter == "rows" and arguments.lobes != "consecutive":
        raise ValueError(f"--counter rows takes --lobes consecutive only, got {arguments.lobes}")
    sampling_rate = 25_600.0 if arguments.sampling_rate is None else arguments.sampling_rate
    gearbox = rig.gearbox
    whole("max_count", arguments.max_count, 1, gearbox.n_lobes)
    speeds = arguments.speeds or _range_around(60 * gearbox.input_speed_hz, rig.speeds_rpm)
    # Or an error before the work.
    samples_per_turn_at(sampling_rate, speeds[1] / 60, gearbox.n_lobes, arguments.samples_per_turn)
    quantity = arguments.quantity or "output_torque"
    if rig.has_motor or quantity == "motor_current":
        turns *= 1 + _SLIP
    n_turns = turns * arguments.assemblies * (arguments.max_count + 1)
    pace = _TURN_S * (5 if arguments.kernel == "exact" or rig.variants else 1)
    arguments.note_duration("simulating and training", pace * n_turns)
    with Progress("simulating assemblies") as progress, warnings.catch_warnings():
        warnings.filterwarnings(
            "ignore", "assembly .* another machine is drawn", RuntimeWarning
        )  # noted below
        recordings = make_rig_recordings(
            arguments.assemblies,
            range(arguments.max_count + 1),
            rig=rig,
            lobes=arguments.lobes,
            speed_rpm=speeds,
            load_nm=arguments.load_nm or _range_around(gearbox.load_torque, rig.loads_nm),
            wear_um=arguments.wear_um or arguments.mixed_wear,
            radial_share=1.0 if arguments.mixed_wear is None else _RADIAL_SHARE,
            output_turns=turns,
            sampling_rate=sampling_rate,
            random_state=arguments.random_state,
            n_jobs=arguments.n_jobs,
            with_angle=True,
            varied_errors=True,
            quantity=quantity,
            kernel=arguments.kernel,
            # Half the time of the midpoint rule; its error is far below the noise of any torque meter.
            # What a corrected model draws was fitted with this step, and no option sets another.
            solver=Solver(integrator="adams_bashforth", check_friction=False),
            progress=progress,
            # Only what the windows need: whole recordings would fill the memory.
            keep=lobe_windower(gearbox.n_lobes, arguments.samples_per_turn).at_lowest_rate,
        )
    if failed := sum("drawn_anew" in (one.meta or {}) for one in recordings):
        note(
            f"{failed} of {len(recordings)} machines could not be simulated: others were drawn in their place"
        )
    return recordings, rig.name


def _range_around(nominal: float, recorded: tuple[float, float] | None) -> tuple[float, float]:
    if recorded is None:
        return nominal / _RANGE, nominal * _RANGE
    return recorded[0] / _RECORDED_RANGE, recorded[1] * _RECORDED_RANGE
