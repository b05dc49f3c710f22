"""Recordings, model and corrected model, summarised for pictures that lay them over each other."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.fft import rfft, rfftfreq
from sklearn.utils.validation import check_array

from cyclofeat.gap.comparison import Comparison, Condition
from cyclofeat.gap.summaries.summarise import RESOLUTION_NM, SPEED_TOLERANCE
from cyclofeat.signal.orders import estimate_input_speed, order_lines

Float = NDArray[np.float64]

KINDS = ("spectrum", "orders", "distribution")
_BANDS_PER_OCTAVE = 12
_HIGHEST_SHARE = 0.4  # of the sampling rate, up to which torque is shown
_LAST_ORDER = 36  # holds two lines of the mesh of 15 lobes
_BINS = 60
_RANGE = (5, 95)  # percent


@dataclass(frozen=True)
class Band:
    """Mean over recordings, and the range that holds nine in ten of them; each of shape (n,)."""

    mean: Float
    low: Float
    high: Float


@dataclass(frozen=True, eq=False)
class Overlay:
    """One picture's curves of recordings, model and corrected model at one condition.

    The ``"spectrum"`` is the rms in Nm by twelfth octaves over the frequency in Hz, ``"orders"`` are
    amplitudes in Nm of the lines of the output turn over the order of the input shaft, and the
    ``"distribution"`` is the density in 1/Nm over the torque in Nm. ``corrected`` is None where nothing was
    added to the model.
    """

    kind: str
    x: Float = field(repr=False)
    measured: Band = field(repr=False)
    model: Band = field(repr=False)
    corrected: Band | None = field(repr=False)
    condition: Condition


def summarise_overlays(
    comparison: Comparison, measured: ArrayLike, model: ArrayLike, corrected: ArrayLike | None = None
) -> tuple[Overlay, ...]:
    """Summarise recordings, model and corrected model at one condition for pictures.

    Each is torque in Nm, (n_recordings, n_samples), positive for a load that brakes; ``corrected`` is None
    where nothing was added. Returns spectrum, orders, and distribution.
    """
    kinematics = comparison.kinematics
    sets = {"measured": measured, "model": model, "corrected": corrected}
    torque = {
        name: check_array(X, dtype=np.float64, input_name=name) for name, X in sets.items() if X is not None
    }
    lengths = {name: X.shape[1] for name, X in torque.items()}
    if len(set(lengths.values())) > 1:
        raise ValueError(f"measured, model and corrected must be of equal length in samples, got {lengths}")
    # The distribution's range leaves out the outermost samples in 2,000.
    ends = np.array([np.percentile(X, [0.05, 99.95]) for X in torque.values()])
    low, high = float(ends[:, 0].min()), float(ends[:, 1].max())
    edges = np.linspace(low, max(high, low + RESOLUTION_NM), _BINS + 1)
    # Band of each bin of the spectrum (-1: none), and the centres of those that hold a bin.
    rate, nominal, n_lobes = kinematics.sampling_rate, kinematics.input_speed_hz, kinematics.n_lobes
    bins = rfftfreq(lengths["measured"], 1 / rate)
    inside = (bins > 0) & (bins <= _HIGHEST_SHARE * rate)
    numbers = np.round(_BANDS_PER_OCTAVE * np.log2(bins[inside]))
    bands, band_of_bin = np.unique(numbers, return_inverse=True)
    # Lines of the output turn up to ``_LAST_ORDER``, below half of the sampling rate.
    fastest = nominal * (1 + SPEED_TOLERANCE) / n_lobes
    n_lines = min(_LAST_ORDER * n_lobes, int(_HIGHEST_SHARE * rate / fastest))

    def band_rms(X: Float) -> Float:
        n = X.shape[1]
        window = np.hanning(n)
        ripple = (X - X.mean(axis=1, keepdims=True)) * window
        power = 2 * np.abs(rfft(ripple, axis=1)) ** 2 / (n * np.sum(window**2))
        # Less than the resolution is no difference.
        power += 2 * RESOLUTION_NM**2 / n
        return np.sqrt([np.bincount(band_of_bin, row[inside]) for row in power])

    def line_amplitudes(X: Float) -> Float:
        speeds = estimate_input_speed(X, rate, nominal, SPEED_TOLERANCE, comb="mesh", n_lobes=n_lobes)
        lines = np.abs(order_lines(X, rate, speeds, n_lines, n_lobes))
        return np.asarray(np.hypot(lines, 2 * RESOLUTION_NM / np.sqrt(X.shape[1])))

    def make_overlay(kind: str, x: Float, values: Callable[[Float], Float]) -> Overlay:
        bands: dict[str, Band | None] = dict.fromkeys(sets)
        for name, X in torque.items():
            of_set = values(X)
            # Amplitudes range over decades: their mean is that of the levels.
            mean = of_set.mean(axis=0) if kind == "distribution" else np.exp(np.log(of_set).mean(axis=0))
            bands[name] = Band(mean, *np.percentile(of_set, _RANGE, axis=0))
        return Overlay(kind=kind, x=x, **bands, condition=comparison.condition)  # type: ignore[arg-type]

    return (
        make_overlay("spectrum", 2 ** (bands / _BANDS_PER_OCTAVE), band_rms),
        make_overlay("orders", np.arange(1, n_lines + 1) / n_lobes, line_amplitudes),
        make_overlay(
            "distribution",
            (edges[1:] + edges[:-1]) / 2,
            lambda X: np.array([np.histogram(x, edges)[0] / (x.size * (edges[1] - edges[0])) for x in X]),
        ),
    )
