"""Models on disk: a file, and beside it a card that says what it is.

A ``.skops`` file is data only: it is read piece by piece, without skops, and pieces that are not on a list of
known types are refused, so that it is safe to load from anyone. A ``.joblib`` file is a pickle, which is code
that can do anything when loaded: it is loaded only with ``trusted=True``.

The card, ``<file>.card.json``, is for people and for the checks before loading (:func:`read_card`). Its
SHA-256 finds damage and files mixed up. It is no signature: who changes the file can change the card too.
"""

from __future__ import annotations

import hashlib
import json
import os
import warnings
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

from sklearn.base import BaseEstimator
from sklearn.exceptions import InconsistentVersionWarning, NotFittedError
from sklearn.utils.validation import check_is_fitted

from cyclofeat._base.checks import one_of
from cyclofeat._base.files import check_parent, write_whole
from cyclofeat._base.quantities import QUANTITIES
from cyclofeat.counting import Evaluation, LobeModel
from cyclofeat.models.card import (
    ALLOWED,
    FEATURES,
    card_path,
    check_versions,
    feature_definitions,
    make_card,
    read_card,
)
from cyclofeat.models.content import ModelFileError, dump_model, import_skops, parse_model

SUFFIXES = (".skops", ".joblib")
# Folder of the packaged models: one for each quantity, trained on simulated assemblies.
_DEFAULTS = Path(__file__).with_name("default")
# They are tested with each supported version of these.
_TESTED_WITH = ("python", "numpy", "scipy", "scikit-learn")


def check_model_path(path: str | os.PathLike[str]) -> Path:
    """Return the path; raise an error unless a model can be written there, before it is trained."""
    target = Path(path)
    if target.suffix not in SUFFIXES:
        raise ValueError(f"model file must end in .skops (safe) or .joblib (a pickle), got {target.name!r}")
    check_parent(target)
    if target.suffix == ".skops":
        import_skops()
    return target


def save_model(
    path: str | os.PathLike[str],
    counter: Any,
    *,
    sampling_rate: float | None = None,
    assemblies: Collection[Any] | None = None,
    scores: Evaluation | Mapping[str, Any] | None = None,
) -> Path:
    """Write a model or a counter, and its card beside it, and return the model file's path.

    Each file appears whole or not at all.

    Parameters
    ----------
    path : path-like
        File to write, ``*.skops`` or ``*.joblib``.
    counter : LobeModel or classifier
        A model, or any fitted classifier of windows. ``.skops`` takes the counters of this package.
    sampling_rate : float, optional
        In Hz, of the windows that the counter was fitted to. Default: that of the model or of the counter's
        own steps.
    assemblies : collection, optional
        Assemblies in training. Default: those on the model's card.
    scores : Evaluation or mapping, optional
        What is known of its accuracy. Default: the cross-validation on the model's card.

    Returns
    -------
    pathlib.Path

    Raises
    ------
    FileNotFoundError, ImportError
        Where the folder does not exist, or skops is needed and not installed.
    TypeError, ValueError
        For anything but a LobeModel or a fitted classifier with ``predict_proba``; where the name ends
        otherwise, the sampling rate is not known, or a ``.skops`` file cannot hold it.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> import numpy as np
    >>> from cyclofeat.counting import make_lobe_counter
    >>> windows = np.random.default_rng(0).normal(size=(4, 46_080))
    >>> counter = make_lobe_counter(25_600, kind="ladder").fit(windows, [0, 0, 1, 1])
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = save_model(pathlib.Path(folder, "ladder.joblib"), counter, assemblies=["A", "B"])
    ...     loaded = load_model(file, trusted=True)
    ...     read_card(file)["window_s"], read_card(file)["features"]["definitions"]
    (1.8, {'shannon_entropy': 1})
    >>> np.array_equal(loaded.predict(windows), counter.predict(windows))
    True
    """
    target = check_model_path(path)
    _check_counter(counter)
    data = dump_model(target, counter)
    card = make_card(target, counter, sampling_rate, assemblies, scores)
    card |= {"sha256": hashlib.sha256(data).hexdigest(), "bytes": len(data)}
    text = json.dumps(card, indent=2, allow_nan=False) + "\n"
    write_whole(target, lambda file: file.write(data))
    write_whole(card_path(target), lambda file: file.write(text.encode()))
    return target


