"""Overlap of a scalogram's minima with those of the worst class."""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from numbers import Integral, Real
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.utils import check_consistent_length, column_or_1d

from cyclofeat._base.sklearn_private import Interval, StrOptions
from cyclofeat.features._wavelets import WaveletTransformer
from cyclofeat.features.base import SPEED_CONSTRAINTS, check_reach, half_turn
from cyclofeat.features.registry import DEEPEST_LEVEL, HALF_TURN, REGISTRY
from cyclofeat.signal import lobes
from cyclofeat.signal.wavelets import dwt, lowest_colour, visible, wavelet_qualifier
from cyclofeat.signal.windows import Float

_N_REFERENCES = 8
# Samples that are compared before a whole window is.
_N_PROBES = 16


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
    **Reference.** Windows at equal distances in the class's order, so that they come from as many recordings
    as possible. In ``transform``, a window that is identical to one in the reference is not compared with it
    (it would share all its minima), unless nothing else is in the reference. Other windows of a recording in
    the reference still resemble it: evaluate with whole assemblies held out. Without ``y`` all windows count
    as one class, and ``reference`` must be ``"worst"``.

    **Alignment.** The compared part of the scalogram begins at the border of two coefficients nearest to the
    window's lobe phase and is one lobe period (15/16 of an input turn) shorter than the window, so that it
    fits behind every phase. From level 8 on (at 25.6 kHz) a coefficient is longer than a slot, and alignment
    means little. Colours are those of the whole window. With ``"none"``, coefficients count by their cells in
    the central cut: the exact share of MATLAB's picture. Windows must hold ``2 ** levels`` samples and, to be
    aligned, half an output turn; those of less than two lobe periods are compared from their first sample on.

    A constant window is of the lowest colour throughout. A peaked level has many cells of the lowest colour
    and shares many with any other, so that the worst class need not have the largest overlap. Paper A found
    no gradual relation in measured torque. Read it beside :class:`WaveletLevelStatistics`.

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

    _parameter_constraints: ClassVar[dict[str, list[Any]]] = {
        **WaveletTransformer._parameter_constraints,
        "levels": [Interval(Integral, 1, 30, closed="both")],
        "colours": [Interval(Integral, 2, None, closed="left")],
        "reference": [str, Real],
        "align": [StrOptions({"energy", "none"})],
        **SPEED_CONSTRAINTS,
    }

    needs: ClassVar[str] = f"{DEEPEST_LEVEL}; to be aligned, {HALF_TURN}"

    levels: int = 12
    colours: int = 64
    reference: float | str = "worst"
    align: str = "energy"
    input_speed_hz: float = 500 / 60
    n_lobes: int = 15
    speed_tolerance: float = 0.015

    def needed_samples(self) -> int:
        aligned = self.align == "energy"
        turn = half_turn(self.sampling_rate, self.input_speed_hz, self.n_lobes) if aligned else 0
        return int(max(1 << self.levels, turn))

    def _fit_windows(self, X: NDArray[Any], y: ArrayLike | None) -> None:
        super()._fit_windows(X, y)
        if self.align == "energy":
            highest = lobes.highest_frequency(
                self.input_speed_hz, self.n_lobes, self.n_lobes, self.speed_tolerance
            )
            what = f"placing {self.n_lobes} lobes"
            check_reach(self, highest, what, "takes", "use a higher rate or align='none'")
        if y is None and self.reference != "worst":
            raise ValueError(f"reference={self.reference!r} is a label of y, but fit was given no y")
        self.reference_class_: Any = None
        members = np.arange(len(X))
        if y is not None:
            labels = column_or_1d(y)
            check_consistent_length(labels, np.empty(len(X)))
            classes = np.unique(labels)
            if self.reference != "worst" and self.reference not in classes.tolist():
                raise ValueError(
                    f"reference must be 'worst' or a label in y ({', '.join(map(repr, classes.tolist()))}), "
                    f"got {self.reference!r}"
                )
            self.reference_class_ = classes[-1] if self.reference == "worst" else self.reference
            members = np.flatnonzero(labels == self.reference_class_)
        spread = np.linspace(0, len(members) - 1, min(_N_REFERENCES, len(members))).round().astype(int)
        windows = np.ascontiguousarray(X[members[spread]], dtype=np.float64)
        self._probes = windows[:, self._probe_samples(X.shape[1])]
        self._digests = [_hash_window(window) for window in windows]
        coefficients = dwt(windows, self.wavelet, self.levels)
        self.reference_minima_ = [minima for minima, _ in self._level_minima(windows, coefficients)]

    def _feature_names(self) -> list[str]:
        row = REGISTRY["minima_overlap"]
        # Labels may hold what names may not.
        label = re.sub(r"[^\w.+-]", "_", str(self.reference), flags=re.ASCII)
        definition = (wavelet_qualifier(self.wavelet), f"{self.colours}colours", self.align, label)
        return [row.column(*definition, f"level{level:02d}") for level in range(1, self.levels + 1)]

    def _deepest_level(self) -> int:
        return self.levels

    def _from_coefficients(
        self, X: NDArray[Any], coefficients: Sequence[Float], lines: lobes.LobeLines | None = None
    ) -> Float:
        # ``lines``: lobe lines of X, if they are at hand (LobeMap's of the same speed, lobes and tolerance).
        # Share of cells that are lowest in both; its median over the references (axis 1) that are not
        # excluded, or over all where all are.
        shared = np.empty((len(X), len(self._digests), self.levels))
        of_level = zip(self._level_minima(X, coefficients, lines), self.reference_minima_, strict=True)
        for level, ((minima, cells), reference) in enumerate(of_level):
            # Whole numbers in single precision: exact in windows of up to 2^24 samples.
            weighted = (reference * cells).astype(np.float32)
            shared[:, :, level] = minima.astype(np.float32) @ weighted.T
            shared[:, :, level] /= cells.sum()
        # Windows that are identical to one of the reference.
        probes = np.asarray(X[:, self._probe_samples(X.shape[1])], dtype=np.float64)
        excluded: NDArray[np.bool_] = (probes[:, np.newaxis] == self._probes).all(axis=2)
        for row in np.flatnonzero(excluded.any(axis=1)):
            digest = _hash_window(np.asarray(X[row], dtype=np.float64))
            excluded[row] &= [digest == other for other in self._digests]
        medians = np.median(shared, axis=1)
        for row in np.flatnonzero(excluded.any(axis=1) & ~excluded.all(axis=1)):
            medians[row] = np.median(shared[row, ~excluded[row]], axis=0)
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
        lines = lines or self.lines(X)
        if lines is None:
            return None
        phase = np.mod(lobes.energy_centre(lobes.fold(lines.lines, self.n_lobes)), 1.0)
        period = self.sampling_rate / lobes.lobe_frequency(1.0, self.n_lobes) / lines.input_speed_hz
        starts = np.floor(phase * period).astype(np.int64)
        return np.minimum(starts, self._longest_period() - 1)

    def lines(self, X: NDArray[Any]) -> lobes.LobeLines | None:
        """Return the lobe lines that place windows; None if these are not aligned.

        Parameters
        ----------
        X : ndarray, shape (n_windows, n_samples)
            Windows of torque in Nm.

        Returns
        -------
        LobeLines or None
        """
        nominal = lobes.lobe_frequency(self.input_speed_hz, self.n_lobes)
        # The same limit as in lobe_lines; the comparison then has something left to compare.
        if self.align == "none" or X.shape[1] * nominal < 2 * self.sampling_rate:
            return None
        reached = lobes.highest_frequency(self.input_speed_hz, self.n_lobes, 1, self.speed_tolerance)
        n_lines = min(lobes.N_LINES, int(self.sampling_rate / 2 / reached))
        comb = lobes.LobeComb(self.n_lobes, n_lines, speed_tolerance=self.speed_tolerance)
        windows = np.asarray(X, dtype=np.float64)
        return lobes.lobe_lines(windows, self.sampling_rate, self.input_speed_hz, comb)

    def _probe_samples(self, n_samples: int) -> NDArray[np.intp]:
        return np.linspace(0, n_samples - 1, _N_PROBES).astype(np.intp)


def _hash_window(window: Float) -> bytes:
    # + 0.0 makes one zero of both.
    return hashlib.blake2b((window + 0.0).tobytes(), digest_size=16).digest()
