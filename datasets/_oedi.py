"""Measured gearbox vibration of the Open Energy Data Initiative."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sklearn.utils import Bunch

from cyclofeat.datasets._descr import descr
from cyclofeat.datasets.readers import load_arrays

_FOLDER = Path(__file__).parent / "oedi_gearbox"
_MINI = "oedi_gearbox_mini_8192.npz"
_URL = "https://data.openei.org/submissions/623"
_LABELS = ("recording", "broken_tooth", "load_percent", "channels", "fs_inferred_hz")


def load_oedi_gearbox(path: str | os.PathLike[str] | None = None) -> Bunch:
    """Load measured vibration of a two-stage gearbox: two health states at ten load levels.

    Real signals to try features on; they hold no torque, and the gearbox is not cycloidal.

    Parameters
    ----------
    path : path, optional
        NPZ file of the recordings. Default: the small extract in cyclofeat's source tree, which wheels leave
        out. It holds scaled integers (``signals_i16``, ``scale``) or plain numbers (``signals``).

    Returns
    -------
    sklearn.utils.Bunch
        signals : ndarray of shape (20, n_samples, 4), float64
            Acceleration in the unit supplied (not documented); ``n_samples`` is 8192 in the extract.
        broken_tooth : ndarray of shape (20,), int64
            1 for the gearbox with a broken tooth, 0 for the healthy one.
        load_percent : ndarray of shape (20,), int64
            Load level, 0 to 90 in steps of 10.
        recording_names : list of str
            Names of the source files, e.g. "h30hz40".
        channel_names : list of str
            "a1" to "a4", the accelerometers.
        sampling_rate : float
            12800.0 Hz, inferred from the mesh line.
        sampling_rate_inferred : bool
            True: the source does not state the rate.
        shaft_hz : float
            Nominal speed of the input shaft, 30 Hz; the motor's slip makes it 29.6 to 29.8 Hz.
        DESCR : str
            Origin, licence, units and what is inferred.

    Raises
    ------
    FileNotFoundError
        If the file does not exist; the message says where to get it.
    ValueError
        If the file does not hold the arrays described.

    Notes
    -----
    Healthy and broken are two assemblies, so separating them says little about a method. The load level
    across the two states is the better task.

    Examples
    --------
    >>> try:
    ...     data = load_oedi_gearbox()
    ... except FileNotFoundError:
    ...     pass  # outside a checkout
    ... else:
    ...     assert data.signals.shape == (20, 8192, 4)
    """
    if path is not None and not isinstance(path, (str, os.PathLike)):
        raise TypeError(f"path must be a file name, got {path!r}")
    file = _FOLDER / _MINI if path is None else Path(path)
    if file.is_dir():
        raise ValueError(f"{file} is a directory; give an NPZ file such as {_MINI}")
    if not file.exists():
        missing = "the OEDI gearbox recordings are not part of an installed cyclofeat"
        raise FileNotFoundError(
            f"{missing if path is None else f'no such file: {file}'}; an extract ({_MINI}) is in "
            "datasets/oedi_gearbox of cyclofeat's source tree, give load_oedi_gearbox(path=...); the "
            f"original recordings are at {_URL}"
        )
    beside = ""
    if path is None:
        beside = "\n".join(
            (_FOLDER / name).read_text(encoding="utf-8") for name in ("README.md", "LICENSE.md")
        )
    arrays = _load(file)
    return Bunch(
        signals=_signals(file.name, arrays),
        broken_tooth=arrays["broken_tooth"].astype(np.int64),
        load_percent=arrays["load_percent"].astype(np.int64),
        recording_names=arrays["recording"].tolist(),
        channel_names=arrays["channels"].tolist(),
        sampling_rate=float(arrays["fs_inferred_hz"]),
        sampling_rate_inferred=True,
        shaft_hz=30.0,
        DESCR=descr(
            "Measured vibration of a two-stage gearbox, healthy and with a broken tooth, at ten load levels.",
            origin=(
                'Y. Pandya and A. Parey, "Gearbox Fault Diagnosis Data", Open Energy Data Initiative, '
                f"submission 623, {_URL}. There is no torque channel, and the gearbox is no cycloidal one."
            ),
            licence=(
                "CC BY 4.0 as a catalogue reports it, not confirmed at the publisher; attribution as above."
            ),
            units="acceleration in a unit that the source does not document; rates in Hz.",
            inferred="the sampling rate, from the mesh line; the source does not state it.",
            more=beside,
        ),
    )


def _load(file: Path) -> dict[str, NDArray[Any]]:
    arrays = load_arrays(file)
    signals = {"signals"} if "signals" in arrays else {"signals_i16", "scale"}
    missing = ({*_LABELS} | signals) - arrays.keys()
    if missing:
        raise ValueError(
            f"{file.name} must hold the arrays signals (or signals_i16 and scale), {', '.join(_LABELS)}; "
            f"missing: {', '.join(sorted(missing))}"
        )
    return arrays


def _signals(name: str, arrays: dict[str, NDArray[Any]]) -> NDArray[np.float64]:
    """Acceleration as supplied, shape (n_recordings, n_samples, n_channels)."""
    if "signals" in arrays:
        signals = arrays["signals"].astype(np.float64)
    else:
        # float32 as printed: 0.004, not 0.0040000001899898052
        signals = arrays["signals_i16"] * float(str(arrays["scale"].reshape(())))
    n_recordings, n_channels = arrays["recording"].size, arrays["channels"].size
    if signals.ndim != 3 or signals.shape[::2] != (n_recordings, n_channels):
        raise ValueError(
            f"{name}: signals must have shape ({n_recordings}, n_samples, {n_channels}) for {n_recordings} "
            f"recordings of {n_channels} channels, got {signals.shape}"
        )
    return signals
