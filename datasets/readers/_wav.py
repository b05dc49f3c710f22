"""Reader of WAV files."""

from __future__ import annotations

import struct
import warnings
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.io import wavfile

from cyclofeat.datasets.readers._columns import Source, explain_damage


class WavSource(Source):
    """Channels of a WAV file, counted from 0.

    Whole numbers are shares of full scale (-1 to 1) and need a scale in Nm; floating-point samples are taken
    as they are.
    """

    named = False

    def __init__(self, path: Path) -> None:
        size = path.stat().st_size
        with path.open("rb") as file:
            head = file.read(12)
        if head[:4] not in (b"RIFF", b"RIFX", b"RF64") or head[8:] != b"WAVE":
            raise ValueError(f"{path.name} is no WAV file: it does not begin with RIFF and WAVE")
        (claimed,) = struct.unpack(">I" if head[:4] == b"RIFX" else "<I", head[4:8])
        if head[:4] != b"RF64" and claimed + 8 > size:
            raise ValueError(
                f"{path.name} is not whole: its header says {claimed + 8} bytes, {size} are there"
            )
        with explain_damage(path, "WAV"), warnings.catch_warnings():
            warnings.simplefilter("error", wavfile.WavFileWarning)
            # Chunks of other programs do not matter.
            warnings.filterwarnings("ignore", "Chunk .non-data. not understood", wavfile.WavFileWarning)
            try:
                rate, samples = wavfile.read(path, mmap=True)
            except ValueError:  # 24-bit samples cannot be mapped
                rate, samples = wavfile.read(path)
        if not rate > 0:
            raise ValueError(f"{path.name}: its header states a rate of {rate!r} Hz")
        self.samples: NDArray[Any] = samples
        n_channels = 1 if samples.ndim == 1 else samples.shape[1]
        super().__init__(path, [str(index) for index in range(n_channels)])
        self.rate = float(rate)

    def stated_rates(self, torque: int) -> list[tuple[float, str]]:
        return [(self.rate, "header")]

    def check_torque(self, torque: int, scale: float | None) -> None:
        if scale is None and self.samples.dtype.kind != "f":
            raise ValueError(
                f"{self.file} holds shares of full scale ({self.samples.dtype}), which say nothing of Nm; "
                "give scale= (Nm at full scale)"
            )

    def raw_values(self, index: int) -> NDArray[Any]:
        samples = self.samples if self.samples.ndim == 1 else self.samples[:, index]
        if samples.dtype.kind == "f":
            return samples
        if samples.dtype == np.uint8:
            return (samples.astype(np.float64) - 128) / 128
        return samples / -float(np.iinfo(samples.dtype).min)
