"""Amplitudes at the order lines of a turn."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cyclofeat._base.sklearn_private import StrOptions
from cyclofeat.features import base
from cyclofeat.features.registry import REGISTRY
from cyclofeat.signal.orders import COMBS, comb_lines, estimate_input_speed, order_lines
from cyclofeat.signal.windows import Float

# Around a mesh line: with 15 lobes the 15th is an input turn, the 16th a lobe away.
_N_SIDEBANDS = 16


@dataclass(eq=False, repr=False)
class OrderSpectrum(base.WindowTransformer):
    """Amplitudes of the torque, in Nm, at the first order lines and around the mesh.

    The lines of each window (:func:`cyclofeat.signal.order_lines`) are read at its refined input speed
    (:func:`cyclofeat.signal.orders.estimate_input_speed`). With 15 lobes line 15 of the output turn is the
    input turn, line 16 the passage of a lobe, line 240 the mesh.

    Parameters
    ----------
    sampling_rate, input_speed_hz, n_lobes, speed_tolerance
        See :class:`LobeMap`.
    n_lines : int, default=48
        Number of lines from the first on.
    n_mesh_lines : int, default=2
        Number of mesh lines (multiples of order z_s + 1) that are kept with 16 sidebands on each side.
    comb : {"lobe", "mesh"}, default="lobe"
        Lines by which the speed is found, as for :func:`cyclofeat.signal.orders.estimate_input_speed`.

    Notes
    -----
    In windows of less than an output turn (1.8 s at 500 RPM) neighbouring lines of the output turn blend;
    they must hold half of one.
    Drift of the brake leaks into the lowest lines; :class:`HighPass` takes it out.

    Examples
    --------
    A mesh line with sidebands one input turn apart, at a speed 0.8 % above the nominal:

    >>> import numpy as np
    >>> from cyclofeat.features import OrderSpectrum
    >>> phase = 2 * np.pi * 8.4 * np.arange(46_080) / 25_600
    >>> torque = 22 + (1 + 0.2 * np.cos(phase)) * np.cos(16 * phase)
    >>> transformer = OrderSpectrum(sampling_rate=25_600, comb="mesh").fit(torque[np.newaxis])
    >>> names, amplitudes = transformer.get_feature_names_out(), transformer.transform(torque[np.newaxis])[0]
    >>> for k in (225, 239, 240):
    ...     print(k, amplitudes[names == f"order_amplitude_nm(output;k{k};v2)"][0].round(2))
    225 0.1
    239 0.02
    240 1.0
    """

    input_speed_hz: float = base.parameter(*base.INPUT_SPEED_HZ)
    n_lines: int = base.parameter(48, base.at_least(1))
    n_mesh_lines: int = base.parameter(2, base.at_least(0))
    n_lobes: int = base.parameter(*base.N_LOBES)
    speed_tolerance: float = base.parameter(*base.SPEED_TOLERANCE)
    comb: str = base.parameter("lobe", StrOptions(set(COMBS)))

    def _line_numbers(self) -> NDArray[np.intp]:
        """Numbers of the lines that are features."""
        mesh = self.n_lobes * (self.n_lobes + 1)
        aside = np.arange(-_N_SIDEBANDS, _N_SIDEBANDS + 1)
        around = np.add.outer(mesh * np.arange(1, self.n_mesh_lines + 1), aside).ravel()
        lines = np.union1d(np.arange(1, self.n_lines + 1), around)
        return lines[lines > 0]

    def _shortest_window(self) -> tuple[int, str]:
        return base.half_output_turn(self.sampling_rate, self.input_speed_hz, self.n_lobes)

    def _fit_windows(self, X: NDArray[Any], y: ArrayLike | None) -> None:
        last = int(self._line_numbers()[-1])
        highest = last / self.n_lobes * self.input_speed_hz * (1 + self.speed_tolerance)
        base.check_reach(self, highest, f"line {last}", "reaches", "use fewer lines or a higher rate")
        if self.speed_tolerance > 0:  # raises where the rate is too low
            comb_lines(self.sampling_rate, self.input_speed_hz, self.speed_tolerance, self.comb, self.n_lobes)

    def _feature_names(self) -> list[str]:
        lines = self._line_numbers()
        digits = len(str(lines[-1]))
        return [REGISTRY["order_amplitude"].column("output", f"k{line:0{digits}d}") for line in lines]

    def _compute_features(self, X: NDArray[Any]) -> Float:
        speeds = estimate_input_speed(
            X, self.sampling_rate, self.input_speed_hz, self.speed_tolerance, self.comb, self.n_lobes
        )
        return self._from_speed(X, speeds)

    def _from_speed(self, X: NDArray[Any], speeds: Float) -> Float:
        """Features, shape (n_windows, n_features), of windows whose input speeds are known."""
        lines = self._line_numbers()
        amplitudes = order_lines(X, self.sampling_rate, speeds, int(lines[-1]), self.n_lobes)
        return np.abs(amplitudes[:, lines - 1])
