"""Comparison of this generator with :mod:`cyclofeat.simulators` without an effect."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.signal import welch

from benchmarks._markdown import table
from benchmarks.hidden_effects._effects import nuisance_and_seed, record, run_machine
from benchmarks.hidden_effects._folders import n_samples
from benchmarks.hidden_effects._machine import SAMPLING_RATE, Machine, run
from benchmarks.hidden_effects._sets import FIT, SEED, STANDARD, Planned
from benchmarks.hidden_effects._visible import simulated_cells
from cyclofeat.gap import Comparison
from cyclofeat.gap.comparison import measured_turns
from cyclofeat.gap.simulations import MAY_DIFFER
from cyclofeat.gap.summaries.summarise import Kinematics
from cyclofeat.gap.summaries.turns import class_means, less_class_means
from cyclofeat.gap.where.locate import locate
from cyclofeat.gap.where.permutation import family_p
from cyclofeat.gap.world.cells import recording_cells
from cyclofeat.gap.world.world import NOISE_AND_DRIFT
from cyclofeat.simulators import CycloidalGearbox, LobeDefects, Solver, simulate

Float = NDArray[np.float64]

INPUT_HZ = 500 / 60
COUNTS = (0, 2, 4, 6)
_N_PERMUTATIONS = 499
_BANDS = ((50, 500), (500, 2000), (2000, 4000), (4000, 8000))


class Condition(NamedTuple):
    """Inputs of both simulators."""

    name: str
    lobes: tuple[int, ...] = ()
    wheels: tuple[int, ...] = (0, 1)
    pin_rms: float = 0.0
    changes: tuple[tuple[str, Any], ...] = ()  # of this generator's machine
    gearbox: tuple[tuple[str, Any], ...] = ()  # of the simulator's gearbox


_OFF = np.random.default_rng(8).normal(size=(3, 30)) * 1e-5
_ERRORS = _OFF[0, :2] + 1j * _OFF[0, 2:4]
CONDITIONS = (
    Condition("healthy"),
    Condition("healthy, pins displaced", pin_rms=5e-6),
    Condition("one worn lobe, one wheel", (4,), (0,)),
    Condition("six worn lobes, both wheels, pins displaced", (10, 11, 12, 13, 14, 0), pin_rms=5e-6),
    Condition("clearance", (1, 2), (0,), 5e-6, (("clearance", 5e-5),), (("clearance", 5e-5),)),
    Condition("run-out", (1,), (0,), 0.0, (("runouts", 2 * _ERRORS),), (("wheel_runouts", 2 * _ERRORS),)),
    Condition("cams", (1,), (0,), 5e-6, (("cams", 2 * _ERRORS),), (("cam_errors", 2 * _ERRORS),)),
    Condition(
        "pitch errors", (3, 4), (0, 1), 5e-6,
        (("pitch", _OFF[1].reshape(2, 15) / 64e-3),), (("lobe_pitch_errors", _OFF[1]),),
    ),
    Condition(
        "sleeve friction", (3, 4), (0,), 5e-6,
        (("sleeve_friction", 0.1),), (("sleeve_friction", 0.1), ("sleeve_static_friction", 0.1)),
    ),
    Condition("bearing friction", (3,), (0,), 5e-6, (("bearing", 1.0),), (("output_bearing_torque", 1.0),)),
    Condition(
        "brake's rotor", (3, 4), (0,), 5e-6, (("rotor", (0.02, 1e4, 0.05)),),
        (("brake_inertia", 0.02), ("meter_stiffness", 1e4), ("meter_damping", 0.1 * np.sqrt(200.0))),
    ),
)  # fmt: skip


def both(condition: Condition, duration: float = 1.2, dt: float = 1e-5) -> tuple[Float, Float]:
    """Settled torque of the same run in this generator and in the simulator."""
    n_pins = 16
    errors = condition.pin_rms * np.random.default_rng(3).normal(size=(2, n_pins))
    worn = np.zeros((2, 15), dtype=np.int64)
    for wheel in condition.wheels:
        worn[wheel, list(condition.lobes)] = 1
    machine = Machine(worn=worn, pins=errors[0] + 1j * errors[1]).with_(**dict(condition.changes))
    n = round(duration * SAMPLING_RATE)
    here, _, _ = run(machine, n, start_angle=2.1)
    gearbox = CycloidalGearbox.steel(
        pin_radial_errors=errors[0], pin_tangential_errors=errors[1], **dict(condition.gearbox)
    )
    defects = LobeDefects.worn(condition.lobes, wheels=condition.wheels)
    there = simulate(
        gearbox, defects, duration=duration, start_angle=2.1, solver=Solver(dt=dt), motion=False
    ).torque_out
    settled = n // 3
    return here[settled:], there[settled:]


def level(torque: Float, low: float, high: float) -> float:
    """Power between two frequencies in dB of Nm^2."""
    frequencies, psd = welch(torque, SAMPLING_RATE, nperseg=8192)
    inside = (frequencies >= low) & (frequencies < high)
    return float(10 * np.log10(psd[inside].sum() * frequencies[1]))


def distributions(n: int) -> tuple[Float, Float, list[Any], NDArray[np.int64]]:
    """Summaries of ``n`` recordings from both without an effect, cells, and counts of worn lobes."""
    planned = [Planned(FIT, i, STANDARD, COUNTS[i % len(COUNTS)]) for i in range(n)]
    own = np.array([_recorded(one, (10**6, one.number)) for one in planned])
    here, cells = recording_cells(own, Kinematics(SAMPLING_RATE, INPUT_HZ))
    there = simulated_cells((), planned, 5)[""]
    return here, there, cells, np.array([one.count for one in planned])


def _recorded(planned: Planned, key: tuple[int, ...]) -> NDArray[np.float32]:
    """A recording without an effect."""
    nuisance, seed = nuisance_and_seed([SEED, *key])
    n = n_samples(planned.condition.speed_rpm)
    made = run_machine(planned.count, planned.condition, (), seed, nuisance, n)
    return record(made, (), np.random.SeedSequence([SEED, *key, 1]), n)


def standardised(here: Float, there: Float, counts: NDArray[Any]) -> Float:
    """Difference of the means over its standard error, by cell, with the counts' effect removed."""
    means = class_means(there, counts)
    a, b = (less_class_means(values, counts, means) for values in (here, there))
    return np.asarray((a - b).mean(axis=0) / np.sqrt((a.var(axis=0) + b.var(axis=0)) / len(a) + 1e-18))


