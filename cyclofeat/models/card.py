"""Card beside the file of a model, and the comparisons made before the file is loaded."""

from __future__ import annotations

import json
import os
from collections.abc import Collection, Mapping
from pathlib import Path
from types import NoneType
from typing import Any

import numpy as np

from cyclofeat._base.files import MODEL_PACKAGES, package_versions
from cyclofeat.counting import Evaluation, LobeModel
from cyclofeat.counting.evaluation.assembly_folds import estimators_in
from cyclofeat.features.base import WindowTransformer
from cyclofeat.features.registry import REGISTRY
from cyclofeat.models.content import ModelFileError

FORMAT = 3
CARD_SUFFIX = ".card.json"
# What may differ between writing and loading: as many leading numbers as are compared. scikit-learn promises
# nothing from one release to the next, the others keep their arrays from one bug fix to the next.
_COMPARED = {"cyclofeat": 3, "scikit-learn": 3, "python": 2, "numpy": 2, "scipy": 2}
FEATURES = "features"
ALLOWED = (*_COMPARED, "joblib", FEATURES)
# Entries of a model's own card that are repeated.
_OF_TRAINING = (
    "n_recordings", "n_windows", "sources", "quantity", "speeds_rpm", "loads_nm", "wear", "domain",
)  # fmt: skip
# Types of the entries that every card has.
_CARD: dict[str, tuple[type, ...]] = {
    "format": (int,),
    "sha256": (str,),
    "bytes": (int,),
    "versions": (dict,),
    "sampling_rate": (int, float, NoneType),
    "input_speed_hz": (int, float, NoneType),
    "n_lobes": (int, NoneType),
    "training.description": (str,),
    "classes": (list,),
    "scores": (dict, NoneType),
    f"{FEATURES}.columns": (list,),
    f"{FEATURES}.definitions": (dict,),
}


def card_path(path: str | os.PathLike[str]) -> Path:
    """Return the path of a model's card, which lies beside the model."""
    return Path(path).with_name(Path(path).name + CARD_SUFFIX)


