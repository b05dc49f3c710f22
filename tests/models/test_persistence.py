"""Models as files: every kind of counter, in other processes, and what must not be loaded."""

import copy
import hashlib
import json
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import joblib
import numpy as np
import pytest
import skops.io
from numpy.testing import assert_array_equal
from sklearn.ensemble import ExtraTreesClassifier
from sklearn.naive_bayes import GaussianNB
from sklearn.neighbors import KDTree, KNeighborsClassifier

from cyclofeat.counting import GroupCalibratedCounter, LobeModel, make_lobe_counter
from cyclofeat.counting.estimators.pipelines import KINDS
from cyclofeat.counting.estimators.trees import CountingTrees
from cyclofeat.features.registry import REGISTRY
from cyclofeat.models import ModelFileError, load_default_model, load_model, save_model
from cyclofeat.models.card import card_path, read_card
from cyclofeat.models.persistence import as_lobe_model
from cyclofeat.recordings import Recording

pytest.importorskip("skops")
RATE = 6400  # Hz: windows of an output turn are short
FORMATS = ("joblib", "skops")


@pytest.fixture(scope="module")
def data():
    """Windows with a bump at every passage of a worn lobe, two of each of 12 assemblies."""
    counts = np.tile([0, 2, 4], 8)
    slot = np.arange(11_520) / RATE * 500 / 60 * 16 / 15 * 15
    X = (slot.astype(int) % 15 < counts[:, np.newaxis]) * np.sin(2 * np.pi * slot) ** 3
    X += 0.3 * np.random.default_rng(0).normal(size=X.shape)
    return X, counts, np.array([f"A{k}" for k in np.arange(24) % 12])


def fit_counter(kind, data):
    """A counter of a kind, with few trees; a plain one is not calibrated."""
    X, counts, assemblies = data
    if kind == "plain":
        return make_lobe_counter(RATE, n_trees=10).fit(X, counts)
    counter = make_lobe_counter(RATE, kind=kind, n_trees=10)
    if kind == "network":
        counter.set_params(n_epochs=2)
    counter = counter.set_params(n_splits=2) if kind == "trees" else GroupCalibratedCounter(counter)
    return counter.fit(X, counts, groups=assemblies)


@pytest.fixture(scope="module")
def counters(data):
    return {kind: fit_counter(kind, data) for kind in ("ladder", "plain")}


@pytest.fixture(scope="module")
def all_counters(counters, data):
    return counters | {kind: fit_counter(kind, data) for kind in KINDS if kind not in counters}


@pytest.fixture(scope="module")
def model(data):
    X, counts, assemblies = data
    recordings = [
        Recording(x, RATE, assembly=a, defect_count=n, speed_rpm=500)
        for x, n, a in zip(X, counts.tolist(), assemblies.tolist(), strict=True)
    ]
    return LobeModel(n_splits=0, n_trees=20, random_state=0, description="bumps").fit(recordings)


@pytest.fixture
def stored(counters, tmp_path):
    """A small model of each format: file and card."""
    return {suffix: save_model(tmp_path / f"m.{suffix}", counters["ladder"]) for suffix in FORMATS}


def smuggled(counter, file):
    """A model's file with another counter in it, its card in order."""
    file.write_bytes(skops.io.dumps(counter))
    restate(file)
    return file


def change_card(file, **changes):
    card = json.loads(card_path(file).read_text(encoding="utf-8"))
    card_path(file).write_text(json.dumps(card | changes), encoding="utf-8")


def change_schema(file, change):
    """Change the schema of a ``.skops`` file, its card in order."""
    with zipfile.ZipFile(file) as archive:
        content = {name: archive.read(name) for name in archive.namelist()}
    schema = json.loads(content["schema.json"])
    change(schema)
    with zipfile.ZipFile(file, "w") as archive:
        for name, data in content.items():
            archive.writestr(name, json.dumps(schema) if name == "schema.json" else data)
    restate(file)


