"""``cyclofeat features``: which features depend on the number of worn lobes, and how gradually."""

from __future__ import annotations

from collections.abc import Iterator

from cyclofeat._base.progress import Progress
from cyclofeat._base.quantities import number_of
from cyclofeat.cli._options import Arguments, Parser, Printed

_PRINTED = 12


def add_arguments(parser: Parser) -> None:
    parser.add_argument(
        "files", nargs="+", metavar="FILE", help="labelled recordings or folders, of one speed"
    )
    parser.add_argument(
        "--features",
        nargs="+",
        metavar="NAME",
        help="transformers, such as LobeMap SpectralEntropy (default: all)",
    )
    parser.add_seed("bootstrap and folds")
    parser.add_target(
        "--report", "page", metavar="FILE.html", help="page to write: table, histograms, and the code"
    )
    parser.add_reading_options()


def run(arguments: Arguments) -> Iterator[Printed]:
    """Compute all features of all windows, rank them, then write the page."""
    from cyclofeat.counting import rank_features
    from cyclofeat.counting.evaluation.rank_features import features_held_out
    from cyclofeat.features import TorqueFeatures
    from cyclofeat.recordings import Windower

    recordings = arguments.read_all(arguments.files)
    X, y, groups = Windower().transform(recordings)
    speed, n_lobes = recordings[0].input_speed_hz, recordings[0].n_lobes
    assert speed is not None  # else windows have no length
    transformer = TorqueFeatures(
        recordings[0].sampling_rate, arguments.features or "all", input_speed_hz=speed, n_lobes=n_lobes
    )
    with Progress("computing features"):
        features = features_held_out(transformer, X, y, groups, random_state=arguments.random_state)
        table = rank_features(features, y, groups, random_state=arguments.random_state)
    shown = table.iloc[:_PRINTED][["trend", "trend_low", "trend_high", "monotonicity", "kruskal_p"]]
    lines = [
        f"{number_of(len(table), 'feature')}, {number_of(len(X), 'window')}, assemblies: {len(set(groups))}; "
        "most gradual first, 95 % bootstrap intervals over assemblies",
        shown.to_string(float_format=lambda value: f"{value:.3g}"),
    ]
    yield Printed("\n".join(lines), table.to_dict("index"))
    if arguments.report:
        from cyclofeat.report import write_features_report

        arguments.write_report(write_features_report, table, features, y, groups, transformer=transformer)
