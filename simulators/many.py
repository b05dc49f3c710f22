"""Many runs at once, on several cores."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any, Literal, overload

import joblib
import numpy as np

from cyclofeat.simulators._checks import is_whole, members, number, short, whole
from cyclofeat.simulators._parallel import stopped_quietly
from cyclofeat.simulators.gearbox import CycloidalGearbox, LobeDefects
from cyclofeat.simulators.simulation import SimulationFailed, SimulationRun, simulate
from cyclofeat.simulators.tolerances import AssemblyTolerances


@overload
def simulate_many(
    gearboxes: CycloidalGearbox | Iterable[CycloidalGearbox] | None = ...,
    defects: LobeDefects | Iterable[LobeDefects] | None = ...,
    *,
    n_runs: int | None = ...,
    tolerances: AssemblyTolerances | None = ...,
    random_state: int | None = ...,
    start_angles: Sequence[float] | None = ...,
    on_failure: Literal["raise"] = ...,
    n_jobs: int = ...,
    prefer: str = ...,
    progress: Callable[[int, int], None] | None = ...,
    **options: Any,
) -> list[SimulationRun]: ...


@overload
def simulate_many(
    gearboxes: CycloidalGearbox | Iterable[CycloidalGearbox] | None = ...,
    defects: LobeDefects | Iterable[LobeDefects] | None = ...,
    *,
    n_runs: int | None = ...,
    tolerances: AssemblyTolerances | None = ...,
    random_state: int | None = ...,
    start_angles: Sequence[float] | None = ...,
    on_failure: Literal["return"],
    n_jobs: int = ...,
    prefer: str = ...,
    progress: Callable[[int, int], None] | None = ...,
    **options: Any,
) -> list[SimulationRun | SimulationFailed]: ...


def simulate_many(
    gearboxes: CycloidalGearbox | Iterable[CycloidalGearbox] | None = None,
    defects: LobeDefects | Iterable[LobeDefects] | None = None,
    *,
    n_runs: int | None = None,
    tolerances: AssemblyTolerances | None = None,
    random_state: int | None = None,
    start_angles: Sequence[float] | None = None,
    on_failure: str = "raise",
    n_jobs: int = 1,
    prefer: str = "threads",
    progress: Callable[[int, int], None] | None = None,
    **options: Any,
) -> list[SimulationRun] | list[SimulationRun | SimulationFailed]:
    """Simulate many gearboxes, each as :func:`simulate` would.

    Parameters
    ----------
    gearboxes : CycloidalGearbox or iterable of CycloidalGearbox, default ``CycloidalGearbox.steel()``
    defects : LobeDefects or iterable of LobeDefects, default healthy
        One for all runs, or one for each.
    n_runs : int, optional
        Number of runs where neither gearboxes nor defects nor start angles are given one by one.
    tolerances : AssemblyTolerances, optional
        Tolerances from which the errors of every run's assembly are drawn, independently.
    random_state : int, optional
        Seed of those draws; must be given with ``tolerances``. The seed of a run follows from it and from the
        run's place in the list alone, so that neither the number of workers nor more runs change it. No two
        runs of one ``random_state`` have the same; two of different ones have it with a chance of 2**-32.
    start_angles : sequence of float, optional
        Input angle at t = 0 of each run, in rad.
    on_failure : {"raise", "return"}
        Whether the first run that diverges or locks ends everything, or its exception takes the run's place
        in the list.
    n_jobs : int
        Number of workers; -1 for all processors.
    prefer : {"threads", "processes"}
        Kind of the workers. Threads share memory and the compiled kernel, which runs without Python's lock;
        processes pay for a start and for copying every result.
    progress : callable, optional
        Called after each run with the number done and their total.
    **options
        Further arguments of :func:`simulate`, the same for all runs.

    Returns
    -------
    list of SimulationRun
        In the order of the arguments; with ``on_failure="return"`` a SimulationFailed (SimulationDiverged or
        GearboxLocked) in the place of a run that failed.

    Raises
    ------
    SimulationFailed
        With ``on_failure="raise"``; a note tells which run.
    ValueError
        If the arguments do not fit together.

    Examples
    --------
    >>> runs = simulate_many(defects=[LobeDefects.worn(n) for n in range(3)], duration=0.05, n_jobs=2)
    >>> [run.defects.defect_count for run in runs]
    [0, 1, 2]
    """
    if on_failure not in ("raise", "return"):
        raise ValueError(f"on_failure must be 'raise' or 'return', got {on_failure!r}")
    if prefer not in ("threads", "processes"):
        raise ValueError(f"prefer must be 'threads' or 'processes', got {prefer!r}")
    if not is_whole(n_jobs) or n_jobs == 0:
        raise ValueError(f"n_jobs must be a whole number of workers, or -1 for all, got {n_jobs!r}")
    if tolerances is not None and random_state is None:
        raise ValueError(
            "random_state must be given with tolerances, so that the assemblies can be made again"
        )
    if random_state is not None:
        whole("random_state", random_state, 0, None)
    for name in ("seed", "start_angle"):
        if name in options:
            other = "random_state" if name == "seed" else "start_angles"
            raise ValueError(f"{name} is one run's; give {other} for many")
    each: dict[str, list[Any]] = {}
    for name, values, one in (
        ("gearboxes", gearboxes, CycloidalGearbox),
        ("defects", defects, LobeDefects),
        ("start_angles", start_angles, None),
    ):
        if values is None or (one is not None and isinstance(values, one)):
            continue
        given = None if isinstance(values, str) else members(values)
        if given is None:
            what = "numbers of rad" if one is None else f"a {one.__name__} or several"
            raise TypeError(f"{name} must be {what}, one for each run, got {short(values)}")
        each[name] = list(given)
    lengths = {name: len(values) for name, values in each.items()}
    if n_runs is not None:
        if not is_whole(n_runs) or n_runs < 0:
            raise ValueError(f"n_runs must be a number of runs from 0, got {n_runs!r}")
        lengths["n_runs"] = int(n_runs)
    if len(set(lengths.values())) > 1:
        told = ", ".join(f"{name} {length}" for name, length in lengths.items())
        raise ValueError(f"gearboxes, defects, start_angles and n_runs must agree in number, got {told}")
    total = next(iter(lengths.values()), 1)

    if "start_angles" in each:
        each["start_angles"] = [number("start_angles", one, "numbers of rad") for one in each["start_angles"]]

    def arguments(index: int) -> dict[str, Any]:
        return {
            "gearbox": each["gearboxes"][index] if "gearboxes" in each else gearboxes,
            "defects": each["defects"][index] if "defects" in each else defects,
            "start_angle": each["start_angles"][index] if "start_angles" in each else 0.0,
            "tolerances": tolerances,
            "seed": None if random_state is None else _seed_of(random_state, index),
        }

    workers = joblib.Parallel(n_jobs=n_jobs, prefer=prefer, return_as="generator")
    results: list[Any] = []
    made = workers(joblib.delayed(_attempt)(arguments(index), options) for index in range(total))
    with stopped_quietly(made):
        for found in made:
            if isinstance(found, Exception) and on_failure == "raise":
                found.add_note(f"in run {len(results)} of {total} (counted from 0)")
                raise found
            results.append(found)
            if progress is not None:
                progress(len(results), total)
    return results


def _seed_of(random_state: int, index: int) -> int:
    """Seed of one run: 32 bits, and yet no two of one ``random_state`` are equal.

    SeedSequence mixes a key of one word into the first word that it gives by steps that can all be undone.
    """
    return int(np.random.SeedSequence(random_state, spawn_key=(index,)).generate_state(1)[0])


def _attempt(arguments: dict[str, Any], options: dict[str, Any]) -> SimulationRun | SimulationFailed:
    try:
        return simulate(**arguments, **options)
    except SimulationFailed as failure:
        return failure