def restate(file):
    """Make the card agree with the file: who can write the one can write the other."""
    change_card(file, sha256=hashlib.sha256(file.read_bytes()).hexdigest())


@pytest.mark.slow
def test_every_kind_is_the_same_in_another_process(all_counters, model, data, tmp_path):
    np.save(tmp_path / "X.npy", data[0][:3])
    expected = {}
    for kind, counter in all_counters.items():
        for suffix in FORMATS:
            file = save_model(tmp_path / f"{kind}.{suffix}", counter)
            expected[file.name] = counter.predict_proba(data[0][:3]).tolist()
    for suffix in FORMATS:
        save_model(tmp_path / f"model.{suffix}", model)
    for file in tmp_path.glob("*.skops"):  # which skops reads too
        skops.io.loads(file.read_bytes(), trusted=skops.io.get_untrusted_types(file=file))
    expected["model"] = model.count(Recording(data[0][0], RATE, speed_rpm=500)).to_dict()
    (tmp_path / "names.json").write_text(json.dumps(sorted(expected.keys() - {"model"})), encoding="utf-8")
    code = (
        "import json, sys, numpy as np, pathlib\n"
        "from cyclofeat import Recording\n"
        "from cyclofeat.models import load_default_model, load_model\n"
        "load_default_model()\n"
        "folder = pathlib.Path(sys.argv[1]); X = np.load(folder / 'X.npy')\n"
        "names = json.loads((folder / 'names.json').read_text())\n"
        "trust = lambda name: name.endswith('.joblib')\n"
        "said = {n: load_model(folder / n, trusted=trust(n)).predict_proba(X).tolist() for n in names}\n"
        "models = [load_model(folder / n, trusted=trust(n)) for n in ('model.joblib', 'model.skops')]\n"
        "one, other = [m.count(Recording(X[0], 6400, speed_rpm=500)).to_dict() for m in models]\n"
        "assert one == other\n"
        "assert 'skops' not in sys.modules\n"
        "print(json.dumps(said | {'model': one}))\n"
    )
    home = tmp_path / "home"  # where nothing is to be written
    home.mkdir()
    homes = dict.fromkeys(("HOME", "USERPROFILE", "XDG_CACHE_HOME", "TMPDIR"), str(home))
    done = subprocess.run(
        [sys.executable, "-B", "-c", code, str(tmp_path)], env=os.environ | homes, capture_output=True,
        text=True, check=True,
    )  # fmt: skip
    assert json.loads(done.stdout) == expected
    assert not list(home.rglob("*"))


def python_calls(function):
    """Return how many Python functions a call enters; unlike its time, that is always the same."""
    entered = []
    sys.setprofile(lambda frame, event, argument: event == "call" and entered.append(event))
    try:
        function()
    finally:
        sys.setprofile(None)
    return len(entered)


def test_a_model_is_loaded_quickly_without_a_second_file(data, tmp_path):
    """A packaged model and one of 300 trees: some 8,000 calls, 0.1 s; one by one the trees need 100,000."""
    trees = make_lobe_counter(RATE).fit(data[0], data[1])
    file = save_model(tmp_path / "trees.skops", trees)
    for load in (load_default_model, lambda: load_model(file)):
        load()  # imports
        assert python_calls(load) < 12_000
    assert sorted(tmp_path.iterdir()) == [file, card_path(file)]


def test_the_card_tells_what_a_user_must_know(model, tmp_path):
    card = read_card(save_model(tmp_path / "m.skops", model, scores={"accuracy": np.float64(0.5)}))
    assert card["sampling_rate"] is card["window_s"] is card["input_speed_hz"] is None
    assert (card["samples_per_turn"], card["window_samples"]) == (128, 1882)
    assert card["training"]["quantity"] == "output_torque"
    assert card["training"]["speeds_rpm"] == pytest.approx([500, 500], rel=0.01)
    assert card["classes"] == [0, 2, 4]
    assert card["training"]["assemblies"] == sorted(f"A{k}" for k in range(12))
    assert card["training"]["description"] == "bumps"
    assert card["scores"] == {"accuracy": 0.5}
    assert set(card["versions"]) >= {"python", "numpy", "scipy", "scikit-learn", "cyclofeat", "skops"}
    columns, definitions = card["features"]["columns"], card["features"]["definitions"]
    assert len(columns) == model.counter_.lobe_map_.get_feature_names_out().size
    assert (len(definitions), definitions) == (4, {name: REGISTRY[name].version for name in definitions})


