"""Planning of measurements from simulated assemblies: how long to record, or which depth of wear shows."""

from __future__ import annotations

import csv
import functools
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files
from typing import TYPE_CHECKING, Any, get_type_hints

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2, ncx2

from cyclofeat._base.checks import number, positive, seed_number, whole
from cyclofeat._base.quantities import number_of, rig_in_words
from cyclofeat.counting.model.radial_wear import lobe_lines_nm, runs_of
from cyclofeat.recordings.windower import lobe_windower
from cyclofeat.signal.windows import Complex, Float

if TYPE_CHECKING:  # the simulator loads numba: only those who simulate wait for it
    from cyclofeat.simulators import Rig

# Rig, speed and load of the table.
_TABLE_RIG, _TABLE_RPM, _TABLE_NM, _TABLE_LOBES = "R1", 500.0, 22.0, 15
# The brake drifts below.
_LOWEST_LINE = 3
# Mean power of white noise in a line read with a Hann window, in units of its variance per sample.
_NOISE_IN_LINE = 6.0
_NOISE_HZ = 25_600.0  # sampling rate for which noise is stated
# Recordings are a little longer than the windows, as speeds differ by a per cent.
_MARGIN = 1.01
_N_STEPS = 121
# Attributes that only one kind of plan has.
_OF_SIMULATION = ("rig", "speed_rpm", "load_nm", "depths_um", "least_um")
_OF_TABLE = ("depth", "tabulated_noise_nm", "tabulated_depth", "largest_noise_nm", "reachable",
             "longest_turns", "longest_seconds")  # fmt: skip


@dataclass(frozen=True)
class Trial:
    """Simulated assemblies with ``worn`` lobes or one more, of which ``right`` were identified correctly."""

    rig: str
    depth: float  # share of the lobe's width
    noise_nm: float  # standard deviation of the white noise
    turns: int  # output turns recorded
    worn: int
    assemblies: int
    right: float  # an assembly counts in part if some of its recordings are right

    @property
    def probability(self) -> float:
        """Probability of the right answer for the next assembly, by Laplace's rule of succession."""
        return (self.right + 1) / (self.assemblies + 2)


def _format_length(turns: Any, seconds: Any) -> str:
    return f"{number_of(turns, 'output turn')} ({seconds:.3g} s)"


