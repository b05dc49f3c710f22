"""The simulator's kernel in C, compiled by gcc when the benchmark runs and called with the same tables."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
import tempfile
from pathlib import Path

import numpy as np

from cyclofeat.simulators import _kernels, _outline
from cyclofeat.simulators.simulation import KernelInput

# The gcc options that correspond to numba's "fastmath" set; numba never sets errno.
FLAGS = [
    "-O3",
    "-march=native",
    "-fassociative-math",
    "-fno-signed-zeros",
    "-fno-trapping-math",
    "-freciprocal-math",
    "-ffp-contract=fast",
    "-fno-math-errno",
]


def constants() -> str:
    """Sizes, rows and limits of the kernel's tables as definitions for C."""
    found: dict[str, float] = {}
    for module in (_outline, _kernels):
        for name, value in vars(module).items():
            if name.isupper() and isinstance(value, int | float | np.unsignedinteger):
                found[name] = value if isinstance(value, float) else int(value)
    found["FLANK_ROWS"] = found["FLANK_SIZE"] // found["COLUMNS"]
    found["EDGE_ROWS"] = found["EDGE_SIZE"] // found["EDGE_COLUMNS"]
    return "".join(f"#define {name} {value!r}\n" for name, value in found.items())


class CKernel:
    """``integrate`` of ``kernel.c``. Raises FileNotFoundError if gcc is not installed."""

    def __init__(self) -> None:
        gcc = shutil.which("gcc")
        if gcc is None:
            raise FileNotFoundError("gcc is not there")
        with tempfile.TemporaryDirectory() as folder:
            source, library = Path(folder) / "kernel.c", Path(folder) / "kernel.so"
            source.write_text(
                constants() + Path(__file__).with_name("kernel.c").read_text(encoding="utf-8"),
                encoding="utf-8",
            )
            subprocess.run([gcc, *FLAGS, "-shared", "-fPIC", "-o", library, source, "-lm"], check=True)
            self._integrate = ctypes.CDLL(str(library)).integrate
        self._integrate.restype = ctypes.c_ssize_t

    def __call__(
        self,
        dt: float,
        course: tuple[np.ndarray, ...],
        state: np.ndarray,
        tables: KernelInput,
        limits: tuple[float, float, float],
        result: np.ndarray,
    ) -> int:
        """Integrate as ``_kernels.integrate``, but for torques only: changes ``state``, fills ``result``."""
        tuples = (tables.wheel, tables.joint, tables.contact, tables.joint_contact, tables.body)
        arrays = [*course, state, *(np.array(values, dtype=float) for values in tuples)]
        arrays += [tables.pins, tables.mounts, tables.lobes, tables.wear, tables.sleeves]
        if not all(array.flags.c_contiguous and array.dtype == float for array in arrays):
            raise RuntimeError("kernel.c takes arrays of double without gaps")
        return int(
            self._integrate(
                ctypes.c_ssize_t(len(result)),
                ctypes.c_double(dt),
                *(ctypes.c_void_p(array.ctypes.data) for array in arrays),
                *map(ctypes.c_double, limits),
                ctypes.c_void_p(result.ctypes.data),
            )
        )