def load_model(path: str | os.PathLike[str], *, trusted: bool = False, allow: Collection[str] = ()) -> Any:
    """Read what :func:`save_model` wrote.

    Parameters
    ----------
    path : path-like
        File to read, with its card beside it.
    trusted : bool
        Whether the file comes from a trusted source; needed for ``.joblib``, which can run any code when
        loaded.
    allow : collection of str
        What may differ from when the file was written: ``"cyclofeat"``, ``"scikit-learn"``, ``"python"``,
        ``"numpy"``, ``"scipy"``, ``"joblib"``, ``"features"`` (their definitions).

    Returns
    -------
    LobeModel or classifier
        What was saved.

    Raises
    ------
    FileNotFoundError
        Where there is no such file.
    ModelFileError
        Where the file is not trusted, has no readable card, is not the one that the card belongs to, was
        written by other versions, is damaged or holds something else.
    """
    source = Path(path)
    allowed = {allow} if isinstance(allow, str) else {*allow}
    if unknown := allowed - {*ALLOWED}:
        raise ValueError(f"allow must name any of {', '.join(ALLOWED)}, got {min(unknown, key=str)!r}")
    if not source.exists():
        raise FileNotFoundError(f"model file {source} does not exist")
    if source.suffix not in SUFFIXES or source.is_dir():
        what = "a folder, no model file" if source.is_dir() else "no model file"
        raise ModelFileError(f"{source} is {what}: those end in .skops or .joblib")
    if source.suffix == ".joblib" and not trusted:
        raise ModelFileError(
            f"{source} is a joblib file, which can run any code when loaded: if you trust where it comes "
            "from, load it with trusted=True (--trust on the command line); .skops files need no trust"
        )
    card = read_card(source)
    data = source.read_bytes()  # once: what was checked is what is loaded
    if hashlib.sha256(data).hexdigest() != card["sha256"]:
        raise ModelFileError(
            f"{source} is not the file that its card describes ({len(data)} bytes here, {card['bytes']} "
            "written; SHA-256 differs): damaged, changed or the card of another file"
        )
    check_versions(source, card, allowed)
    with warnings.catch_warnings():
        # versions were compared above; where they differ, that is allowed
        warnings.simplefilter("ignore", InconsistentVersionWarning)
        loaded = parse_model(source, data)
    try:
        _check_counter(loaded)
        columns = feature_definitions(loaded)["columns"]
    except (TypeError, ValueError, AttributeError, NotFittedError) as error:
        raise ModelFileError(f"{source} holds no cyclofeat counter: {error}") from error
    stated = card[FEATURES]["columns"]
    if columns != stated and FEATURES not in allowed:
        difference = f"{len(columns)} columns, the card has {len(stated)}"
        if len(columns) == len(stated):
            index = next(i for i, name in enumerate(columns) if name != stated[i])
            difference = f"column {index} is {columns[index]!r}, the card has {stated[index]!r}"
        raise ModelFileError(
            f"{source} makes other features than its card says: {difference}; train anew, or allow it by "
            'name: allow=("features",) (--allow features)'
        )
    return loaded


def load_default_model(quantity: str = "output_torque") -> LobeModel:
    """Read the packaged model of a quantity.

    It has learned from simulated assemblies of rig R2 (:func:`cyclofeat.datasets.make_rig_recordings`), whose
    brake, torque meter and contacts vary, at 100 to 1,500 RPM and 3 to 40 Nm. A model of a rig whose brake is
    known counts better: ``benchmarks/operating_points.md``.

    Parameters
    ----------
    quantity : {"output_torque", "input_torque", "motor_current"}, default="output_torque"
        What the recordings hold.

    Returns
    -------
    cyclofeat.counting.LobeModel
        The fitted model.

    Examples
    --------
    >>> model = load_default_model("motor_current")
    >>> model.made_for()
    'of motor current at 99.23 to 1511 RPM and 3 to 40 Nm, with at least 37 samples per input turn'
    >>> model.samples_per_turn_, model.coarser_.samples_per_turn_
    (128, 37)
    """
    file = _DEFAULTS / f"{one_of('quantity', quantity, QUANTITIES)}.skops"
    loaded: LobeModel = load_model(file, allow=_TESTED_WITH)
    return loaded


def as_lobe_model(loaded: Any) -> LobeModel:
    """Return a loaded model; raise ``ValueError`` for a counter of windows."""
    if isinstance(loaded, LobeModel):
        return loaded
    raise ValueError(
        f"the model must count recordings, got {type(loaded).__name__}, which counts windows: train it with "
        "LobeModel(counter=...).fit(recordings)"
    )


def _check_counter(counter: Any) -> None:
    if isinstance(counter, LobeModel):
        counter = counter.counter_
    elif not isinstance(counter, BaseEstimator) or not hasattr(counter, "predict_proba"):
        raise TypeError(
            f"counter must be a LobeModel or a classifier with predict_proba, got {type(counter).__name__}"
        )
    try:
        check_is_fitted(counter)
    except NotFittedError:
        raise TypeError(f"counter must be fitted, got {type(counter).__name__} that is not") from None
    if not hasattr(counter, "classes_"):
        raise TypeError(f"counter must have classes_, got {type(counter).__name__} without")
