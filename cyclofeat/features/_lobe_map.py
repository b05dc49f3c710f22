"""Transformer over ``signal.lobes``: torque folded lobe by lobe."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cyclofeat._base.sklearn_private import StrOptions
from cyclofeat.features import base
from cyclofeat.features.registry import REGISTRY
from cyclofeat.signal import lobes
from cyclofeat.signal.windows import Float


@dataclass(eq=False, repr=False)
class LobeMap(base.WindowTransformer):
    """Torque folded into one slot per lobe, and the lobe lines.

    The torque of each window is whitened and its lobe lines are fitted
    (:func:`cyclofeat.signal.lobes.lobe_lines`). Each window gives, for each slot of the fold, mean and rms
    about that mean in units of the whole window's standard deviation, and for each lobe line its
    :func:`~cyclofeat.signal.lobes.line_prominence` and :func:`~cyclofeat.signal.lobes.line_contrast` in dB.

    Parameters
    ----------
    sampling_rate : float
        Samples per second in Hz, or per input turn for windows on equal steps of the angle.
    input_speed_hz : float, default=500/60
        Nominal input speed in turns per second; 1 for windows on equal steps of the angle.
    n_lobes : int, default=15
        Number of lobes z_s of a disc.
    n_lines : int, default=44
        Number of lobe lines.
    ar_order : int, default=16
        Order of the autoregressive model; 0 leaves the resonance in.
    speed_tolerance : float, default=0.015
        Largest relative deviation from the nominal speed that is searched; 0 takes the nominal speed, as is
        right for windows on equal steps of the angle.
    align : {"energy", "start"}, default="energy"
        Where slot 0 begins. ``"energy"``: half the disc before the circular mean of the fold's energy, which
        makes the slots independent of where the window starts. ``"start"``: at the window's first sample; in
        windows that start at a known absolute angle, slots are then fixed to lobes.

    Notes
    -----
    Windows must hold half an output turn (``docs/windows.rst``). A window of less than two lobe periods
    (0.225 s at 500 RPM) and one without torque variation have slots 0 and lines -30 dB. No feature depends on
    the scale of the torque.

    Examples
    --------
    A disturbance at every passage of lobe 3:

    >>> import numpy as np
    >>> from cyclofeat.features import LobeMap
    >>> phase = np.arange(46_080) / 25_600 * 500 / 60 * 16 / 15 * 15
    >>> torque = 22 + (phase.astype(int) % 15 == 3) * np.sin(2 * np.pi * phase) ** 2
    >>> lobe_map = LobeMap(sampling_rate=25_600, align="start", speed_tolerance=0)
    >>> int(lobe_map.fit_transform(torque[np.newaxis])[0, 15:30].argmax())
    3
    """

    input_speed_hz: float = base.parameter(*base.INPUT_SPEED_HZ)
    n_lobes: int = base.parameter(*base.N_LOBES)
    n_lines: int = base.parameter(lobes.N_LINES, base.at_least(lobes.FEWEST_LINES))
    ar_order: int = base.parameter(16, base.at_least(0))
    speed_tolerance: float = base.parameter(*base.SPEED_TOLERANCE)
    align: str = base.parameter("energy", StrOptions({"energy", "start"}))

    def _shortest_window(self) -> tuple[int, str]:
        return base.half_output_turn(self.sampling_rate, self.input_speed_hz, self.n_lobes)

    def _fit_windows(self, X: NDArray[Any], y: ArrayLike | None) -> None:
        highest = lobes.highest_frequency(
            self.input_speed_hz, self.n_lobes, self.n_lines, self.speed_tolerance
        )
        what = f"n_lines={self.n_lines} lobe lines"
        base.check_reach(self, highest, what, "reach", "use fewer lines or a higher rate")

    def _feature_names(self) -> list[str]:
        names = [
            REGISTRY[name].column(f"slot{slot:02d}")
            for name in ("lobe_slot_mean", "lobe_slot_rms")
            for slot in range(self.n_lobes)
        ]
        return names + [
            REGISTRY[name].column(f"k{line:02d}")
            for name in ("lobe_line_prominence", "lobe_line_contrast")
            for line in range(1, self.n_lines + 1)
        ]

    def _compute_features(self, X: NDArray[Any]) -> Float:
        return self.from_lines(self.lines(X))

    def from_lines(self, lines: lobes.LobeLines) -> Float:
        """Return the features of windows whose lobe lines are at hand.

        Parameters
        ----------
        lines : LobeLines

        Returns
        -------
        ndarray, shape (n_windows, n_features)
        """
        folded = lobes.fold(lines.lines, self.n_lobes)
        if self.align == "energy":
            centred = lobes.shift(lines.lines, lobes.energy_centre(folded) - 0.5)
            folded = lobes.fold(centred, self.n_lobes)
        slots = [folded.mean(axis=2), folded.std(axis=2)]
        return np.hstack([*slots, lobes.line_prominence(lines), lobes.line_contrast(lines)])

    def lines(self, X: NDArray[Any]) -> lobes.LobeLines:
        """Return the lobe lines and the refined input speed of windows.

        Parameters
        ----------
        X : ndarray, shape (n_windows, n_samples)
            Windows of torque in Nm.

        Returns
        -------
        LobeLines
        """
        comb = lobes.LobeComb(self.n_lobes, self.n_lines, self.ar_order, self.speed_tolerance)
        windows = np.asarray(X, dtype=np.float64)
        return lobes.lobe_lines(windows, self.sampling_rate, self.input_speed_hz, comb)
