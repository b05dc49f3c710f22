"""Models on disk: a file, and beside it a card that says what it is.

===========  ==========================================================================================
file         what it is
===========  ==========================================================================================
``.skops``   data only: it is read piece by piece, and pieces that are not on a list of known types are
             refused (:data:`TRUSTED_TYPES`). Safe to load from anyone; takes some seconds.
``.joblib``  a pickle, which is code: it can do anything when loaded. Loaded only with ``trusted=True``.
===========  ==========================================================================================

The card, ``<file>.card.json``, is for people and for the checks before loading: versions, sampling rate,
window, features with the versions of their definitions, training assemblies, scores, and the file's SHA-256.
The sum finds damage and files mixed up. It is no signature: who changes the file can change the card too.
"""

from __future__ import annotations

import hashlib
import inspect
import io
import json
import os
import re
import warnings
import zipfile
from collections.abc import Callable, Collection, Iterator, Mapping
from pathlib import Path
from typing import Any

import joblib
import numpy as np
from sklearn.base import BaseEstimator
from sklearn.exceptions import InconsistentVersionWarning, NotFittedError
from sklearn.utils.validation import check_is_fitted

from cyclofeat import counting, features
from cyclofeat._files import write_whole
from cyclofeat.counting import Evaluation, LobeModel
from cyclofeat.counting._model import versions
from cyclofeat.counting._trees import CountingTrees, _SideBySide
from cyclofeat.features._base import WindowTransformer
from cyclofeat.features._registry import REGISTRY

FORMAT = 2
SUFFIXES = (".skops", ".joblib")
CARD_SUFFIX = ".card.json"


def _type_names(*types: type) -> tuple[str, ...]:
    return tuple(f"{kind.__module__}.{kind.__qualname__}" for kind in types)


#: What a ``.skops`` file may hold: this package's own types, trees, and these.
PLAIN_TYPES: tuple[str, ...] = (
    *_type_names(dict, list, tuple, set, str, bytes, int, float, bool),
    "numpy.random.mtrand.RandomState",
    # Of scikit-learn's estimators those that counters are made of, and some whose answers are numpy's
    # arithmetic. Others are compiled and believe their numbers: a file could make them read foreign memory.
    "sklearn.pipeline.Pipeline",
    "sklearn.preprocessing._data.StandardScaler",
    "sklearn.preprocessing._label.LabelBinarizer",
    "sklearn.isotonic.IsotonicRegression",
    "sklearn.neural_network._multilayer_perceptron.MLPClassifier",
    "sklearn.tree._classes.ExtraTreeClassifier",
    "sklearn.tree._classes.DecisionTreeClassifier",
    "sklearn.ensemble._forest.ExtraTreesClassifier",
    "sklearn.ensemble._forest.RandomForestClassifier",
    "sklearn.linear_model._logistic.LogisticRegression",
    "sklearn.discriminant_analysis.LinearDiscriminantAnalysis",
    "sklearn.naive_bayes.GaussianNB",
)

#: Of what a ``.skops`` file may hold, what skops does not know by itself.
TRUSTED_TYPES: tuple[str, ...] = (
    *_type_names(
        LobeModel,
        counting.LobeCounter,
        counting.LobeLocator,
        counting.EntropyLadder,
        counting.OrdinalCounter,
        counting.GroupCalibratedCounter,
        counting.ConformalCounter,
        counting.TrainingDomain,
        CountingTrees,
        _SideBySide,
    ),
    *_type_names(
        *(
            kind
            for name in features.__all__
            if inspect.isclass(kind := getattr(features, name)) and issubclass(kind, BaseEstimator)
        )
    ),
    # Compiled: it believes its indices. They are checked after loading, before anything asks a tree.
    "sklearn.tree._tree.Tree",
    # Numbers left over from training a network of lobes; nothing asks it again.
    "sklearn.neural_network._stochastic_optimizers.AdamOptimizer",
)