class Evil:
    """Creates a folder when it is unpickled."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return (os.mkdir, (self.path,))


def test_a_file_runs_nothing_unless_it_is_trusted(stored, tmp_path):
    with pytest.raises(ModelFileError, match=r"can run any code.*trusted=True \(--trust on"):
        load_model(stored["joblib"])
    marker = tmp_path / "ran"
    joblib.dump(Evil(str(marker)), stored["joblib"])
    restate(stored["joblib"])
    with pytest.raises(ModelFileError):
        load_model(stored["joblib"])
    assert not marker.exists()
    with pytest.raises(ModelFileError, match="holds no cyclofeat counter: .* got NoneType"):
        load_model(stored["joblib"], trusted=True)
    assert marker.exists()  # which is why trust must be stated


def test_a_pickle_that_calls_itself_skops_runs_nothing(stored, tmp_path):
    with zipfile.ZipFile(stored["skops"]) as archive:  # data only
        assert {name.rsplit(".", 1)[-1] for name in archive.namelist()} <= {"json", "npy"}
    joblib.dump(Evil(str(tmp_path / "ran")), stored["skops"])
    restate(stored["skops"])
    for trusted in (False, True):
        with pytest.raises(ModelFileError, match="cannot be read as a skops model"):
            load_model(stored["skops"], trusted=trusted)
    assert not (tmp_path / "ran").exists()


@pytest.mark.parametrize(
    ("part", "kind"),
    [
        (os.path.basename, "posixpath.basename"),
        (KDTree(np.eye(5)), "sklearn.neighbors._kd_tree.KDTree"),  # compiled: its indices could be anything
        (KNeighborsClassifier().fit(np.eye(5), range(5)), "sklearn.neighbors._classification.K"),
        (np.random.default_rng(0), "numpy.random._generator.Generator"),
        (Path("folder"), "pathlib.PosixPath"),
    ],
)
def test_skops_with_another_type_is_refused_in_writing_and_reading(counters, stored, tmp_path, part, kind):
    strange = copy.deepcopy(counters["ladder"])
    strange.part = part
    for counter in (strange, part) if hasattr(part, "predict_proba") else (strange,):
        with pytest.raises(ValueError, match=f"counter holds {kind}.*write .joblib"):
            save_model(tmp_path / "strange.skops", counter, sampling_rate=RATE)
        assert not (tmp_path / "strange.skops").exists()
    for counter in (strange, part):
        file, message = (
            smuggled(counter, stored["skops"]),
            f"holds {kind}.*, which no counter needs: it is not l",
        )
        for trusted in (False, True):
            with pytest.raises(ModelFileError, match=message):
                load_model(file, trusted=trusted)


@pytest.mark.parametrize(
    "name",
    [
        "cyclofeat.features.registry.SpectralEntropy",  # not where it is defined
        "cyclofeat.counting.estimators.pipelines.make_lobe_counter",
        "cyclofeat.counting.model.lobe_stream.LobeStream",  # no estimator
        "cyclofeat.models.persistence.SUFFIXES",
        "builtins.object",
        "os.system",
    ],
)
def test_a_file_names_no_other_object_of_this_package(stored, name):
    def rename(schema):
        schema["__module__"], _, schema["__class__"] = name.rpartition(".")

    change_schema(stored["skops"], rename)
    with pytest.raises(ModelFileError, match=f"holds {name}, which no counter needs"):
        load_model(stored["skops"])


def test_another_protocol_of_skops_is_refused(stored):
    change_schema(stored["skops"], lambda schema: schema.update(protocol=99))
    with pytest.raises(ModelFileError, match="its protocol is 99, known are .*: update cyclofeat"):
        load_model(stored["skops"])


@pytest.mark.parametrize("kind", [ExtraTreesClassifier, CountingTrees])
@pytest.mark.parametrize(
    ("field", "value"), [("left_child", 10**6), ("right_child", 10**6), ("feature", 10**6), ("left_child", 0)]
)
def test_a_tree_that_points_outside_itself_is_refused(data, stored, kind, field, value):
    """Compiled trees believe their indices: such a file would read foreign memory, or run in circles."""
    forest = kind(2, random_state=0).fit(data[0][:, :5], data[1])
    tree = forest.estimators_[1].tree_
    state = tree.__getstate__()
    state["nodes"][field][0] = value
    tree.__setstate__(state)
    with pytest.raises(ModelFileError, match="point outside the tree"):
        load_model(smuggled(forest, stored["skops"]))


@pytest.mark.parametrize(("name", "value"), [("node_count", "10000"), ("n_outputs", "100")])
def test_a_tree_of_other_sizes_than_its_arrays_is_refused(data, stored, name, value):
    """The sizes are believed before the first look at its nodes."""

    def change(node):
        if isinstance(node, dict) and node.get("__loader__") == "TreeNode":
            arguments = node["__reduce__"]["args"]["content"]
            size = arguments[2] if name == "n_outputs" else node["content"]["content"][name]
            size["content"] = value
        for inner in node.values() if isinstance(node, dict) else node if isinstance(node, list) else ():
            change(inner)

    file = smuggled(ExtraTreesClassifier(2).fit(data[0][:, :5], data[1]), stored["skops"])
    change_schema(file, change)
    with pytest.raises(ModelFileError, match="a tree's sizes disagree with its arrays"):
        load_model(file)


@pytest.mark.parametrize("suffix", FORMATS)
@pytest.mark.parametrize("damage", ["flipped", "truncated", "empty", "longer"])
def test_a_damaged_file_is_not_loaded(stored, suffix, damage):
    whole = stored[suffix].read_bytes()
    middle = len(whole) // 2
    flipped = whole[:middle] + bytes([whole[middle] ^ 1]) + whole[middle + 1 :]
    changed = {"flipped": flipped, "truncated": whole[:middle], "empty": b"", "longer": whole + b"\0"}
    stored[suffix].write_bytes(changed[damage])
    with pytest.raises(ModelFileError, match="not the file that its card describes.*SHA-256"):
        load_model(stored[suffix], trusted=True)


@pytest.mark.filterwarnings("ignore:unclosed file:ResourceWarning")
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize("kept", [0, 1, 100, 0.5, 0.99])
def test_a_cut_file_whose_card_agrees_is_a_clear_error(stored, kept):
    whole = stored["joblib"].read_bytes()
    stored["joblib"].write_bytes(whole[: int(kept if kept >= 1 else kept * len(whole))])
    restate(stored["joblib"])
    with pytest.raises(ModelFileError, match="cannot be read as a joblib model"):
        load_model(stored["joblib"], trusted=True)


@pytest.mark.parametrize("suffix", FORMATS)
@pytest.mark.parametrize(
    ("text", "message"),
    [
        (None, "has no card: m.* must lie beside it"),
        ("", "is empty"),
        ('{"format": 3, "sha', "cannot be read as JSON"),
        ("[]", "is no card of a model: format, sha256"),
        ('{"format": 3}', "sha256, bytes, versions, .* missing or wrong"),
        ('{"format": 3, "classes": 3, "scores": 0.9}', "classes, scores, features.columns, .* or wrong"),
        ('{"format": 4}', "of format 4, but 3 can be read; update cyclofeat"),
        ('{"format": 2}', "of format 2, but 3 can be read; train the model again"),
    ],
)
def test_without_a_whole_card_nothing_is_loaded(stored, suffix, text, message):
    card = card_path(stored[suffix])
    card.unlink() if text is None else card.write_text(text, encoding="utf-8")
    with pytest.raises(ModelFileError, match=message):
        load_model(stored[suffix], trusted=True)


@pytest.mark.parametrize("name", ["cyclofeat", "scikit-learn", "python", "numpy", "scipy"])
def test_other_versions_are_refused_unless_named(stored, name):
    file = stored["skops"]
    versions = read_card(file)["versions"]
    change_card(file, versions=versions | {name: "0.9"})
    with pytest.raises(ModelFileError, match=rf'{name} 0.9 \(here .*allow=\("{name}",\) \(--allow {name}\)'):
        load_model(file)
    with pytest.raises(ModelFileError, match=f"{name} 0.9"):
        load_model(file, allow=("joblib", "features"))
    load_model(file, allow=(name,))


def test_names_of_allowed_differences(stored):
    versions = read_card(stored["joblib"])["versions"]
    change_card(stored["joblib"], versions=versions | {"scikit-learn": "0.1", "python": "3.1.0"})
    with pytest.raises(ModelFileError, match="--allow scikit-learn --allow python"):
        load_model(stored["joblib"], trusted=True)
    load_model(stored["joblib"], trusted=True, allow=("scikit-learn", "python"))
    with pytest.raises(ValueError, match="allow must name any of cyclofeat, .* got 'numba'"):
        load_model(stored["joblib"], trusted=True, allow=("numba",))
    # Bug fixes of these are no difference.
    later = {name: ".".join([*versions[name].split(".")[:2], "99"]) for name in ("python", "numpy", "scipy")}
    change_card(stored["joblib"], versions=versions | later)
    load_model(stored["joblib"], trusted=True)


def test_another_definition_of_a_feature_is_refused_unless_allowed(stored):
    file = stored["skops"]
    features = read_card(file)["features"]
    change_card(file, features=features | {"definitions": {"shannon_entropy": 99}})
    with pytest.raises(ModelFileError, match="shannon_entropy version 99 .here version 1.*--allow features"):
        load_model(file)
    load_model(file, allow=("features",))
    change_card(file, features=features | {"columns": ["other"]})
    with pytest.raises(ModelFileError, match="column 0 is 'shannon_entropy.*the card has 'other'"):
        load_model(file)
    load_model(file, allow=("features",))


def test_a_counter_of_windows_is_no_model_of_recordings(stored):
    with pytest.raises(ValueError, match="must count recordings, got .* which counts windows: train it with"):
        as_lobe_model(load_model(stored["skops"]))


def test_writing_says_what_is_wrong(counters, tmp_path):
    fitted, bayes = counters["plain"], GaussianNB().fit([[0.0], [1.0]], [0, 1])
    for name, counter, error, message in (
        ("m.pkl", fitted, ValueError, "must end in .skops .safe. or .joblib .a pickle., got 'm.pkl'"),
        ("m.joblib", make_lobe_counter(RATE), TypeError, "counter must be fitted, got Pipeline that is not"),
        ("m.joblib", bayes, ValueError, "sampling_rate must be given"),
        ("absent/m.joblib", fitted, FileNotFoundError, "folder .* does not exist: make it first"),
        ("m.joblib", {}, TypeError, "must be a LobeModel or a classifier with predict_proba, got dict"),
    ):
        with pytest.raises(error, match=message):
            save_model(tmp_path / name, counter)
    with pytest.raises(FileNotFoundError, match=r"model file .*absent\.joblib does not exist"):
        load_model(tmp_path / "absent.joblib", trusted=True)
    assert not list(tmp_path.iterdir())


def test_a_second_model_in_the_same_place_replaces_both_files(counters, data, tmp_path):
    for kind in ("ladder", "plain"):
        file = save_model(tmp_path / "m.joblib", counters[kind])
        assert_array_equal(load_model(file, trusted=True).predict(data[0]), counters[kind].predict(data[0]))
    assert len(list(tmp_path.iterdir())) == 2