@dataclass(frozen=True, kw_only=True)
class MeasurementPlan:
    """Answer of :func:`plan_measurement`.

    Attributes
    ----------
    worn : int
        n, to be distinguished from n + 1, or with ``depths_um`` from 0.
    confidence, noise_nm : float
        Requested values.
    rig : str
    speed_rpm, load_nm : float
        Nominal input speed and load.
    turns, seconds : int, float or None
        Length of the recording in output turns, and in s: the shortest that is enough, or with ``depths_um``
        the requested one; None where the table's longest is not enough.
    probability : float or tuple of float
        Probability of the right answer with ``turns``, or the table's longest; at each of ``depths_um``.
    assemblies : int
        Simulated assemblies on which that stands.
    depths_um : tuple of float or None
        Simulated depths of radial wear; None for a plan from the table.
    least_um : float or None
        Least depth at which the probability reaches the confidence, interpolated; None where the deepest is
        not enough, the shallowest where that is enough.
    depth, tabulated_noise_nm, tabulated_depth : float or None
        Requested depth of the chord, and the entry of the table that answers: the next worse one.
    largest_noise_nm : float or None
        Largest noise of the table at which the longest recording is enough at this depth; None if at none.
    reachable : float
        Largest confidence that as many assemblies could show, all identified correctly; 1 with
        ``depths_um``.
    longest_turns, longest_seconds : int, float or None
        The table's longest recording in output turns, and in s.
    """

    worn: int
    confidence: float
    noise_nm: float
    rig: str
    speed_rpm: float
    load_nm: float
    turns: int | None
    seconds: float | None
    probability: float | tuple[float, ...]
    assemblies: int
    depths_um: tuple[float, ...] | None = None
    least_um: float | None = None
    depth: float | None = None
    tabulated_noise_nm: float | None = None
    tabulated_depth: float | None = None
    largest_noise_nm: float | None = None
    reachable: float = 1.0
    longest_turns: int | None = None
    longest_seconds: float | None = None

    def __str__(self) -> str:
        """Return the answer as ``cyclofeat plan`` prints it."""
        if self.depths_um is None:
            return self._table_text()
        assert isinstance(self.probability, tuple)
        shows = f"no depth up to {self.depths_um[-1]:g} um shows"
        if self.least_um is not None:
            up_to = "or less " if self.least_um == self.depths_um[0] else ""
            shows = f"radial wear shows from {self.least_um:.3g} um {up_to}on"
        pairs = zip(self.depths_um, self.probability, strict=True)
        shares = ", ".join(f"{depth:g} um: {share:.2f}" for depth, share in pairs)
        at = f"{self.noise_nm:g} Nm noise, {self.speed_rpm:g} RPM, {self.load_nm:g} Nm"
        return (
            f"{shows} with {self.confidence:g}, {number_of(self.worn, 'worn lobe')} or none: {at}, "
            f"{_format_length(self.turns, self.seconds)}\n"
            f"  probability of telling worn from healthy: {shares}\n"
            f"  by the lobe lines of {self.assemblies} simulated assemblies of {rig_in_words(self.rig)}, "
            "healthy and worn\n  note: an ideal detector trained for this rig; counting the lobes takes "
            "deeper wear"
        )

    def _table_text(self) -> str:
        counts = f"{self.worn} from {self.worn + 1} worn lobes"
        lines = [f"to tell {counts} at {self.noise_nm:g} Nm noise, depth {self.depth:g}: "]
        if self.turns is not None:
            lines[0] += f"record {_format_length(self.turns, self.seconds)}"
        elif self.confidence > self.reachable:
            lines[0] += (
                f"cannot be promised with {self.confidence:g}; {self.assemblies} simulated assemblies can "
                f"show {self.reachable:.3f} at most"
            )
        else:
            longest = _format_length(self.longest_turns, self.longest_seconds)
            lines[0] += f"the table's longest recording, {longest}, is not enough for {self.confidence:g}"
            if self.largest_noise_nm is not None:
                lines.append(f"  it is enough at {self.largest_noise_nm:g} Nm noise or less")
        on = f"{self.assemblies} simulated assemblies of rig R1"
        lines.append(f"  probability {self.probability:.3f} on {on}")
        if (self.tabulated_noise_nm, self.tabulated_depth) != (self.noise_nm, self.depth):
            entry = f"noise {self.tabulated_noise_nm:g} Nm, depth {self.tabulated_depth:g}"
            lines.append(f"  answered by the table's next worse entry: {entry}")
        lines.append("  note: simulated, on an assumed rig that the counter was trained for; no measurement")
        return "\n".join(lines)

    def to_dict(self) -> dict[str, Any]:
        """Return the plan in plain types, for JSON.

        Returns
        -------
        dict
            Without the attributes that only the other kind of plan has.
        """
        others = _OF_SIMULATION if self.depths_um is None else _OF_TABLE
        return {name: value for name, value in vars(self).items() if name not in others}


@functools.cache
def detection_table() -> tuple[Trial, ...]:
    """Return the trials that plans are made from, written by ``make bench-counting``."""
    text = files("cyclofeat.counting").joinpath("tables/detection.csv").read_text(encoding="utf-8")
    kinds = get_type_hints(Trial)
    rows = csv.DictReader(text.splitlines())
    return tuple(Trial(**{name: kinds[name](value) for name, value in row.items()}) for row in rows)