# What may differ between writing and loading: as many leading numbers as are compared. scikit-learn promises
# nothing from one release to the next, the others keep their arrays from one bug fix to the next.
_COMPARED = {"cyclofeat": 3, "scikit-learn": 3, "python": 2, "numpy": 2, "scipy": 2}
_COMPARED_BY_FORMAT = {".joblib": {"joblib": 1}, ".skops": {"skops": 2}}
_ALIASES = {"sklearn": "scikit-learn"}
FEATURES = "features"
ALLOWED = (*_COMPARED, "joblib", "skops", "sklearn", FEATURES)


class ModelFileError(ValueError):
    """A model file that cannot be read, is not trusted, does not fit its card or holds something else."""


def card_path(path: str | os.PathLike[str]) -> Path:
    """Where the card of a model file lies: beside it."""
    return Path(path).with_name(Path(path).name + CARD_SUFFIX)


def check_model_path(path: str | os.PathLike[str]) -> Path:
    """The path of a model to be written, or an error before anything is trained for it.

    Parameters
    ----------
    path : path-like

    Returns
    -------
    pathlib.Path

    Raises
    ------
    FileNotFoundError
        Where the folder does not exist.
    ImportError
        Where a ``.skops`` file is asked for and skops is not installed.
    ValueError
        Where the name ends in neither ``.skops`` nor ``.joblib``.
    """
    target = Path(path)
    if target.suffix not in SUFFIXES:
        raise ValueError(f"model file must end in .skops (safe) or .joblib (a pickle), got {target.name!r}")
    if not target.parent.is_dir():
        raise FileNotFoundError(f"folder {target.parent} does not exist: make it first")
    if target.suffix == ".skops":
        _skops()
    return target


def save_model(
    path: str | os.PathLike[str],
    counter: Any,
    *,
    sampling_rate: float | None = None,
    assemblies: Collection[Any] | None = None,
    scores: Evaluation | Mapping[str, Any] | None = None,
    description: str = "",
) -> Path:
    """Write a model or a counter, and its card beside it; each file appears whole or not at all.

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
    description : str
        Where the training data come from. Default: that on the model's card.

    Returns
    -------
    pathlib.Path
        The model file.

    Raises
    ------
    FileNotFoundError
        Where the folder does not exist.
    ImportError
        Where a ``.skops`` file is asked for and skops is not installed.
    TypeError
        For anything but a LobeModel or a fitted classifier with ``predict_proba``.
    ValueError
        Where the name ends otherwise, the sampling rate is not known, or a ``.skops`` file cannot hold it.

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
    data = _dump(target, counter)
    card = _card(
        target, counter, data, sampling_rate=sampling_rate, assemblies=assemblies, scores=scores,
        description=description,
    )  # fmt: skip
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
        What may differ from when the file was written: ``"cyclofeat"``, ``"scikit-learn"`` (or
        ``"sklearn"``), ``"python"``, ``"numpy"``, ``"scipy"``, ``"joblib"``, ``"skops"``, ``"features"``
        (their definitions).

    Returns
    -------
    LobeModel or classifier
        What was saved.

    Raises
    ------
    FileNotFoundError
        Where there is no such file.
    ImportError
        Where skops is needed and not installed.
    ModelFileError
        Where the file is not trusted, has no readable card, is not the one that the card belongs to, was
        written by other versions, is damaged or holds something else.
    ValueError
        Where ``allow`` names something unknown.
    """
    source = Path(path)
    allowed = _allowed(allow)
    if not source.is_file():
        raise FileNotFoundError(f"model file {source} does not exist")
    if source.suffix not in SUFFIXES:
        raise ModelFileError(f"{source} is no model file: those end in .skops or .joblib")
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
    _check_versions(source, card, allowed)
    with warnings.catch_warnings():
        # versions were compared above; where they differ, that is allowed
        warnings.simplefilter("ignore", InconsistentVersionWarning)
        loaded = _read_skops(source, data) if source.suffix == ".skops" else _read_joblib(source, data)
    try:
        _check_counter(loaded)
        found = feature_definitions(loaded)
    except (TypeError, ValueError, AttributeError, NotFittedError) as error:
        raise ModelFileError(f"{source} holds no cyclofeat counter: {error}") from error
    if found["columns"] != card[FEATURES]["columns"] and FEATURES not in allowed:
        raise ModelFileError(
            f"{source} makes other features than its card says: {_first_difference(found, card[FEATURES])}; "
            'train anew, or allow it by name: allow=("features",) (--allow features)'
        )
    return loaded


