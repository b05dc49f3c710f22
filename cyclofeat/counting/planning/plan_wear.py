"""Least depth of radial wear that shows, from the lobe lines of simulated twins."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2, ncx2

from cyclofeat._base.checks import number, positive, whole
from cyclofeat._base.frames import frame
from cyclofeat.counting.model.radial_wear import lobe_lines_nm, runs_of
from cyclofeat.recordings.windower import lobe_windower
from cyclofeat.signal.windows import Complex, Float

if TYPE_CHECKING:  # the simulator loads numba: only those who simulate wait for it
    import pandas as pd

    from cyclofeat.simulators import Rig

# The brake drifts below.
_LOWEST_LINE = 3
# Mean power of white noise in a line read with a Hann window, in units of its variance per sample.
_NOISE_IN_LINE = 6.0
_NOISE_HZ = 25_600.0  # sampling rate for which noise is stated
# Recordings are a little longer than the windows, as speeds differ by a per cent.
_MARGIN = 1.01
_N_STEPS = 121


@dataclass(frozen=True)
class WearPlan:
    """Answer of :func:`plan_wear`.

    Attributes
    ----------
    worn : int
        Number of worn lobes.
    confidence, noise_nm : float
        Requested values.
    rig : str
    speed_rpm, load_nm : float
        Nominal input speed and load.
    turns, seconds : int, float
        Length of the recording, in output turns and in s.
    depths_um, probability : tuple of float
        Simulated depths, and the probability at each of telling worn from healthy.
    least_um : float or None
        Least depth at which the probability reaches the confidence, interpolated; None where the deepest is
        not enough, the shallowest where that is enough.
    assemblies : int
        Simulated assemblies on which that stands.
    """

    worn: int
    confidence: float
    noise_nm: float
    rig: str
    speed_rpm: float
    load_nm: float
    turns: int
    seconds: float
    depths_um: tuple[float, ...]
    probability: tuple[float, ...]
    least_um: float | None
    assemblies: int

    def to_dict(self) -> dict[str, Any]:
        """Return the plan in plain types, for JSON."""
        return asdict(self) | {"depths_um": list(self.depths_um), "probability": list(self.probability)}

    def to_frame(self) -> pd.DataFrame:
        """Return a table of ``depth_um`` and ``probability``; ImportError if pandas is not installed."""
        return frame({"depth_um": self.depths_um, "probability": self.probability})


def plan_wear(
    worn: int,
    *,
    noise_nm: float,
    confidence: float = 0.95,
    rig: str | Rig = "R1",
    speed_rpm: float | None = None,
    load_nm: float | None = None,
    output_turns: int = 5,
    depths_um: Sequence[float] = (5.0, 10.0, 20.0, 50.0, 100.0, 200.0),
    n_assemblies: int = 8,
    random_state: int = 0,
    n_jobs: int = 1,
) -> WearPlan:
    """Plan which depth of radial wear shows, at a noise, speed and load.

    Parameters
    ----------
    worn : int
        Neighbouring worn lobes, at least 1, on both wheels.
    noise_nm : float
        Standard deviation of the torque meter's white noise at 25.6 kHz, in Nm.
    confidence : float
        Wanted probability of telling worn from healthy, above 0.5 and below 1.
    rig : str or Rig
        As in :func:`cyclofeat.datasets.make_rig_recordings`.
    speed_rpm, load_nm : float, optional
        Nominal input speed in RPM and load in Nm. Default: those of the rig's gearbox.
    output_turns : int
        Length of the recording.
    depths_um : sequence of float
        Depths to simulate, increasing, in um, up to 200.
    n_assemblies : int
        Assemblies to simulate, healthy and at each depth, at least 2.
    random_state, n_jobs : int
        Seed and threads of the simulation.

    Returns
    -------
    WearPlan

    Raises
    ------
    TypeError, ValueError
        If an argument is of the wrong type or outside its range; the message names it.

    Notes
    -----
    The same assemblies are simulated healthy and worn, without noise. Let h_k be the mean power of lobe line
    k over the healthy ones, d_k the change of its amplitude by the wear, and w = 6 noise_nm^2 / n the mean
    power of the noise in a line of n samples (Hann window). The detector adds the powers of the K lines from
    the third on, each divided by v_k = h_k + w. Twice the sum is chi-squared with 2 K degrees of freedom for
    a healthy disc, and noncentral by 2 sum |d_k|^2 / v_k for a worn one, where errors of assembly are as
    random as noise. The answer is the share of right decisions at the best threshold, healthy and worn
    equally frequent, averaged over assemblies. It says where wear is seen. A count of lobes takes more, and a
    rig that the training did not contain also.

    Examples
    --------
    >>> plan = plan_wear(2, noise_nm=0.2, output_turns=1, depths_um=(10, 100), n_assemblies=2)
    >>> plan.probability[0] < plan.probability[1]
    True
    """
    whole("worn", worn, 1)
    positive("noise_nm", noise_nm)
    if not 0.5 < number("confidence", confidence) < 1:
        raise ValueError(f"confidence must lie above 0.5 (guessing) and below 1, got {confidence!r}")
    whole("output_turns", output_turns, 1)
    whole("n_assemblies", n_assemblies, 2)
    depths = [positive("depths_um", depth) for depth in depths_um]
    if len(depths) < 2 or depths != sorted(set(depths)):
        raise ValueError(f"depths_um must be at least two increasing depths, got {depths_um!r}")
    twins = _Twins(rig, speed_rpm, load_nm, output_turns, n_assemblies, random_state, n_jobs)
    healthy = twins.lines(0, depths[0])
    noise_power = _NOISE_IN_LINE * noise_nm**2 / (twins.seconds * _NOISE_HZ)
    power = (np.abs(healthy) ** 2).mean(axis=0) + noise_power
    noncentral = np.array(
        [2 * (np.abs(twins.lines(worn, depth) - healthy) ** 2 / power).sum(axis=1) for depth in depths]
    )
    probability = right_decisions(noncentral, 2 * healthy.shape[1]).mean(axis=1)
    return WearPlan(
        worn=worn,
        confidence=float(confidence),
        noise_nm=float(noise_nm),
        rig=twins.rig,
        speed_rpm=twins.speed_rpm,
        load_nm=twins.load_nm,
        turns=output_turns,
        seconds=round(twins.seconds, 9),
        depths_um=tuple(depths),
        probability=tuple(probability.tolist()),
        least_um=_least(depths, noncentral, 2 * healthy.shape[1], confidence),
        assemblies=n_assemblies,
    )


def right_decisions(noncentral: NDArray[Any], degrees: int) -> Float:
    """Return the share of right decisions between a chi-squared number and a noncentral one.

    Parameters
    ----------
    noncentral : ndarray
        Noncentralities.
    degrees : int
        Degrees of freedom.

    Returns
    -------
    ndarray
        At the best threshold, both equally frequent; 0.5 (guessing) to 1.
    """
    largest = max(float(np.max(noncentral)), 1.0)
    table = np.concatenate([[0.0], np.geomspace(min(0.1, largest / 2), largest, 60)])
    threshold = chi2.ppf(np.linspace(0.02, 1 - 1e-6, 200), degrees)
    # Thresholds far above what a healthy disc reaches are of no use.
    missed = ncx2.cdf(threshold, degrees, table[1:, np.newaxis])
    right = np.concatenate([[0.5], ((chi2.cdf(threshold, degrees) + 1 - missed) / 2).max(axis=1)])
    return np.asarray(np.interp(noncentral, table, right))


def _least(depths: Sequence[float], noncentral: Float, degrees: int, confidence: float) -> float | None:
    """Return the least depth whose probability reaches the confidence; None if none does."""
    fine = np.geomspace(depths[0], depths[-1], _N_STEPS)
    logs = np.log(np.maximum(noncentral, np.finfo(float).tiny)).T
    between = np.exp(np.stack([np.interp(np.log(fine), np.log(depths), one) for one in logs], axis=1))
    enough = np.flatnonzero(right_decisions(between, degrees).mean(axis=1) >= confidence)
    return float(fine[enough[0]]) if enough.size else None


class _Twins:
    """The same assemblies with any wear, without noise."""

    def __init__(
        self,
        rig: str | Rig,
        speed_rpm: float | None,
        load_nm: float | None,
        turns: int,
        n: int,
        random_state: int,
        n_jobs: int,
    ) -> None:
        from cyclofeat.datasets import rig_preset
        from cyclofeat.simulators import Noise, Solver

        drawn = rig_preset(rig) if isinstance(rig, str) else rig
        self.rig, gearbox = drawn.name, drawn.gearbox
        nominal = round(60 * gearbox.input_speed_hz, 6)
        self.speed_rpm = nominal if speed_rpm is None else positive("speed_rpm", speed_rpm)
        self.load_nm = gearbox.load_torque if load_nm is None else positive("load_nm", load_nm)
        self.n_lobes, self.turns, self.n = gearbox.n_lobes, turns, n
        self.seconds = turns * self.n_lobes / (self.speed_rpm / 60)
        self._options: dict[str, Any] = {
            "rig": drawn.with_effects(Noise(0.0)), "speed_rpm": self.speed_rpm, "load_nm": self.load_nm,
            "output_turns": _MARGIN * turns, "wheels": (0, 1), "with_angle": True, "n_jobs": n_jobs,
            "random_state": random_state,
            "kernel": "auto", "solver": Solver(integrator="adams_bashforth"),
        }  # fmt: skip

    def lines(self, worn: int, depth_um: float) -> Complex:
        """Return the lobe lines in Nm above the brake's drift, shape (n_assemblies, n_lines)."""
        from cyclofeat.datasets import make_rig_recordings

        recordings = make_rig_recordings(self.n, [worn], wear_um=depth_um, **self._options)
        windows = lobe_windower(self.n_lobes).windows(recordings)
        runs = [runs_of(windows.X[windows.recording == k], self.turns)[:1] for k in range(self.n)]
        lines: Complex = lobe_lines_nm(np.concatenate(runs), self.n_lobes).lines
        return lines[:, _LOWEST_LINE - 1 :]
