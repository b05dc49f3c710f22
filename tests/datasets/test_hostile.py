"""Files made to break a reader give one clear error, in a few times the memory of the file."""

from __future__ import annotations

import gzip
import zipfile

import h5py
import numpy as np
import openpyxl
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from memory import peak_bytes
from nptdms import ChannelObject, TdmsWriter
from scipy.io import savemat

from cyclofeat.datasets import read_recording
from cyclofeat.datasets.readers import _columns

MANY = 500_000


def write_zip(path, name, content):
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(name, content)


def write_h5(path, fill):
    with h5py.File(path, "w") as file:
        fill(file)


def add_links(file):
    for k in range(10):
        file[f"loop{k}"], file[f"soft{k}"] = file["/"], h5py.SoftLink(f"/soft{9 - k}")
    file["torque"] = h5py.ExternalLink("secret.h5", "torque")


def write_sheet(path, place):
    book = openpyxl.Workbook()
    book.active[place] = 1
    book.create_sheet("empty")
    book.save(path)


def write_tdms(path, values, **properties):
    with TdmsWriter(path) as writer:
        writer.write_segment([ChannelObject("g", "torque", values, properties)])


def nest(depth):
    return {"a": nest(depth - 1)} if depth else {"torque": np.ones(9)}


CLAIM = b"\x93NUMPY\x01\0\x76\0" + b"{'descr': '<f8', 'fortran_order': False, 'shape': (%d,), }" % 10**12
HOSTILE = {
    "row.csv": b"1," * MANY,
    "names.csv": b",".join([b"a"] * MANY) + b"\n1\n",
    "quote.csv": b"torque\n1\n" + b'"' + b"2" * 3_000_000 + b"\n",
    "digits.csv": b"torque\n1\n" + b"2" * 3_000_000 + b"\n",
    "empty lines.csv": b"\n" * MANY,
    "comment.csv": b"#" * 3_000_000 + b"\n1\n2\n",
    "numbers.csv": b"9" * MANY + b"\n" + b"9" * MANY + b"\n",
    "head.csv": b"rig;7\n" * 200_000 + b"time,torque\n" + b"1,2\n" * 99,
    "nan times.csv": b"time,torque\n" + b"0.1,1\nnan,2\n" * 99,
    "backwards.csv": b"time,torque\n" + b"".join(b"%d,1\n" % -i for i in range(999)),
    "wrong clock.csv": b"time,torque\n" + b"".join(b"25:61:%02d,1\n" % (i % 100) for i in range(999)),
    "no clock.csv": b"time,torque\n" + b"10:00:00.1,1\nnoon,2\n" * 99,
    "bomb.csv.gz": gzip.compress(b"torque\n" + b"1\n" * 10_000_000, 1),
    "bomb.npz": lambda path: np.savez_compressed(path, torque=np.zeros(2_000_000)),
    "small.npz": lambda path: np.savez_compressed(path, torque=np.zeros(4_000_000, "i1")),
    "claim.npz": lambda path: write_zip(path, "torque.npy", CLAIM.ljust(127) + b"\n"),
    "bomb.xlsx": lambda path: write_zip(path, "xl/worksheets/sheet1.xml", b"<row>" * 9_000_000),
    "far row.xlsx": lambda path: write_sheet(path, "A200000"),
    "far column.xlsx": lambda path: write_sheet(path, "XFD1"),
    "links.h5": lambda path: write_h5(path, add_links),
    "links.mat": lambda path: write_h5(path, add_links),
    "claim.h5": lambda path: write_h5(path, lambda f: f.create_dataset("a", (10**12,), "f8", chunks=(9,))),
    "deep.h5": lambda path: write_h5(path, lambda file: file.create_group("/a" * 400)),
    "types.h5": lambda path: write_h5(path, lambda file: file.update(a=[b"x"], b=1j, c=h5py.Empty("f"))),
    "deep.mat": lambda path: savemat(path, nest(25)),
    "wide.mat": lambda path: savemat(path, {"torque": np.ones((300, 300))}),
    "many.mat": lambda path: savemat(path, {f"a{k}": [1, 2] for k in range(11_000)}),
    "negative.tdms": lambda path: write_tdms(path, np.ones(9), wf_increment=-1.0),
    "nan.tdms": lambda path: write_tdms(path, np.ones(9), wf_increment=float("nan")),
    "scales.tdms": lambda path: write_tdms(path, np.ones(9), wf_increment=1.0, NI_Number_Of_Scales=2**31 - 1),
    "lists.parquet": lambda path: pq.write_table(pa.table({"torque": [[1.0], [2.0]]}), path),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_files_give_one_clear_error_in_little_memory(tmp_path, monkeypatch, name):
    monkeypatch.setattr(_columns, "LARGEST_UNPACKED", 10**7)  # in place of 2 GB: the test stays cheap
    path, content = tmp_path / name, HOSTILE[name]
    path.write_bytes(content) if isinstance(content, bytes) else content(path)
    with peak_bytes() as peak, pytest.raises(ValueError, match=name) as caught:
        read_recording(path)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 1_000
    assert peak[0] <= 3 * path.stat().st_size + 40e6