def as_lobe_model(loaded: Any, card: Mapping[str, Any]) -> LobeModel:
    """What :func:`load_model` returned as a model for whole recordings, by what its card says.

    Parameters
    ----------
    loaded : LobeModel or classifier
    card : mapping
        As from :func:`read_card`.

    Returns
    -------
    LobeModel

    Raises
    ------
    ValueError
        Where a counter's windows are not of one output turn.
    """
    if isinstance(loaded, LobeModel):
        return loaded
    return LobeModel.of_counter(
        loaded,
        sampling_rate=card["sampling_rate"],
        input_speed_hz=card["input_speed_hz"] or 500 / 60,
        n_lobes=card["n_lobes"] or 15,
        description=card["training"]["description"],
    )


def read_card(path: str | os.PathLike[str]) -> dict[str, Any]:
    """The card of a model file; the file itself is not touched.

    Parameters
    ----------
    path : path-like
        Of the model file.

    Returns
    -------
    dict
        ``format``, ``holds`` (type), ``sha256``, ``bytes``, ``versions``, ``sampling_rate`` (Hz),
        ``window_samples``, ``window_s``, ``input_speed_hz``, ``n_lobes``, ``classes``, ``features``
        (``columns``, and ``definitions`` with their versions), ``training`` and ``scores``.

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
    if isinstance(card, dict) and isinstance(card.get("format"), int) and card["format"] > FORMAT:
        raise ModelFileError(
            f"card {file} is of format {card['format']}, but {FORMAT} can be read; update cyclofeat"
        )
    wrong = [key for key, right in _CARD.items() if not (isinstance(card, dict) and right(card.get(key)))]
    if wrong:
        raise ModelFileError(f"card {file} is no card of a model: {', '.join(wrong)} missing or wrong")
    return dict(card)


def feature_definitions(counter: Any) -> dict[str, Any]:
    """Columns of the features that a fitted counter or model sees, and the versions of their definitions.

    Parameters
    ----------
    counter : LobeModel or classifier

    Returns
    -------
    dict
        ``columns``: list of str, in order; ``definitions``: name to version.
    """
    columns: list[str] = []
    for part in _parts(counter):
        if isinstance(part, WindowTransformer) and hasattr(part, "n_features_in_"):
            columns += [name for name in map(str, part.get_feature_names_out()) if name not in columns]
    rows = {row.column().split("(")[0]: row for row in REGISTRY.values()}
    named = {name.split("(")[0] for name in columns}
    return {
        "columns": columns,
        "definitions": {rows[base].name: rows[base].version for base in sorted(named) if base in rows},
    }


# What each entry of a card must be.
_CARD: dict[str, Callable[[Any], bool]] = {
    "format": lambda value: value == FORMAT,
    "sha256": lambda value: isinstance(value, str) and re.fullmatch("[0-9a-f]{64}", value) is not None,
    "bytes": lambda value: isinstance(value, int),
    "versions": lambda value: (
        isinstance(value, dict) and _COMPARED.keys() <= value.keys() and all(map(_is_text, value.values()))
    ),
    "sampling_rate": lambda value: isinstance(value, (int, float)) and value > 0,
    "input_speed_hz": lambda value: value is None or (isinstance(value, (int, float)) and value > 0),
    "n_lobes": lambda value: value is None or isinstance(value, int),
    "training": lambda value: isinstance(value, dict) and _is_text(value.get("description")),
    FEATURES: lambda value: (
        isinstance(value, dict)
        and isinstance(value.get("columns"), list)
        and isinstance(value.get("definitions"), dict)
    ),
}


def _is_text(value: Any) -> bool:
    return isinstance(value, str)


def _check_counter(counter: Any) -> None:
    if isinstance(counter, LobeModel):
        counter = counter.counter
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


def _card(
    target: Path,
    counter: Any,
    data: bytes,
    *,
    sampling_rate: float | None,
    assemblies: Collection[Any] | None,
    scores: Evaluation | Mapping[str, Any] | None,
    description: str,
) -> dict[str, Any]:
    model = counter if isinstance(counter, LobeModel) else None
    made = {} if model is None else model.card
    inner = counter if model is None else model.counter
    rate = _parameter(counter, "sampling_rate") if sampling_rate is None else float(sampling_rate)
    if rate is None:
        raise ValueError(
            "sampling_rate must be given (Hz): no step of the counter states it, and it cannot be guessed"
        )
    samples = int(inner.n_features_in_)
    known = made.get("assemblies") if assemblies is None else list(assemblies)
    if isinstance(scores, Evaluation):
        scores = scores.to_dict()
    found = versions()
    if target.suffix == ".skops":
        found["skops"] = _skops().__version__
    card: dict[str, Any] = {
        "format": FORMAT,
        "file": target.name,
        "holds": f"{type(counter).__module__}.{type(counter).__qualname__}",
        "sha256": hashlib.sha256(data).hexdigest(),
        "bytes": len(data),
        "versions": found,
        "sampling_rate": rate,
        "window_samples": samples,
        "window_s": samples / rate,
        "input_speed_hz": _parameter(counter, "input_speed_hz"),
        "n_lobes": _parameter(counter, "n_lobes"),
        "classes": inner.classes_,
        FEATURES: feature_definitions(counter),
        "training": {
            "description": description or made.get("description", ""),
            "assemblies": known,
            **{key: made[key] for key in ("n_recordings", "n_windows", "sources") if key in made},
        },
        "scores": made.get("cross_validation") if scores is None else dict(scores),
        "calibrated": made.get("calibrated"),
    }
    plain: dict[str, Any] = _plain(card)
    return plain


def _plain(value: Any) -> Any:
    """The same in types that JSON holds; what is not finite becomes None."""
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
    """A number that the model or one of the counter's steps states; None where none does."""
    if isinstance(counter, LobeModel):
        return getattr(counter, name)
    return next((value for part in _parts(counter) if (value := getattr(part, name, None)) is not None), None)