def read_card(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Read the card of the model file at a path; the file itself is not read.

    It holds ``format``, ``holds`` (type), ``sha256``, ``bytes``, ``versions``, ``sampling_rate`` (Hz),
    ``window_samples``, ``samples_per_turn``, ``window_s``, ``input_speed_hz``, ``n_lobes``, ``classes``,
    ``features`` (``columns``, and ``definitions`` with their versions), ``training`` and ``scores``. A
    ModelFileError is raised without a card that can be read.
    """
    file = card_path(path)
    if not file.is_file():
        raise ModelFileError(f"{path} has no card: {file.name} must lie beside it, copy both files")
    try:
        card = json.loads(file.read_bytes())
    except (UnicodeDecodeError, json.JSONDecodeError, RecursionError) as error:
        what = "is empty" if file.stat().st_size == 0 else f"cannot be read as JSON ({error})"
        raise ModelFileError(f"card {file} {what}: copy both files again") from None
    if isinstance(card, dict) and isinstance(card.get("format"), int) and card["format"] != FORMAT:
        what = "update cyclofeat" if card["format"] > FORMAT else "train the model again"
        raise ModelFileError(f"card {file} is of format {card['format']}, but {FORMAT} can be read; {what}")
    wrong = []
    for path_in_card, kinds in _CARD.items():
        value = card
        for key in path_in_card.split("."):
            value = value.get(key, ...) if isinstance(value, dict) else ...
        if not isinstance(value, kinds):
            wrong.append(path_in_card)
    if wrong:
        raise ModelFileError(f"card {file} is no card of a model: {', '.join(wrong)} missing or wrong")
    return dict(card)


def feature_definitions(counter: Any) -> dict[str, Any]:
    """Return the names, in order, of a fitted counter's ``columns``, and the versions of ``definitions``."""
    columns: list[str] = []
    for part in estimators_in(counter):
        if isinstance(part, WindowTransformer) and hasattr(part, "n_features_in_"):
            columns += [name for name in map(str, part.get_feature_names_out()) if name not in columns]
    rows = {row.column().split("(")[0]: row for row in REGISTRY.values()}
    named = {name.split("(")[0] for name in columns}
    return {
        "columns": columns,
        "definitions": {rows[base].name: rows[base].version for base in sorted(named) if base in rows},
    }


def make_card(
    target: Path,
    counter: Any,
    sampling_rate: float | None,
    assemblies: Collection[Any] | None,
    scores: Evaluation | Mapping[str, Any] | None,
) -> dict[str, Any]:
    """Make the card of a counter, without the sum and size of its file."""
    if isinstance(counter, LobeModel):
        inner, own_card, per_turn = counter.counter_, counter.card_, counter.samples_per_turn_
        stated: dict[str, Any] = {"n_lobes": counter.n_lobes_}
    else:
        inner, own_card, per_turn = counter, {}, None
        steps = estimators_in(counter)
        stated = {
            name: next((x for step in steps if (x := getattr(step, name, None)) is not None), None)
            for name in ("sampling_rate", "input_speed_hz", "n_lobes")
        }
    rate = stated.get("sampling_rate") if sampling_rate is None else float(sampling_rate)
    if rate is None and inner is counter:
        raise ValueError(
            "sampling_rate must be given (Hz): no step of the counter states it, and it cannot be guessed"
        )
    samples = int(inner.n_features_in_)
    if isinstance(scores, Evaluation):
        scores = scores.to_dict()
    versions = package_versions(*MODEL_PACKAGES, *(["skops"] if target.suffix == ".skops" else []))
    card: dict[str, Any] = {
        "format": FORMAT,
        "file": target.name,
        "holds": f"{type(counter).__module__}.{type(counter).__qualname__}",
        "versions": versions,
        "sampling_rate": rate,
        "window_samples": samples,
        "samples_per_turn": per_turn,
        "window_s": None if rate is None else samples / rate,
        "input_speed_hz": stated.get("input_speed_hz"),
        "n_lobes": stated["n_lobes"],
        "classes": inner.classes_,
        FEATURES: feature_definitions(counter),
        "training": {
            "description": own_card.get("description", ""),
            "assemblies": own_card.get("assemblies") if assemblies is None else list(assemblies),
            **{key: own_card[key] for key in _OF_TRAINING if key in own_card},
        },
        "scores": own_card.get("cross_validation") if scores is None else dict(scores),
        "calibrated": own_card.get("calibrated"),
    }
    return {key: _json_value(value) for key, value in card.items()}


def _json_value(value: Any) -> Any:
    """Return the value in types that JSON holds; numbers that are not finite become None."""
    if isinstance(value, (np.ndarray, np.generic)):
        value = value.tolist()
    if isinstance(value, Mapping):
        return {str(key): _json_value(item) for key, item in value.items()}
    if isinstance(value, (list, tuple, set, frozenset)):
        return [_json_value(item) for item in value]
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return value if value is None or isinstance(value, (str, bool, int, float)) else str(value)


def check_versions(source: Path, card: Mapping[str, Any], allowed: set[str]) -> None:
    """Raise ModelFileError if the file was written by other versions than those here or allowed."""
    here = package_versions(*MODEL_PACKAGES)
    compared = _COMPARED | ({"joblib": 1} if source.suffix == ".joblib" else {})
    differences = {}
    for name, parts in compared.items():
        written = str(card["versions"].get(name, "unknown"))
        if written.split(".")[:parts] != here[name].split(".")[:parts]:
            differences[name] = f"{name} {written} (here {here[name]})"
    for name, version in card[FEATURES]["definitions"].items():
        row = REGISTRY.get(name)
        if row is None or row.version != version:
            now = "unknown" if row is None else f"version {row.version}"
            differences.setdefault(FEATURES, f"feature {name} version {version} (here {now})")
    refused = [name for name in differences if name not in allowed]
    if refused:
        names = ", ".join(f'"{name}"' for name in refused) + ("," if len(refused) == 1 else "")
        options = " ".join(f"--allow {name}" for name in refused)
        raise ModelFileError(
            f"{source} was written with {', '.join(differences[name] for name in refused)}: train anew, or "
            f"allow the difference by name: allow=({names}) ({options})"
        )
