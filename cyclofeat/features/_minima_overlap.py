"""Overlap of a scalogram's minima with those of the worst class."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from dataclasses import dataclass
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cyclofeat._base.sklearn_private import StrOptions
from cyclofeat.features import base
from cyclofeat.features._wavelets import COLOURS, LEVELS, WaveletTransformer
from cyclofeat.features.registry import REGISTRY, label_qualifier
from cyclofeat.signal import lobes
from cyclofeat.signal.wavelets import dwt, lowest_colour, visible, wavelet_qualifier
from cyclofeat.signal.windows import Float


@dataclass(eq=False, repr=False)
class WaveletMinimaOverlap(WaveletTransformer):
    """Cells of the lowest colour that a window's scalogram shares with the worst class's (paper B section 7).

    For each level: the share of the scalogram's cells (:func:`cyclofeat.signal.wavelets.scalogram`) that have
    the lowest colour both here and in the reference (the dark area of paper B's fig. 18, paper A's fig. 9),
    as the median over up to eight windows of the worst class.

    Parameters
    ----------
    sampling_rate, wavelet, levels, colours
        See :class:`WaveletLevelStatistics`. Paper B saw the overlap grow at levels 3 and 4 only.
    reference : int, float or str, default="worst"
        Class that windows are compared with: ``"worst"`` for the largest label in ``y`` (of strings, the last
        in alphabetical order), or a label. Paper B has 8 worn lobes but refers to 7.
    align : {"energy", "none"}, default="energy"
        Whether scalograms are compared from the same phase of the lobes' passage on. ``"energy"``: from the
        circular mean of the energy of the folded torque on (see :class:`LobeMap`), so that it does not matter
        where a window starts. ``"none"``: from the window's first sample on, as in the papers, whose
        simulations all start alike.
    input_speed_hz, n_lobes, speed_tolerance
        For the alignment, as for :class:`LobeMap`.

    Attributes
    ----------
    reference_class_ : object
        Label of the windows in the reference; None where ``fit`` was given no ``y``.
    reference_minima_ : list of ndarray of bool, shape (n_references, n_compared)
        For each level, which of the compared coefficients of the reference have the lowest colour.

    Notes
    -----
    **Reference.** Windows at equal distances in the class's order, or, without ``y``, in that of all. In
    ``transform``, a window is not compared with itself in the reference (it would share all its minima),
    unless nothing else is there. Other windows of a recording in the reference still resemble it: evaluate
    with whole assemblies held out.

    **Alignment.** The compared part begins at the border of two coefficients nearest to the window's lobe
    phase and is one lobe period (15/16 of an input turn) shorter than the window, so that it fits behind
    every phase; colours are those of the whole window. From level 8 on (at 25.6 kHz) a coefficient is longer
    than a slot, and alignment means little. Windows must hold ``2 ** levels`` samples and, to be aligned,
    half an output turn; those of less than two lobe periods are compared from their first sample on.

    A peaked level has many cells of the lowest colour and shares many with any other, so that the worst class
    need not have the largest overlap: read it beside :class:`WaveletLevelStatistics`.

    Examples
    --------
    Windows with a burst at each passage of lobe 3, the larger the more it is worn, and noise. The larger the
    bursts, the more of the noise falls into the lowest colour:

    >>> import numpy as np
    >>> from cyclofeat.features import WaveletMinimaOverlap
    >>> slot = np.arange(46_080) / 192.3 % 15
    >>> burst = np.exp(-(((slot - 3.5) * 8) ** 2)) * np.cos(2 * np.pi * 12 * slot)
    >>> noise = np.random.default_rng(0).normal(scale=0.05, size=(6, 46_080))
    >>> y = np.repeat([1, 2, 3], 2)
    >>> transformer = WaveletMinimaOverlap(sampling_rate=25_600, levels=4)
    >>> transformer.fit_transform(22 + np.outer(y, burst) + noise, y)[:, 3].round(1)
    array([0.5, 0.5, 0.8, 0.8, 0.9, 0.9])
    """

    levels: int = base.parameter(*LEVELS)
    colours: int = base.parameter(*COLOURS)
    reference: float | str = base.parameter("worst", str, Real)
    align: str = base.parameter("energy", StrOptions({"energy", "none"}))
    input_speed_hz: float = base.parameter(*base.INPUT_SPEED_HZ)
    n_lobes: int = base.parameter(*base.N_LOBES)
    speed_tolerance: float = base.parameter(*base.SPEED_TOLERANCE)

    def _shortest_window(self) -> tuple[int, str]:
        deepest, what = 1 << self.levels, "one coefficient of the deepest level"
        turn, of_turn = base.half_output_turn(self.sampling_rate, self.input_speed_hz, self.n_lobes)
        return max(deepest, turn if self.align == "energy" else 0), f"{what}; to be aligned, {of_turn}"

    def _fit_windows(self, X: NDArray[Any], y: ArrayLike | None) -> None:
        super()._fit_windows(X, y)
        if self.align == "energy":
            highest = lobes.highest_frequency(
                self.input_speed_hz, self.n_lobes, self.n_lobes, self.speed_tolerance
            )
            what = f"placing {self.n_lobes} lobes"
            base.check_reach(self, highest, what, "takes", "use a higher rate or align='none'")
        windows, self.reference_class_ = base.reference_windows(X, y, self.reference, ("worst", -1))
        windows = np.ascontiguousarray(windows, dtype=np.float64)
        self._probes = windows[:, :1]
        self._digests = [_hash_window(window) for window in windows]
        coefficients = dwt(windows, self.wavelet, self.levels)
        self.reference_minima_ = [minima for minima, _ in self._level_minima(windows, coefficients)]

    def _feature_names(self) -> list[str]:
        row, label = REGISTRY["minima_overlap"], label_qualifier(self.reference)
        definition = (wavelet_qualifier(self.wavelet), f"{self.colours}colours", self.align, label)
        return [row.column(*definition, f"level{level:02d}") for level in range(1, self.levels + 1)]

    def _deepest_level(self) -> int:
        return self.levels

    def _from_coefficients(
        self, X: NDArray[Any], coefficients: Sequence[Float], lines: lobes.LobeLines | None = None
    ) -> Float:
        # ``lines``: lobe lines of X, if they are at hand (LobeMap's of the same speed, lobes and tolerance).
        shared = np.empty((len(X), len(self._digests), self.levels))  # share of cells that are lowest in both
        of_level = zip(self._level_minima(X, coefficients, lines), self.reference_minima_, strict=True)
        for level, ((minima, cells), reference) in enumerate(of_level):
            # Whole numbers in single precision: exact in windows of up to 2^24 samples.
            weighted = (reference * cells).astype(np.float32)
            shared[:, :, level] = minima.astype(np.float32) @ weighted.T
            shared[:, :, level] /= cells.sum()
        medians = np.median(shared, axis=1)
        # Most windows differ from all of the reference in their first sample.
        for row in np.flatnonzero(np.isin(X[:, 0].astype(np.float64), self._probes[:, 0])):
            digest = _hash_window(np.asarray(X[row], dtype=np.float64))
            others = [digest != other for other in self._digests]
            if any(others) and not all(others):
                medians[row] = np.median(shared[row, others], axis=0)
        return medians

    def _level_minima(
        self, X: NDArray[Any], coefficients: Sequence[Float], lines: lobes.LobeLines | None = None
    ) -> list[tuple[NDArray[np.bool_], Float]]:
        """For each level: which of the compared coefficients are lowest, and how many cells each has."""
        n_samples = X.shape[1]
        starts = self._phase_starts(X, lines)
        result = []
        for level in range(1, self.levels + 1):
            shown, cells = visible(coefficients[level - 1], level, n_samples)
            minima = lowest_colour(shown, self.colours)
            if starts is not None:
                size = 1 << level
                compared = max((n_samples - self._longest_period()) >> level, 1)
                # Cells that the central cut left of the first coefficient shown.
                first = (starts + (size - int(cells[0])) + size // 2) >> level
                first = np.minimum(first, shown.shape[1] - compared)
                minima = np.stack([row[at : at + compared] for row, at in zip(minima, first, strict=True)])
                cells = np.full(compared, size)
            result.append((minima, cells.astype(np.float64)))
        return result

    def _longest_period(self) -> int:
        """Samples of the longest lobe period that the speed's tolerance allows."""
        slowest = lobes.lobe_frequency(self.input_speed_hz, self.n_lobes) * (1 - self.speed_tolerance)
        return math.ceil(self.sampling_rate / slowest)

    def _phase_starts(self, X: NDArray[Any], lines: lobes.LobeLines | None) -> NDArray[np.int64] | None:
        """Sample of each window that its lobe phase begins at; None if they are not aligned."""
        lines = lines or self._lines(X)
        if lines is None:
            return None
        phase = np.mod(lobes.energy_centre(lobes.fold(lines.lines, self.n_lobes)), 1.0)
        period = self.sampling_rate / lobes.lobe_frequency(1.0, self.n_lobes) / lines.input_speed_hz
        starts = np.floor(phase * period).astype(np.int64)
        return np.minimum(starts, self._longest_period() - 1)

    def _lines(self, X: NDArray[Any]) -> lobes.LobeLines | None:
        """Return the lobe lines that place windows; None if these are not aligned."""
        nominal = lobes.lobe_frequency(self.input_speed_hz, self.n_lobes)
        # The same limit as in lobe_lines; the comparison then has something left to compare.
        if self.align == "none" or X.shape[1] * nominal < 2 * self.sampling_rate:
            return None
        reached = lobes.highest_frequency(self.input_speed_hz, self.n_lobes, 1, self.speed_tolerance)
        n_lines = min(lobes.N_LINES, int(self.sampling_rate / 2 / reached))
        comb = lobes.LobeComb(self.n_lobes, n_lines, speed_tolerance=self.speed_tolerance)
        return lobes.lobe_lines(np.asarray(X, dtype=float), self.sampling_rate, self.input_speed_hz, comb)


def _hash_window(window: Float) -> bytes:
    # + 0.0 makes one zero of both.
    return hashlib.blake2b((window + 0.0).tobytes(), digest_size=16).digest()
