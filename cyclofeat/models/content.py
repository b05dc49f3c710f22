"""Content of a model's file: what it may hold, writing and reading.

A ``.skops`` file is a zip of ``schema.json`` and arrays. skops writes it; the reader here knows plain values,
arrays and the classes of counters, and reads ten models in the second that skops takes to import.
"""

from __future__ import annotations

import dataclasses
import io
import json
import re
import zipfile
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

import joblib
import numpy as np
from numpy.lib.format import read_array
from sklearn.base import BaseEstimator

# Schemas of skops that the reader knows.
_PROTOCOLS = (0, 1, 2)
# Rooms whose estimators and dataclasses a file may hold.
_ROOMS = re.compile(r"cyclofeat\.(counting|features|recordings)(\.\w+)+")
# Of scikit-learn's estimators those that counters are made of, and some whose answers are numpy's
# arithmetic. Others are compiled and believe their numbers: a file could make them read foreign memory.
_OF_SKLEARN = frozenset({
    "sklearn.pipeline.Pipeline",
    "sklearn.preprocessing._data.StandardScaler",
    "sklearn.preprocessing._label.LabelBinarizer",
    "sklearn.isotonic.IsotonicRegression",
    "sklearn.neural_network._multilayer_perceptron.MLPClassifier",
    "sklearn.neural_network._stochastic_optimizers.AdamOptimizer",
    "sklearn.tree._classes.ExtraTreeClassifier",
    "sklearn.tree._classes.ExtraTreeRegressor",
    "sklearn.tree._classes.DecisionTreeClassifier",
    "sklearn.ensemble._forest.ExtraTreesClassifier",
    "sklearn.ensemble._forest.ExtraTreesRegressor",
    "sklearn.ensemble._forest.RandomForestClassifier",
    "sklearn.linear_model._logistic.LogisticRegression",
    "sklearn.discriminant_analysis.LinearDiscriminantAnalysis",
    "sklearn.naive_bayes.GaussianNB",
})  # fmt: skip
_KEY_TYPES = {"str": str, "int": int, "float": float}


class ModelFileError(ValueError):
    """Error of a model file that cannot be read, is not trusted, or does not fit its card."""


class _ForeignTypeError(TypeError):
    """Error of a file that holds a type that no counter needs."""


def dump_model(target: Path, counter: Any) -> bytes:
    """Return the content of the file of a counter, in the format that the target's name asks for."""
    if target.suffix == ".joblib":
        buffer = io.BytesIO()
        joblib.dump(counter, buffer, compress=3)
        return buffer.getvalue()
    skops_io = import_skops()
    try:
        data: bytes = skops_io.dumps(counter, compression=zipfile.ZIP_DEFLATED, compresslevel=6)
        build_model(data)
    except _ForeignTypeError as error:
        raise ValueError(f"counter {error}: write .joblib") from None
    except Exception as error:
        raise ValueError(
            f"counter cannot be written as .skops ({type(error).__name__}: {error}): write .joblib"
        ) from error
    return data


def parse_model(source: Path, data: bytes) -> Any:
    """Return what a file holds: a ``.skops`` file runs no code, a pickle can run any."""
    joblib_file = source.suffix == ".joblib"
    try:
        return joblib.load(io.BytesIO(data)) if joblib_file else build_model(data)
    except _ForeignTypeError as error:
        raise ModelFileError(f"{source} {error}: it is not loaded") from None
    except Exception as error:
        kind = "joblib" if joblib_file else "skops"
        raise ModelFileError(
            f"{source} cannot be read as a {kind} model ({type(error).__name__}: {error}): it is damaged or "
            "was written by other versions"
        ) from error