def _parts(value: Any, seen: set[int] | None = None) -> Iterator[Any]:
    """A model's estimators, all that they hold included, each once."""
    seen = set() if seen is None else seen
    if isinstance(value, (list, tuple)):
        inside = list(value)
    elif isinstance(value, dict):
        inside = list(value.values())
    elif isinstance(value, (BaseEstimator, LobeModel)):
        if id(value) in seen:
            return
        seen.add(id(value))
        yield value
        inside = list(vars(value).values())
    elif isinstance(value, np.ndarray) and value.dtype == object:
        inside = value.ravel().tolist()
    else:
        return
    for item in inside:
        yield from _parts(item, seen)


def _allowed(allow: Collection[str]) -> set[str]:
    names = {allow} if isinstance(allow, str) else set(allow)
    unknown = names - set(ALLOWED)
    if unknown:
        raise ValueError(f"allow must name any of {', '.join(ALLOWED)}, got {min(unknown, key=str)!r}")
    return {_ALIASES.get(name, name) for name in names}


def _check_versions(source: Path, card: Mapping[str, Any], allowed: set[str]) -> None:
    here = versions()
    compared = _COMPARED | _COMPARED_BY_FORMAT[source.suffix]
    if source.suffix == ".skops":
        here["skops"] = _skops().__version__
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


def _first_difference(found: Mapping[str, Any], stated: Mapping[str, Any]) -> str:
    mine, theirs = found["columns"], stated["columns"]
    if len(mine) != len(theirs):
        return f"{len(mine)} columns, the card has {len(theirs)}"
    index = next(i for i, (a, b) in enumerate(zip(mine, theirs, strict=True)) if a != b)
    return f"column {index} is {mine[index]!r}, the card has {theirs[index]!r}"


