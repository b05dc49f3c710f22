"""Content of a model's file: types that it may hold, writing and reading."""

from __future__ import annotations

import inspect
import io
import json
import re
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import joblib
import numpy as np
from sklearn.base import BaseEstimator

from cyclofeat import counting, features
from cyclofeat.counting import LobeModel
from cyclofeat.counting.estimators.trees import CountingTrees, TreeTable


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
    "sklearn.tree._classes.ExtraTreeRegressor",
    "sklearn.tree._classes.DecisionTreeClassifier",
    "sklearn.ensemble._forest.ExtraTreesClassifier",
    "sklearn.ensemble._forest.ExtraTreesRegressor",
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
        counting.RowCounter,
        counting.LobeLocator,
        counting.EntropyLadder,
        counting.GroupCalibratedCounter,
        counting.ConformalRegressor,
        counting.RadialWear,
        counting.TrainingDomain,
        CountingTrees,
        TreeTable,
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


class ModelFileError(ValueError):
    """Error of a model file that cannot be read, is not trusted, or does not fit its card."""


def dump(target: Path, counter: Any) -> bytes:
    if target.suffix == ".joblib":
        buffer = io.BytesIO()
        joblib.dump(counter, buffer, compress=3)
        return buffer.getvalue()
    skops = the_skops()
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


def read_joblib(source: Path, data: bytes) -> Any:
    try:
        return joblib.load(io.BytesIO(data))
    except Exception as error:
        raise ModelFileError(
            f"{source} cannot be read as a joblib model ({type(error).__name__}: {error}): it is damaged or "
            "was written by other versions"
        ) from error


def read_skops(source: Path, data: bytes) -> Any:
    skops = the_skops()
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


def estimators_in(value: Any, seen: set[int] | None = None) -> Iterator[Any]:
    """Yield all estimators that a model holds, each once."""
    seen = set() if seen is None else seen
    if isinstance(value, (list, tuple)):
        inside = list(value)
    elif isinstance(value, dict):
        inside = list(value.values())
    elif isinstance(value, (BaseEstimator, counting.RadialWear)):
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
        yield from estimators_in(item, seen)


def _foreign_types(data: bytes) -> set[str]:
    """Types that a ``.skops`` file must not hold."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        schema = json.loads(archive.read("schema.json"))
    known = {*TRUSTED_TYPES, *PLAIN_TYPES}
    held = {name for name in _types_in(schema) if not re.fullmatch(r"numpy\.\w+", name)}
    return (held | set(the_skops().io.get_untrusted_types(data=data))) - known


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
    for part in estimators_in(loaded):
        own = getattr(part, "tree_", None)
        if own is not None:
            _check_tree(own, int(part.n_features_in_))
        for tree in getattr(part, "estimators_", ()):
            if hasattr(tree, "tree_") and tree.n_features_in_ != part.n_features_in_:
                raise ValueError("trees of one forest see different numbers of features")
        if isinstance(part, CountingTrees) and hasattr(part, "estimators_"):
            part.make_table()


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


def the_skops() -> Any:
    try:
        import skops.io
    except ImportError:
        raise ImportError(
            "skops is needed for .skops files: pip install skops (.joblib needs nothing more)"
        ) from None
    return skops
