"""``cyclofeat evaluate``: how often a counter is right on assemblies that it has not seen."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from cyclofeat._base.progress import Progress
from cyclofeat._base.quantities import QUANTITIES, number_of
from cyclofeat.cli._options import Arguments, Parser, Printed, note, whole_number
from cyclofeat.cli.train import add_counter_options, untrained_model

if TYPE_CHECKING:
    from cyclofeat.counting import Evaluation, LobeModel, Protocol
    from cyclofeat.recordings import Recording

_PAPERS = "Shannon entropy (papers)"


def add_arguments(parser: Parser) -> None:
    parser.add_argument("files", nargs="+", metavar="FILE", help="labelled recordings or folders")
    parser.add_model_file(
        "model to test on the recordings: a file that train wrote, with its card in the same folder, or a "
        f"packaged model, {', '.join(QUANTITIES)} (default: cross-validate the model that train would make)"
    )
    add_counter_options(parser)
    parser.add_argument(
        "--folds", dest="n_splits", type=whole_number(2), default=5, metavar="N",
        help="number of folds (default 5)",
    )  # fmt: skip
    parser.add_seed("folds and counters")
    parser.add_jobs("processes that fit folds side by side")
    parser.add_target("--report", "page", metavar="FILE.html", help="page to write")
    parser.add_reading_options()
    of_training = ("--counter", "--samples-per-turn", "--wear", "--folds", "--jobs")
    parser.add_idle(*of_training, beside=["--model"])


def run(arguments: Arguments) -> Iterator[Printed]:
    """Test a stored model, or cross-validate the one that train would make, then write the page."""
    from cyclofeat.counting import Protocol, evaluate

    protocol = Protocol(
        n_splits=arguments.n_splits, random_state=arguments.random_state, n_jobs=arguments.n_jobs
    )
    if arguments.model is None:
        model = untrained_model(arguments)
    else:
        model = arguments.read_model(arguments.model if arguments.model in QUANTITIES else "")
    recordings = arguments.read_all(arguments.files)
    if any(recording.defect_count is None or recording.assembly is None for recording in recordings):
        raise ValueError("evaluate needs files that state defect_count and assembly, some do not")
    settings = {
        "files": ", ".join(arguments.files[:5]) + (", ..." if len(arguments.files) > 5 else ""),
        "recordings": len(recordings),
    }
    if arguments.model is None:
        arguments.note_duration("cross-validation", 30 + 0.5 * len(recordings))
        results, how = cross_validate(model, recordings, protocol), "folds by assembly"
        settings["options of the model"] = repr(model)
        folds = f"{protocol.n_splits} folds, assemblies of every count shared out by the seed "
        folds += str(protocol.random_state)
    else:
        common = set(model.card_.get("assemblies") or ()) & {recording.assembly for recording in recordings}
        if common:
            note(
                "assemblies of the recordings have names of training assemblies, such as "
                f"{min(common, key=str)!r}: if they are the same, the scores are too high"
            )
        stored = evaluate(model, recordings, protocol=replace(protocol, hold_out="nothing"))
        results, how = {arguments.model: stored}, "tested as stored"
        settings |= {"trained on": model.card_["description"], "for recordings": model.made_for()}
        folds = "none: the model was trained before, on assemblies that must be others than these"
    yield _print_scores(results, how)
    if arguments.report:
        from cyclofeat.report import write_evaluation_report

        sources = [recording.source for recording in recordings]
        arguments.write_report(
            write_evaluation_report, results, sources=sources, folds=folds, settings=settings
        )


def _print_scores(results: dict[str, Evaluation], how: str) -> Printed:
    name, main = next(iter(results.items()))
    lines = [
        f"{number_of(main.labels.size, 'recording')}, assemblies: {main.groups.size}, {how}; 95 % intervals "
        "over assemblies, by bootstrap unless all or none are right",
        main.agreement(),
    ]
    width = max(map(len, results))
    for method, scores in results.items():
        lines.append(f"{method:{width}s}  {scores}")
        if scores.windows is not None:
            lines.append(f"{'':{width}s}  of single windows: {scores.windows}")
    if main.refused is not None:
        accepted = ""
        if main.accepted_accuracy is not None and main.accepted_accuracy_interval is not None:
            low, high = main.accepted_accuracy_interval
            accepted = f"; accuracy of the others {main.accepted_accuracy:.3f} [{low:.3f}, {high:.3f}]"
        lines.append(f"{name} refuses {main.refused:.1%} of the recordings{accepted}")
        lines += [f"  {n} x {reason}" for reason, n in main.to_dict()["reasons"].items()]
    lines.append(
        f"confusion matrix of {name} (rows true, columns predicted), counts {main.classes.tolist()}:"
    )
    lines.append(str(main.confusion))
    return Printed("\n".join(lines), {method: scores.to_dict() for method, scores in results.items()})


def cross_validate(
    model: LobeModel, recordings: Sequence[Recording], protocol: Protocol
) -> dict[str, Evaluation]:
    """Evaluate an untrained model, and one with the papers' best feature, on the same folds of assemblies.

    Recordings state ``assembly`` and ``defect_count``.
    """
    from cyclofeat.counting import LobeModel, evaluate, make_lobe_counter

    seed = model.random_state
    # The windows set the rate.
    by_entropy = make_lobe_counter(128.0, kind="entropy", random_state=seed)
    entropy = LobeModel(model.windower, by_entropy, random_state=seed)
    results: dict[str, Evaluation] = {}
    for name, candidate in {str(model.counter): model, _PAPERS: entropy}.items():
        with Progress(name) as progress:
            results[name] = evaluate(
                candidate.set_params(n_splits=0), recordings, protocol=replace(protocol, progress=progress)
            )
    return results
