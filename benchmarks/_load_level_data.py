"""Measured gearbox vibration, checked and cut into windows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]
Int = NDArray[np.int64]
LEVELS: Int = np.arange(10)  # the ordered classes: load in per cent, divided by 10
ALL = "all"
STATES = ("healthy", "broken")  # index: value of broken_tooth
KEYS = (
    "signals",
    "broken_tooth",
    "load_percent",
    "recording_names",
    "channel_names",
    "sampling_rate",
    "sampling_rate_inferred",
)


@dataclass(frozen=True)
class VibrationData:
    """Checked dataset; signals of shape (n_recordings, n_samples, n_channels)."""

    signals: Float
    levels: Int
    broken: NDArray[np.bool_]
    recordings: tuple[str, ...]
    channels: tuple[str, ...]
    sampling_rate: float
    sampling_rate_inferred: bool


def checked(dataset: Any) -> VibrationData:
    if not isinstance(dataset, Mapping):
        raise TypeError(f"dataset must be the Bunch of load_oedi_gearbox(), got {type(dataset).__name__}")
    missing = [key for key in KEYS if key not in dataset]
    if missing:
        raise ValueError(f"dataset must be the Bunch of load_oedi_gearbox(); missing: {', '.join(missing)}")
    signals = _numbers("signals", dataset["signals"])
    if signals.ndim != 3 or 0 in signals.shape:
        raise ValueError(
            "dataset.signals must have shape (n_recordings, n_samples, n_channels), none of them 0, "
            f"got {signals.shape}"
        )
    recordings = _names("recording_names", dataset["recording_names"])
    channels = _names("channel_names", dataset["channel_names"])
    if len(channels) != signals.shape[2] or len({*channels, ALL}) != len(channels) + 1:
        raise ValueError(
            f"dataset.channel_names must be {signals.shape[2]} different names, one per channel of "
            f"dataset.signals and none of them {ALL!r}, got {list(channels)}"
        )
    broken, load = (_numbers(key, dataset[key]) for key in ("broken_tooth", "load_percent"))
    for key, shape in (
        ("broken_tooth", broken.shape),
        ("load_percent", load.shape),
        ("recording_names", (len(recordings),)),
    ):
        if shape != (len(signals),):
            raise ValueError(
                f"dataset.{key} must hold one value for each of {len(signals)} recordings, got shape {shape}"
            )
    for key, values, allowed in (
        ("broken_tooth", broken, np.arange(2)),
        ("load_percent", load, 10 * LEVELS),
    ):
        wrong = values[~np.isin(values, allowed)]
        if wrong.size:
            raise ValueError(f"dataset.{key} must hold values of {allowed.tolist()} only, got {wrong[0]:g}")
    for state, name in enumerate(STATES):
        absent = np.setdiff1d(10 * LEVELS, load[broken == state])
        if absent.size:
            raise ValueError(
                f"dataset.load_percent must hold every level from 0 to 90 in both states, but the {name} "
                f"recordings lack {absent.tolist()}"
            )
    rate = dataset["sampling_rate"]
    if isinstance(rate, bool) or not isinstance(rate, Real) or not 0 < float(rate) < np.inf:
        raise ValueError(f"dataset.sampling_rate must be positive and finite, in Hz, got {rate!r}")
    return VibrationData(
        signals=signals,
        levels=(load / 10).astype(np.int64),
        broken=broken == 1,
        recordings=recordings,
        channels=channels,
        sampling_rate=float(rate),
        sampling_rate_inferred=bool(dataset["sampling_rate_inferred"]),
    )


def _numbers(key: str, values: Any) -> Float:
    array = _array(key, values)
    if array.dtype.kind not in "biuf":
        raise ValueError(f"dataset.{key} must hold real numbers, got an array of {array.dtype}")
    if not np.isfinite(array).all():
        raise ValueError(f"dataset.{key} must be finite, got NaN or infinity")
    return array.astype(np.float64)


def _names(key: str, values: Any) -> tuple[str, ...]:
    array = _array(key, values)
    if array.ndim != 1:
        raise ValueError(f"dataset.{key} must be a list of names, got {values!r}")
    return tuple(str(name) for name in array)


def _array(key: str, values: Any) -> NDArray[Any]:
    try:
        return np.asarray(values)
    except ValueError:
        raise ValueError(f"dataset.{key} must be an array, got rows of different lengths") from None


def cut(data: VibrationData, window_samples: int) -> Float:
    """Windows without overlap, shape (n_channels, n_recordings, n_windows, window_samples)."""
    n_recordings, n_samples, n_channels = data.signals.shape
    n_windows = n_samples // window_samples
    whole = data.signals[:, : n_windows * window_samples].transpose(2, 0, 1)
    windows = whole.reshape(n_channels, n_recordings, n_windows, window_samples)
    constant = np.argwhere(windows.max(axis=3) == windows.min(axis=3))
    if constant.size:
        channel, recording, window = constant[0]
        raise ValueError(
            f"dataset.signals must vary, but window {window} of recording {data.recordings[recording]}, "
            f"channel {data.channels[channel]}, is constant"
        )
    return windows
