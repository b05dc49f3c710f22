"""Copies of models that were read from ``.skops`` files."""

import json
import os
import pickle

import numpy as np
import pytest
from small_model import recording, small_model

from cyclofeat.models import ModelFileError, _content, card_path, load_model, save_model


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    return save_model(tmp_path_factory.mktemp("models") / "small.skops", small_model())


@pytest.fixture
def unread(monkeypatch):
    """Let a reading of the file itself fail."""

    def close():
        monkeypatch.setattr(_content, "the_skops", lambda: pytest.fail("the file was read again"))

    return close


def test_a_copy_counts_as_the_file_does_and_is_read_in_its_place(stored, tmp_path, unread):
    first = load_model(stored, cache=tmp_path)
    unread()
    again = load_model(stored, cache=tmp_path)
    disc = recording((2, 3, 4), seed=99)
    assert again.count(disc) == first.count(disc)


def test_a_damaged_copy_is_made_anew(stored, tmp_path, unread):
    load_model(stored, cache=tmp_path)
    (copy,) = tmp_path.iterdir()
    whole = copy.read_bytes()
    copy.write_bytes(whole[: len(whole) // 2])
    load_model(stored, cache=tmp_path)
    unread()
    load_model(stored, cache=tmp_path)


class Evil:
    """A pickle of it runs code."""

    def __reduce__(self):
        return pytest.fail, ("a copy that others can write was loaded",)


@pytest.mark.skipif(os.name != "posix", reason="permissions of other users")
def test_a_folder_that_others_can_write_to_is_not_used(stored, tmp_path):
    load_model(stored, cache=tmp_path)
    (copy,) = tmp_path.iterdir()
    copy.write_bytes(pickle.dumps(Evil()))
    tmp_path.chmod(0o777)
    assert isinstance(load_model(stored, cache=tmp_path).counter.classes_, np.ndarray)
    assert copy.read_bytes() == pickle.dumps(Evil())


def test_a_folder_that_cannot_be_made_is_no_error(stored):
    assert load_model(stored, cache=stored / "inside").n_lobes == 15


def test_a_copy_never_stands_for_another_file_or_code(stored, tmp_path, monkeypatch):
    load_model(stored, cache=tmp_path / "copies")
    other = tmp_path / stored.name
    other.write_bytes(stored.read_bytes() + b"\0")
    card_path(other).write_bytes(card_path(stored).read_bytes())
    with pytest.raises(ModelFileError, match="not the file that its card describes"):
        load_model(other, cache=tmp_path / "copies")
    card = json.loads(card_path(stored).read_text(encoding="utf-8"))
    card["versions"]["numpy"] = "0.1.0"
    other.write_bytes(stored.read_bytes())
    card_path(other).write_text(json.dumps(card), encoding="utf-8")
    with pytest.raises(ModelFileError, match=r"written with numpy 0\.1\.0"):
        load_model(other, cache=tmp_path / "copies")
    monkeypatch.setattr("cyclofeat.models._cache.code_sha256", lambda *_: "other code")
    load_model(stored, cache=tmp_path / "copies")
    assert len(list((tmp_path / "copies").iterdir())) == 2


@pytest.mark.slow
def test_the_oldest_copies_are_deleted(stored, tmp_path, monkeypatch):
    for number in range(10):
        monkeypatch.setattr("cyclofeat.models._cache.code_sha256", lambda *_, n=number: str(n))
        load_model(stored, cache=tmp_path)
    assert len(list(tmp_path.iterdir())) == 8
