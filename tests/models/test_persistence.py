"""Models on disk: round trip, trust, damage."""

import hashlib
import json
import os
import subprocess
import sys

import joblib
import numpy as np
import pytest

from cyclofeat.counting import LobeModel
from cyclofeat.models import ModelFileError, card_path, load_model, save_model


@pytest.fixture(scope="module")
def model(surrogates):
    return LobeModel.train(surrogates[::2], n_splits=0, n_trees=20)


@pytest.fixture
def stored(model, tmp_path):
    return save_model(tmp_path / "model.joblib", model)


@pytest.mark.slow
def test_a_model_survives_the_way_to_another_process(model, stored, surrogates, tmp_path):
    np.save(tmp_path / "torque.npy", surrogates[1].torque)
    code = (
        "import sys, numpy as np\n"
        "from cyclofeat import Recording\n"
        "from cyclofeat.models import load_model\n"
        "model = load_model(sys.argv[1], trusted=True)\n"
        "print(repr(model.count(Recording(np.load(sys.argv[2]), 25_600.0, speed_rpm=500)).probability))\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(stored), str(tmp_path / "torque.npy")],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    here = model.count(surrogates[1].replace(angle=None, angle_is_absolute=False)).probability
    assert done.stdout.strip() == repr(here)


def test_a_file_is_loaded_only_when_trusted(stored):
    with pytest.raises(ModelFileError, match=r"can run any code.*trusted=True \(--trust on"):
        load_model(stored)


def test_an_untrusted_file_runs_nothing(stored, tmp_path):
    marker = tmp_path / "ran"
    evil = tmp_path / "evil.joblib"
    joblib.dump(Touch(str(marker)), evil)
    digest = hashlib.sha256(evil.read_bytes()).hexdigest()
    card = json.loads(card_path(stored).read_text(encoding="utf-8")) | {"sha256": digest}
    card_path(evil).write_text(
        json.dumps(card), encoding="utf-8"
    )  # who can write the one file can write the other
    with pytest.raises(ModelFileError):
        load_model(evil)
    assert not marker.exists()
    with pytest.raises(ModelFileError, match="holds no cyclofeat counter: .* got NoneType"):
        load_model(evil, trusted=True)
    assert marker.exists()  # which is why trust must be stated


class Touch:
    """Creates a folder when it is unpickled."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return (os.mkdir, (self.path,))


@pytest.mark.filterwarnings("ignore:unclosed file:ResourceWarning")
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize("kept", [0, 1, 100, 0.5, 0.99])
def test_a_truncated_file_is_a_clear_error(stored, kept):
    whole = stored.read_bytes()
    stored.write_bytes(whole[: int(kept if kept >= 1 or kept == 0 else kept * len(whole))])
    with pytest.raises(ModelFileError, match="is not the file that its card describes"):
        load_model(stored, trusted=True)
    # a card that agrees, as of a file that was cut before it was written
    card = json.loads(card_path(stored).read_text(encoding="utf-8"))
    card["sha256"] = hashlib.sha256(stored.read_bytes()).hexdigest()
    card_path(stored).write_text(json.dumps(card), encoding="utf-8")
    with pytest.raises(ModelFileError, match="cannot be read as a joblib model"):
        load_model(stored, trusted=True)


def test_other_mistakes(model, tmp_path):
    with pytest.raises(FileNotFoundError, match=r"model file .*absent\.joblib does not exist"):
        load_model(tmp_path / "absent.joblib", trusted=True)
    with pytest.raises(FileNotFoundError, match="folder .* does not exist: make it first"):
        save_model(tmp_path / "absent" / "model.joblib", model)
    with pytest.raises(TypeError, match="must be a LobeModel or a classifier with predict_proba, got dict"):
        save_model(tmp_path / "model.joblib", {})
    assert list(tmp_path.iterdir()) == []