def build_model(data: bytes) -> Any:
    """Build what a ``.skops`` file describes; nothing but classes on the list is imported or called."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        schema = json.loads(archive.read("schema.json"))
        if schema["protocol"] not in _PROTOCOLS:
            raise ValueError(
                f"its protocol is {schema['protocol']}, known are {_PROTOCOLS}: update cyclofeat"
            )
        return _Builder(archive).build(schema)


class _Builder:
    """Builder of the objects that the nodes of a schema describe; a node of a known id is built once."""

    def __init__(self, archive: zipfile.ZipFile) -> None:
        self._archive = archive
        self._built: dict[int, Any] = {}

    def build(self, node: dict[str, Any]) -> Any:
        loader = node["__loader__"]
        if loader == "JsonNode":  # most of them
            return json.loads(node["content"])
        identity = int(node["__id__"])
        if identity not in self._built:
            self._built[identity] = self._build_new(loader, node)
        return self._built[identity]

    def _build_new(self, loader: str, node: dict[str, Any]) -> Any:
        name = f"{node['__module__']}.{node['__class__']}"
        content: Any = node.get("content")
        match loader, name:
            case "DictNode", "builtins.dict":
                keys = [_KEY_TYPES[kind["__class__"]] for kind in node["key_types"]["content"]]
                items = zip(keys, content.items(), strict=True)
                return {kind(key): self.build(value) for kind, (key, value) in items}
            case "ListNode", "builtins.list":
                return [self.build(item) for item in content]
            case "TupleNode", "builtins.tuple":
                return tuple(self.build(item) for item in content)
            case "BytesNode", "builtins.bytes":
                return self._archive.read(node["file"])
            case "NdArrayNode", _ if node["type"] == "numpy":
                array = read_array(io.BytesIO(self._archive.read(node["file"])), allow_pickle=False)
                return array if name == "numpy.ndarray" else array[()]
            case "NdArrayNode", "numpy.ndarray":  # of objects
                array = np.empty(self.build(node["shape"]), dtype=object)
                array.ravel()[:] = [self.build(item) for item in content]
                return array
            case "RandomStateNode", "numpy.random.mtrand.RandomState":
                random = np.random.RandomState()
                random.set_state(self.build(content))
                return random
            case "TreeNode", "sklearn.tree._tree.Tree":
                n_features, n_classes, n_outputs = self.build(node["__reduce__"]["args"])
                state = self.build(content)
                # A compiled tree believes its sizes.
                if np.shape(n_classes) != (n_outputs,) or state["node_count"] != len(state["nodes"]):
                    raise ValueError("a tree's sizes disagree with its arrays")
                tree = import_module("sklearn.tree._tree").Tree(n_features, n_classes, n_outputs)
                tree.__setstate__(state)
                return tree
            case "ObjectNode", _:
                return _build_object(_find_class(name), self.build(content))
        raise _ForeignTypeError(f"holds {name}, which no counter needs")


@cache
def _find_class(name: str) -> type:
    """Return the class of this name, if a file may hold it."""
    module, _, own_name = name.rpartition(".")
    if name in _OF_SKLEARN or _ROOMS.fullmatch(module):
        kind = getattr(import_module(module), own_name, None)
        if isinstance(kind, type) and kind.__module__ == module:
            known = name in _OF_SKLEARN or issubclass(kind, BaseEstimator) or dataclasses.is_dataclass(kind)
            if known:
                return kind
    raise _ForeignTypeError(f"holds {name}, which no counter needs")


def _build_object(kind: type, state: Any) -> Any:
    """Build an object without calling its ``__init__``; raise ``ValueError`` for trees that are not sound."""
    built: Any = object.__new__(kind)
    if state is not None:
        if hasattr(built, "__setstate__"):
            built.__setstate__(state)
        else:
            vars(built).update(state)
    for part in (built, *vars(built).get("estimators_", ())):
        if not hasattr(part, "tree_"):
            continue
        # Trees are compiled and believe their indices: one that is wrong reads foreign memory, or runs in
        # circles.
        tree = part.tree_
        left, right, feature = tree.children_left, tree.children_right, tree.feature
        node = np.arange(tree.node_count)
        leaf = left == -1
        # children come after their parents: so a way through the tree has an end
        sound = (
            tree.node_count > 0
            and {tree.n_features} == {int(part.n_features_in_), int(built.n_features_in_)}
            and np.array_equal(leaf, right == -1)
            and ((left > node) & (left < node.size) | leaf).all()
            and ((right > node) & (right < node.size) | leaf).all()
            and ((feature >= 0) & (feature < tree.n_features) | leaf).all()
            and 0 <= tree.max_depth < max(node.size, 1)
        )
        if not sound:
            raise ValueError("a tree's nodes point outside the tree or the features")
    return built


def import_skops() -> Any:
    """Return skops, which writes ``.skops`` files; reading them needs nothing more."""
    try:
        return import_module("skops.io")
    except ImportError:
        raise ImportError(
            "skops is needed to write .skops files: pip install skops (.joblib needs nothing more)"
        ) from None
