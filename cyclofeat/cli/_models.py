"""Options of commands that count with a stored model."""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from importlib import import_module
from typing import TYPE_CHECKING, cast

from cyclofeat._base.quantities import QUANTITIES, in_words
from cyclofeat.cli._idle import add_idle
from cyclofeat.cli._printing import note

if TYPE_CHECKING:
    from cyclofeat.counting import LobeCount, LobeModel
    from cyclofeat.recordings import Recording


def add_model_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that name a model, and the one that cuts the start of each recording."""
    add_model_file(parser)
    parser.add_argument(
        "--skip", type=float, default=0.0, help="seconds to leave out at the start (run-up of the machine)"
    )


def add_model_file(parser: argparse.ArgumentParser) -> None:
    """Add the options that name a model and state how it is loaded."""
    parser.add_argument(
        "--model",
        help="model file that train wrote, with its card in the same folder (default: the packaged model of "
        "the quantity, trained on simulated assemblies of rig R2 at 100 to 1,500 RPM and 3 to 40 Nm)",
    )
    parser.add_argument(
        "--trust",
        "--trust-model",
        dest="trust",
        action="store_true",
        help="load a joblib model, which can run any code (a .skops model needs no trust)",
    )
    parser.add_argument(
        "--allow",
        action="append",
        default=[],
        metavar="NAME",
        help="accept a version other than the model's, of scikit-learn, numpy, features, ...",
    )
    add_idle(parser, "--trust", beside=["--model *.skops"])
    add_idle(parser, "--trust", "--allow", without=["--model"])


def read_model(arguments: argparse.Namespace) -> LobeModel:
    """Return the model that the options name, or the packaged one, which is then stated."""
    _import_scikit_learn()
    from cyclofeat.models import load_default_model, load_model
    from cyclofeat.models.card import read_card
    from cyclofeat.models.persistence import as_lobe_model

    if arguments.model is None:
        model = load_default_model(arguments.quantity or QUANTITIES[0])
        note(f"model: {model_name(arguments)}, trained on {model.card['description']}")
        return model
    loaded = load_model(arguments.model, trusted=arguments.trust, allow=arguments.allow)
    return as_lobe_model(loaded, read_card(arguments.model))


def count_with_warnings(model: LobeModel, recording: Recording) -> LobeCount:
    """Count a recording; warnings about the record itself follow those of the count."""
    from cyclofeat.datasets.readers import record_warnings

    count = model.count(recording)
    of_record = record_warnings(recording, reduction=model.n_lobes)
    return replace(count, warnings=(*count.warnings, *of_record))


def model_name(arguments: argparse.Namespace) -> str:
    """Return what names the model in a result: its file, or which of the packaged ones it is."""
    return arguments.model or f"packaged, {in_words(arguments.quantity or QUANTITIES[0])}"


def _import_scikit_learn() -> None:
    """Import scikit-learn without pandas: half a second that no count needs."""
    if "pandas" in sys.modules:
        return
    hidden = cast("dict[str, None]", sys.modules)
    hidden["pandas"] = None  # an import finds nothing
    try:
        import_module("sklearn.base")
    finally:
        del hidden["pandas"]


def without_start(recording: Recording, seconds: float) -> Recording:
    """Return a recording without its first seconds."""
    if not 0 <= seconds < recording.duration:
        raise ValueError(f"--skip must lie within the {recording.duration:g} s recorded, got {seconds:g} s")
    return recording.part(seconds) if seconds else recording
