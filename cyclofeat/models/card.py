"""Card beside the file of a model, and the comparisons made before the file is loaded."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from sklearn.base import BaseEstimator

from cyclofeat._base.files import MODEL_PACKAGES, package_versions
from cyclofeat.counting import Evaluation, LobeModel, RadialWear
from cyclofeat.features.base import WindowTransformer
from cyclofeat.features.registry import REGISTRY
from cyclofeat.models.content import ModelFileError

FORMAT = 3
CARD_SUFFIX = ".card.json"
# What may differ between writing and loading: as many leading numbers as are compared. scikit-learn promises
# nothing from one release to the next, the others keep their arrays from one bug fix to the next.
_COMPARED = {"cyclofeat": 3, "scikit-learn": 3, "python": 2, "numpy": 2, "scipy": 2}
FEATURES = "features"
ALLOWED = (*_COMPARED, "joblib", "sklearn", FEATURES)
# What may hold an estimator.
_HOLDERS = (BaseEstimator, RadialWear, dict, list, tuple, np.ndarray)
# Entries of a model's own card that are repeated.
_OF_TRAINING = ("n_recordings", "n_windows", "sources", "quantity", "speeds_rpm", "loads_nm", "wear")
# What each entry of a card must be.
_CARD: dict[str, Callable[[Any], bool]] = {
    "format": lambda value: value == FORMAT,
    "sha256": lambda value: isinstance(value, str) and re.fullmatch("[0-9a-f]{64}", value) is not None,
    "bytes": lambda value: isinstance(value, int),
    "versions": lambda value: (
        isinstance(value, dict) and _COMPARED.keys() <= value.keys() and all(map(_is_text, value.values()))
    ),
    "sampling_rate": lambda value: value is None or (isinstance(value, (int, float)) and value > 0),
    "input_speed_hz": lambda value: value is None or (isinstance(value, (int, float)) and value > 0),
    "n_lobes": lambda value: value is None or isinstance(value, int),
    "training": lambda value: isinstance(value, dict) and _is_text(value.get("description")),
    "classes": lambda value: isinstance(value, list) and bool(value),
    "scores": lambda value: value is None or isinstance(value, dict),
    FEATURES: lambda value: (
        isinstance(value, dict)
        and isinstance(value.get("columns"), list)
        and isinstance(value.get("definitions"), dict)
    ),
}


def _is_text(value: Any) -> bool:
    return isinstance(value, str)


def card_path(path: str | os.PathLike[str]) -> Path:
    """Return the path of a model's card, which lies beside the model."""
    return Path(path).with_name(Path(path).name + CARD_SUFFIX)


def read_card(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Read the card of the model file at a path; the file itself is not read.

    Returns
    -------
    dict
        ``format``, ``holds`` (type), ``sha256``, ``bytes``, ``versions``, ``sampling_rate`` (Hz),
        ``window_samples``, ``samples_per_turn``, ``window_s``, ``input_speed_hz``, ``n_lobes``, ``classes``,
        ``features`` (``columns``, and ``definitions`` with their versions), ``training`` and ``scores``.

    Raises
    ------
    ModelFileError
        Where there is no card, or it cannot be read.
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
    wrong = [key for key, right in _CARD.items() if not (isinstance(card, dict) and right(card.get(key)))]
    if wrong:
        raise ModelFileError(f"card {file} is no card of a model: {', '.join(wrong)} missing or wrong")
    return dict(card)


def feature_definitions(counter: Any) -> dict[str, Any]:
    """Return the ``columns`` of features that a fitted counter or model uses, and their ``definitions``.

    ``columns`` are names in order, ``definitions`` the version of each feature's definition.
    """
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


def estimators_in(model: Any) -> list[Any]:
    """Return the model or counter and all estimators that it holds, each once, outer ones first."""
    inside: dict[int, Any] = {}
    waiting = [model]
    while waiting:
        item = waiting.pop()
        if isinstance(item, (BaseEstimator, RadialWear)):
            if id(item) in inside:
                continue
            inside[id(item)] = item
            item = vars(item)
        if isinstance(item, dict):
            item = list(item.values())
        elif isinstance(item, np.ndarray):
            item = item.ravel().tolist() if item.dtype == object else []
        waiting += [value for value in reversed(item) if isinstance(value, _HOLDERS)]
    return list(inside.values())


def make_card(
    target: Path,
    counter: Any,
    sampling_rate: float | None,
    assemblies: Collection[Any] | None,
    scores: Evaluation | Mapping[str, Any] | None,
    description: str,
) -> dict[str, Any]:
    """Make the card of a counter, without the sum and size of its file."""
    model = counter if isinstance(counter, LobeModel) else None
    made = {} if model is None else model.card_
    inner = counter if model is None else model.counter_
    rate = _parameter(counter, "sampling_rate") if sampling_rate is None else float(sampling_rate)
    if rate is None and model is None:
        raise ValueError(
            "sampling_rate must be given (Hz): no step of the counter states it, and it cannot be guessed"
        )
    samples = int(inner.n_features_in_)
    known = made.get("assemblies") if assemblies is None else list(assemblies)
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
        "samples_per_turn": None if model is None else model.samples_per_turn_,
        "window_s": None if rate is None else samples / rate,
        "input_speed_hz": _parameter(counter, "input_speed_hz"),
        "n_lobes": _parameter(counter, "n_lobes"),
        "classes": inner.classes_,
        FEATURES: feature_definitions(counter),
        "training": {
            "description": description or made.get("description", ""),
            "assemblies": known,
            **{key: made[key] for key in _OF_TRAINING if key in made},
        },
        "scores": made.get("cross_validation") if scores is None else dict(scores),
        "calibrated": made.get("calibrated"),
    }
    plain: dict[str, Any] = _plain(card)
    return plain


def _plain(value: Any) -> Any:
    """Return the value in types that JSON holds; numbers that are not finite become None."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, (list, tuple, set, frozenset)):
        return [_plain(item) for item in value]
    if isinstance(value, np.generic):
        return _plain(value.item())
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return value if value is None or isinstance(value, (str, bool, int, float)) else str(value)


def _parameter(counter: Any, name: str) -> Any:
    """Return a number that the model or one of the counter's steps states; None if none does."""
    if isinstance(counter, LobeModel):
        return counter.n_lobes_ if name == "n_lobes" else None
    stated = (getattr(part, name, None) for part in estimators_in(counter))
    return next((value for value in stated if value is not None), None)


def allowed_differences(allow: Collection[str]) -> set[str]:
    names = {allow} if isinstance(allow, str) else set(allow)
    unknown = names - set(ALLOWED)
    if unknown:
        raise ValueError(f"allow must name any of {', '.join(ALLOWED)}, got {min(unknown, key=str)!r}")
    return {"scikit-learn" if name == "sklearn" else name for name in names}


def check_versions(source: Path, card: Mapping[str, Any], allowed: set[str]) -> None:
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


def first_difference(found: Mapping[str, Any], stated: Mapping[str, Any]) -> str:
    mine, theirs = found["columns"], stated["columns"]
    if len(mine) != len(theirs):
        return f"{len(mine)} columns, the card has {len(theirs)}"
    index = next(i for i, (a, b) in enumerate(zip(mine, theirs, strict=True)) if a != b)
    return f"column {index} is {mine[index]!r}, the card has {theirs[index]!r}"