def report(n: int = 80, nulls: int = 30) -> str:
    """Waveforms, distributions of the summaries, and the locator's verdicts on sets without an effect."""
    lines = ["# This generator and cyclofeat.simulators without hidden effects", "", "## The same run", ""]
    steps = (1e-5, 2.5e-6)
    lines += [
        "Same gearbox, errors and start angle, 0.4 to 1.2 s. Rms of the difference over the rms of the "
        "ripple, and difference of the levels (dB) by band, at two time steps of the simulator (this "
        "generator's stays 1/102400 s).",
        "",
    ]
    head, rows = ["case", "std, Nm"], []
    for dt in steps:
        head += [f"dt {dt:g}: rms", *(f"{low}-{high} Hz" for low, high in _BANDS)]
    for condition in CONDITIONS:
        row = [condition.name, ""]
        for dt in steps:
            here, there = both(condition, dt=dt)
            row.append(f"{np.std(here - there) / np.std(there):.4f}")
            row += [f"{level(here, *band) - level(there, *band):+.2f}" for band in _BANDS]
        row[1] = f"{np.std(here):.4f}"
        rows.append(row)
    lines.append(table(head, rows))
    here, there, cells, counts = distributions(n)
    z = standardised(here, there, counts)
    lines += ["## Summaries under the nuisance prior", ""]
    lines += [
        f"{n} recordings of each, {len(cells)} cells: difference of the means over its standard error has an "
        f"rms of {np.sqrt(np.mean(z**2)):.2f} (1 if both are the same); {np.sum(np.abs(z) > 3)} of "
        f"{len(z)} beyond 3. The largest:",
        "",
    ]
    rows = []
    for k in np.argsort(-np.abs(z))[:8]:
        difference = here[:, k].mean() - there[:, k].mean()
        spread = np.sqrt(np.mean([there[counts == c, k].var() for c in np.unique(counts)]))
        cell = cells[k]
        name, step = f"{cell.family}: {cell.name}", f"{difference:.3g} {cell.unit}"
        rows.append([name, step, f"{spread:.3g}", f"{z[k]:.1f}"])
    lines.append(table(("cell", "difference", "spread of one recording", "z"), rows))
    if nulls:
        lines += ["## The locator on sets of 8 without an effect", ""]
        alarms, verdict = false_alarms(nulls)
        lines.append(
            f'{alarms} of {nulls} say "disagree" at alpha 0.05 (bank of 200; the first one\'s verdict by '
            f"locate itself: {verdict})."
        )
    return "\n".join(lines)


def false_alarms(n: int) -> tuple[int, str]:
    """Number of ``n`` sets without an effect with the verdict "disagree", and the first verdict."""
    counts = COUNTS * 2
    planned = [Planned(FIT, i, STANDARD, counts[i % 8]) for i in range(8 * n)]
    X = np.array([_recorded(one, (10**6 + 1, one.number)) for one in planned])
    comparison = Comparison(sampling_rate=SAMPLING_RATE, may_differ=(*MAY_DIFFER, *NOISE_AND_DRIFT))
    sets = [measured_turns(comparison, X[8 * k : 8 * k + 8], y=counts) for k in range(n)]
    located = locate(comparison, sets[0], n_permutations=_N_PERMUTATIONS)
    # All sets use one bank: they are compared as in locate, without a new bank for each.
    means = class_means(located.simulated, located.bank.counts)
    simulated = less_class_means(located.simulated, located.bank.counts, means)
    random = np.random.default_rng(0)
    alarms = 0
    for one in sets:
        measured = less_class_means(one.values, one.counts_or_zeros, means)
        p = family_p(measured, simulated, one.cells, _N_PERMUTATIONS, random)
        alarms += min(p.values()) <= located.where.alpha
    return alarms, located.where.verdict
