"""Files appear whole or not at all; records of versions."""

from __future__ import annotations

import errno
import os
from pathlib import Path
from typing import IO

import numpy as np
import pytest

from cyclofeat._base.files import MODEL_PACKAGES, code_sha256, package_versions, write_whole
from cyclofeat._base.shards import ShardStore


@pytest.mark.parametrize("durable", [False, True])
def test_a_file_appears_whole_or_not_at_all(tmp_path: Path, durable: bool) -> None:
    path = tmp_path / "a.bin"
    assert write_whole(path, lambda file: file.write(b"first"), durable=durable) == path

    def failing(file):  # type: ignore[no-untyped-def]
        file.write(b"half of")
        raise RuntimeError("in the middle")

    with pytest.raises(RuntimeError, match="in the middle"):
        write_whole(path, failing, durable=durable)
    assert path.read_bytes() == b"first"
    assert list(tmp_path.iterdir()) == [path]


def test_a_durable_file_is_synchronised_before_it_has_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    there: list[bool] = []
    sync = os.fsync
    monkeypatch.setattr(os, "fsync", lambda file: (there.append((tmp_path / "a").exists()), sync(file)))
    write_whole(tmp_path / "a", lambda file: file.write(b"1"), durable=True)
    assert there == [False, True]  # the file, then its folder


def test_a_missing_folder_is_named(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="none does not exist: make it first"):
        write_whole(tmp_path / "none" / "a", lambda file: None)


def test_versions_are_those_installed() -> None:
    versions = package_versions(*MODEL_PACKAGES)
    assert tuple(versions) == MODEL_PACKAGES
    assert versions["numpy"] == np.__version__
    versions["numpy"] = "changed by a caller"
    assert package_versions("numpy") == {"numpy": np.__version__}


def test_the_sum_of_code_follows_names_and_content(tmp_path: Path) -> None:
    files = [tmp_path / "a.py", tmp_path / "b.py"]
    for file in files:
        file.write_text("1", encoding="utf-8")
    first = code_sha256(tmp_path, files)
    assert code_sha256(tmp_path, reversed(files)) != first
    files[1].write_text("2", encoding="utf-8")
    assert code_sha256(tmp_path, files) != first


@pytest.mark.parametrize(
    "failed", [OSError(errno.ENOSPC, "No space left on device"), OSError("9 requested, 0 written")]
)
def test_a_file_for_which_the_disk_is_too_small_is_named(tmp_path: Path, failed: OSError) -> None:
    def full(file: IO[bytes]) -> None:
        raise failed

    with pytest.raises(OSError, match=f"{failed.args[-1]}: .*{tmp_path.name}/a'$") as caught:
        write_whole(tmp_path / "a", full)
    assert caught.value.errno == (failed.errno or errno.EIO)
    assert list(tmp_path.iterdir()) == []


def test_finished_work_is_read_again_and_a_damaged_file_is_made_anew(tmp_path):
    store, calls = ShardStore(tmp_path / "work"), []

    def work():
        calls.append(1)
        return {"torque": np.arange(3)}

    for n_calls in (1, 1):
        np.testing.assert_array_equal(store.load_or_compute("a.joblib", work)["torque"], np.arange(3))
        assert len(calls) == n_calls
    store.path_of("a.joblib").write_bytes(b"half of it")
    store.load_or_compute("a.joblib", work)
    assert len(calls) == 2
    assert [path.name for path in store.folder.iterdir()] == ["a.joblib"]