def plan_measurement(
    worn: int,
    *,
    noise_nm: float,
    confidence: float = 0.95,
    depth: float = 1.0,
    depths_um: Sequence[float] | None = None,
    rig: str | Rig = "R1",
    speed_rpm: float | None = None,
    load_nm: float | None = None,
    output_turns: int = 5,
    n_assemblies: int = 8,
    random_state: int | None = None,
    n_jobs: int = 1,
) -> MeasurementPlan:
    """Plan how long to record to tell ``worn`` lobes from one more, or which radial wear shows.

    Parameters
    ----------
    worn : int
        n, from 0 to 6; with ``depths_um`` neighbouring worn lobes on both wheels, at least 1.
    noise_nm : float
        Standard deviation of the torque meter's white noise at 25.6 kHz, in Nm.
    confidence : float
        Wanted probability of the right answer, above 0.5 and below 1.
    depth : float
        Depth of the wear, as a share of the lobe's width (1: the papers' worn lobe). It has no effect with
        ``depths_um``.
    depths_um : sequence of float, optional
        Depths of radial wear in um, increasing, up to 200, of which each is told from none: a short
        simulation answers, with ``rig``, ``load_nm``, ``output_turns``, ``n_assemblies``, ``random_state``
        and ``n_jobs``. Default: a table of trials answers, how many output turns to record.
    rig : str or Rig
        See :func:`cyclofeat.datasets.make_rig_recordings`. The table is of R1.
    speed_rpm, load_nm : float, optional
        Nominal input speed in RPM and load in Nm. Default: those of the rig's gearbox. The table is of 500
        RPM and 22 Nm; another speed is taken to need as many turns.
    output_turns : int
        Length of the simulated recordings.
    n_assemblies : int
        Assemblies to simulate, healthy and at each depth, at least 2.
    random_state : int, optional
        Seed of the simulation. Default: another one each time.
    n_jobs : int
        Threads of the simulation.

    Returns
    -------
    MeasurementPlan

    Raises
    ------
    TypeError, ValueError
        If an argument is of the wrong type, outside its range or outside the table; the message names it.

    Notes
    -----
    *Table.* Of rig R1 (an assumption: brake rotor 0.02 kg m2 behind 10 kNm/rad, 3 Nm rms drift below 1.5 Hz),
    neighbouring worn lobes, a counter trained on the same rig at the same noise: see ``docs/counting.md``.

    *Simulation.* The same assemblies are simulated healthy and worn, without noise. Let h_k be the mean power
    of lobe line k over the healthy ones, d_k the change of its amplitude by the wear, and w = 6 noise_nm^2 /
    n the mean power of the noise in a line of n samples (Hann window). The detector adds the powers of the K
    lines from the third on, each divided by v_k = h_k + w. Twice the sum is chi-squared with 2 K degrees of
    freedom for a healthy disc, and noncentral by 2 sum |d_k|^2 / v_k for a worn one, where errors of assembly
    are as random as noise. The answer is the share of right decisions at the best threshold, healthy and worn
    equally frequent, averaged over assemblies. It says where wear is seen. A count of lobes needs deeper
    wear, as does a rig that the training did not contain.

    Examples
    --------
    >>> plan = plan_measurement(3, noise_nm=0.5, confidence=0.9)
    >>> plan.turns, round(plan.seconds, 3)
    (1, 1.8)
    >>> plan = plan_measurement(
    ...     2, noise_nm=0.2, depths_um=(10, 100), output_turns=1, n_assemblies=2, random_state=0
    ... )
    >>> plan.probability[0] < plan.probability[1]
    True
    """
    positive("noise_nm", noise_nm)
    if not 0.5 < number("confidence", confidence) < 1:
        raise ValueError(f"confidence must lie above 0.5 (guessing) and below 1, got {confidence!r}")
    if depths_um is None:
        speed = _TABLE_RPM if speed_rpm is None else positive("speed_rpm", speed_rpm)
        return plan_turns(detection_table(), whole("worn", worn), noise_nm, confidence, depth, speed)
    whole("worn", worn, 1)
    whole("output_turns", output_turns, 1)
    whole("n_assemblies", n_assemblies, 2)
    depths = [positive("depths_um", depth) for depth in depths_um]
    if len(depths) < 2 or depths != sorted(set(depths)):
        raise ValueError(f"depths_um must be at least two increasing depths, got {depths_um!r}")
    from cyclofeat.datasets import rig_preset

    drawn = rig_preset(rig) if isinstance(rig, str) else rig
    gearbox = drawn.gearbox
    speed = round(60 * gearbox.input_speed_hz, 6) if speed_rpm is None else positive("speed_rpm", speed_rpm)
    load = gearbox.load_torque if load_nm is None else positive("load_nm", load_nm)
    seconds = output_turns * gearbox.n_lobes / (speed / 60)
    options = {
        "speed_rpm": speed, "load_nm": load, "n_assemblies": n_assemblies, "n_jobs": n_jobs,
        "random_state": seed_number(random_state),
    }  # fmt: skip
    healthy, *others = (
        lines_of_twins(drawn, output_turns, n_worn, depth, **options)
        for n_worn, depth in [(0, depths[0]), *((worn, depth) for depth in depths)]
    )
    power = (np.abs(healthy) ** 2).mean(axis=0) + _NOISE_IN_LINE * noise_nm**2 / (seconds * _NOISE_HZ)
    noncentral = np.array([2 * (np.abs(lines - healthy) ** 2 / power).sum(axis=1) for lines in others])
    degrees = 2 * healthy.shape[1]
    # The least depth that is enough, interpolated.
    fine = np.geomspace(depths[0], depths[-1], _N_STEPS)
    logs = np.log(np.maximum(noncentral, np.finfo(float).tiny)).T
    between = np.exp(np.stack([np.interp(np.log(fine), np.log(depths), row) for row in logs], axis=1))
    enough = np.flatnonzero(right_decisions(between, degrees).mean(axis=1) >= confidence)
    return MeasurementPlan(
        worn=worn, confidence=float(confidence), noise_nm=float(noise_nm), rig=drawn.name, speed_rpm=speed,
        load_nm=load, turns=output_turns, seconds=round(seconds, 9), depths_um=tuple(depths),
        probability=tuple(right_decisions(noncentral, degrees).mean(axis=1).tolist()),
        least_um=float(fine[enough[0]]) if enough.size else None, assemblies=n_assemblies,
    )  # fmt: skip