def _dump(target: Path, counter: Any) -> bytes:
    if target.suffix == ".joblib":
        buffer = io.BytesIO()
        joblib.dump(counter, buffer, compress=3)
        return buffer.getvalue()
    skops = _skops()
    try:
        data: bytes = skops.io.dumps(counter, compression=zipfile.ZIP_DEFLATED, compresslevel=6)
    except Exception as error:
        raise ValueError(
            f"counter cannot be written as .skops ({type(error).__name__}: {error}): write .joblib"
        ) from error
    unknown = _foreign_types(data)
    if unknown:
        raise ValueError(
            f"counter holds {', '.join(sorted(unknown))}, which .skops files are not trusted with: "
            "write .joblib"
        )
    return data


def _read_joblib(source: Path, data: bytes) -> Any:
    try:
        return joblib.load(io.BytesIO(data))
    except Exception as error:
        raise ModelFileError(
            f"{source} cannot be read as a joblib model ({type(error).__name__}: {error}): it is damaged or "
            "was written by other versions"
        ) from error


def _read_skops(source: Path, data: bytes) -> Any:
    skops = _skops()
    try:
        foreign = _foreign_types(data)
        loaded = None if foreign else skops.io.loads(data, trusted=list(TRUSTED_TYPES))
        _check_trees(loaded)
    except Exception as error:
        raise ModelFileError(
            f"{source} cannot be read as a skops model ({type(error).__name__}: {error}): it is damaged or "
            "was written by other versions"
        ) from error
    if foreign:
        raise ModelFileError(
            f"{source} holds types that no counter needs, it is not loaded: {', '.join(sorted(foreign))}"
        )
    return loaded


def _foreign_types(data: bytes) -> set[str]:
    """Types that a ``.skops`` file must not hold."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        schema = json.loads(archive.read("schema.json"))
    known = {*TRUSTED_TYPES, *PLAIN_TYPES}
    held = {name for name in _types_in(schema) if not re.fullmatch(r"numpy\.\w+", name)}
    return (held | set(_skops().io.get_untrusted_types(data=data))) - known


def _types_in(node: Any) -> Iterator[str]:
    """Names of all types in the schema of a ``.skops`` file."""
    if isinstance(node, dict):
        if "__class__" in node:
            yield f"{node.get('__module__')}.{node['__class__']}"
        for value in node.values():
            yield from _types_in(value)
    elif isinstance(node, list):
        for value in node:
            yield from _types_in(value)


def _check_trees(loaded: Any) -> None:
    """Raise ``ValueError`` where a tree points outside itself; make anew what follows from the trees."""
    for part in _parts(loaded):
        own = getattr(part, "tree_", None)
        if own is not None:
            _check_tree(own, int(part.n_features_in_))
        for tree in getattr(part, "estimators_", ()):
            if hasattr(tree, "tree_") and tree.n_features_in_ != part.n_features_in_:
                raise ValueError("trees of one forest see different numbers of features")
        if isinstance(part, CountingTrees) and hasattr(part, "estimators_"):
            part.side_by_side_ = _SideBySide.of(part) if part.n_outputs_ == 1 else None


def _check_tree(tree: Any, n_features: int) -> None:
    left, right, feature = tree.children_left, tree.children_right, tree.feature
    node = np.arange(tree.node_count)
    leaf = left == -1
    inner = ~leaf
    # children come after their parents: so a way through the tree has an end
    sound = (
        tree.node_count > 0
        and tree.n_features == n_features
        and np.array_equal(leaf, right == -1)
        and np.all((left > node) & (left < node.size) | leaf)
        and np.all((right > node) & (right < node.size) | leaf)
        and np.all((feature[inner] >= 0) & (feature[inner] < n_features))
        and len(tree.value) == node.size
        and 0 <= tree.max_depth < max(node.size, 1)
    )
    if not sound:
        raise ValueError("a tree's nodes point outside the tree or the features")


def _skops() -> Any:
    try:
        import skops
        import skops.io
        import skops.io.exceptions
    except ImportError:
        raise ImportError(
            "skops is needed for .skops files: pip install 'cyclofeat[export]' (.joblib needs nothing more)"
        ) from None
    return skops