def plan_turns(
    table: Sequence[Trial], worn: int, noise_nm: float, confidence: float, depth: float, speed_rpm: float
) -> MeasurementPlan:
    """Return the plan of a table of trials; arguments as in :func:`plan_measurement`."""
    most = max(trial.worn for trial in table)
    if not 0 <= worn <= most:
        raise ValueError(f"worn must lie between 0 and {most}, the table's largest n, got {worn!r}")
    trials = [trial for trial in table if trial.worn == worn]
    positive("depth", depth)
    noises, depths = sorted({t.noise_nm for t in trials}), sorted({t.depth for t in trials})
    if noise_nm > noises[-1]:
        raise ValueError(f"noise_nm must be at most {noises[-1]:g}, the table's largest, got {noise_nm!r}")
    if not depths[0] <= depth <= 1:
        raise ValueError(f"depth must lie between {depths[0]:g}, the table's least, and 1, got {depth!r}")
    noise = next(value for value in noises if value >= noise_nm)
    shallow = max(value for value in depths if value <= depth)
    at_depth = [trial for trial in trials if trial.depth == shallow]
    chosen = sorted((t for t in at_depth if t.noise_nm == noise), key=lambda trial: trial.turns)
    enough = next((trial for trial in chosen if trial.probability >= confidence), None)
    answer = chosen[-1] if enough is None else enough
    longest = max(trial.turns for trial in at_depth)
    fine = [t.noise_nm for t in at_depth if t.turns == longest and t.probability >= confidence]

    def seconds(turns: int) -> float:
        # Rounded, because the speed in turns per second is not a round number.
        return round(turns * _TABLE_LOBES / (speed_rpm / 60), 9)

    return MeasurementPlan(
        worn=worn, confidence=float(confidence), noise_nm=float(noise_nm), rig=_TABLE_RIG,
        speed_rpm=float(speed_rpm), load_nm=_TABLE_NM, depth=float(depth), tabulated_noise_nm=noise,
        tabulated_depth=shallow, turns=None if enough is None else enough.turns,
        seconds=None if enough is None else seconds(enough.turns), probability=answer.probability,
        assemblies=answer.assemblies, largest_noise_nm=max(fine, default=None),
        reachable=(answer.assemblies + 1) / (answer.assemblies + 2), longest_turns=longest,
        longest_seconds=seconds(longest),
    )  # fmt: skip


def right_decisions(noncentral: NDArray[Any], degrees: int) -> Float:
    """Return the share of right decisions between chi-squared and noncentral numbers, 0.5 (guessing) to 1.

    At the best threshold, both equally frequent, for each noncentrality.
    """
    largest = max(float(np.max(noncentral)), 1.0)
    table = np.concatenate([[0.0], np.geomspace(min(0.1, largest / 2), largest, 60)])
    threshold = chi2.ppf(np.linspace(0.02, 1 - 1e-6, 200), degrees)
    # Thresholds far above what a healthy disc reaches are of no use.
    missed = ncx2.cdf(threshold, degrees, table[1:, np.newaxis])
    right = np.concatenate([[0.5], ((chi2.cdf(threshold, degrees) + 1 - missed) / 2).max(axis=1)])
    return np.asarray(np.interp(noncentral, table, right))


def lines_of_twins(rig: Rig, turns: int, worn: int, depth_um: float, **options: Any) -> Complex:
    """Return lobe lines in Nm above the brake's drift, shape (n_assemblies, n_lines), without noise.

    The same ``options`` of :func:`cyclofeat.datasets.make_rig_recordings` make the same assemblies, with any
    wear.
    """
    from cyclofeat.datasets import make_rig_recordings
    from cyclofeat.simulators import Noise, Solver

    n_lobes = rig.gearbox.n_lobes
    recordings = make_rig_recordings(
        defect_counts=[worn], wear_um=depth_um, rig=rig.with_effects(Noise(0.0)), wheels=(0, 1),
        output_turns=_MARGIN * turns, with_angle=True, kernel="auto",
        solver=Solver(integrator="adams_bashforth"), **options,
    )  # fmt: skip
    windows = lobe_windower(n_lobes).windows(recordings)
    runs = [runs_of(windows.X[windows.recording == k], turns)[:1] for k in range(len(recordings))]
    lines: Complex = lobe_lines_nm(np.concatenate(runs), n_lobes).lines
    return lines[:, _LOWEST_LINE - 1 :]
