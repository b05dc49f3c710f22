"""Many runs at once, on several cores."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any, Literal, overload

import joblib

from cyclofeat._base.checks import members, number, one_of, short
from cyclofeat._base.checks import n_jobs as check_n_jobs
from cyclofeat._base.parallel import stopped_quietly
from cyclofeat.simulators.gearbox import CycloidalGearbox, LobeDefects
from cyclofeat.simulators.simulation import SimulationFailed, SimulationRun, simulate

__all__ = ["simulate_many"]

_Gearboxes = CycloidalGearbox | Iterable[CycloidalGearbox] | None
_Defects = LobeDefects | Iterable[LobeDefects] | None


@overload
def simulate_many(
    gearboxes: _Gearboxes = ...,
    defects: _Defects = ...,
    *,
    on_failure: Literal["raise"] = ...,
    **options: Any,
) -> list[SimulationRun]: ...


@overload
def simulate_many(
    gearboxes: _Gearboxes = ..., defects: _Defects = ..., *, on_failure: Literal["return"], **options: Any
) -> list[SimulationRun | SimulationFailed]: ...


def simulate_many(
    gearboxes: _Gearboxes = None,
    defects: _Defects = None,
    *,
    start_angles: Sequence[float] | None = None,
    on_failure: str = "raise",
    n_jobs: int = 1,
    progress: Callable[[int, int], None] | None = None,
    **options: Any,
) -> list[SimulationRun] | list[SimulationRun | SimulationFailed]:
    """Simulate many gearboxes, each as :func:`simulate` would.

    Parameters
    ----------
    gearboxes : CycloidalGearbox or iterable of CycloidalGearbox, default ``CycloidalGearbox.steel()``
    defects : LobeDefects or iterable of LobeDefects, default healthy
        One for all runs, or one for each.
    start_angles : sequence of float, optional
        Input angle at t = 0 of each run, in rad.
    on_failure : {"raise", "return"}
        Raise the exception of the first run that diverges or locks, or return each in its run's place.
    n_jobs : int
        Number of threads; -1 for all processors. ``joblib.parallel_config`` chooses other workers.
    progress : callable, optional
        Called after each run with the number done and their total.
    **options
        Further arguments of :func:`simulate`, the same for all runs.

    Returns
    -------
    list of SimulationRun
        In the order of the arguments; with ``on_failure="return"`` a SimulationFailed for a failed run.

    Raises
    ------
    SimulationFailed
        With ``on_failure="raise"``; a note names the run.
    TypeError, ValueError
        If an argument is of the wrong type, or the arguments differ in length.

    Examples
    --------
    >>> runs = simulate_many(defects=[LobeDefects.worn(n) for n in range(3)], duration=0.05, n_jobs=2)
    >>> [run.defects.defect_count for run in runs]
    [0, 1, 2]
    """
    one_of("on_failure", on_failure, ("raise", "return"))
    check_n_jobs(n_jobs)
    if "start_angle" in options:
        raise ValueError("start_angle is one run's; give start_angles for many")
    each = {
        "gearbox": _one_each("gearboxes", gearboxes, CycloidalGearbox),
        "defects": _one_each("defects", defects, LobeDefects),
        "start_angle": _one_each("start_angles", start_angles, None),
    }
    lists = {name: values for name, values in each.items() if values is not None}
    if len({len(values) for values in lists.values()}) > 1:
        lengths = ", ".join(f"{name} {len(values)}" for name, values in lists.items())
        raise ValueError(f"gearboxes, defects and start_angles must agree in number, got {lengths}")
    same = {"gearbox": gearboxes, "defects": defects, "start_angle": 0.0} | options
    runs = [dict(zip(lists, values, strict=True)) for values in zip(*lists.values(), strict=True)]
    runs = runs if lists else [{}]
    workers = joblib.Parallel(n_jobs=n_jobs, prefer="threads", return_as="generator")
    results: list[Any] = []
    made = workers(joblib.delayed(_attempt)(same | run) for run in runs)
    with stopped_quietly(made):
        for result in made:
            if isinstance(result, Exception) and on_failure == "raise":
                result.add_note(f"in run {len(results)} of {len(runs)} (counted from 0)")
                raise result
            results.append(result)
            if progress is not None:
                progress(len(results), len(runs))
    return results


def _one_each(name: str, values: Any, one: type | None) -> list[Any] | None:
    """Return the values of an argument given run by run; None for one value for all runs."""
    if values is None or (one is not None and isinstance(values, one)):
        return None
    given = None if isinstance(values, str) else members(values)
    if given is None:
        what = "numbers of rad" if one is None else f"a {one.__name__} or several"
        raise TypeError(f"{name} must be {what}, one for each run, got {short(values)}")
    return list(given) if one is not None else [number(name, angle, "numbers of rad") for angle in given]


def _attempt(arguments: dict[str, Any]) -> SimulationRun | SimulationFailed:
    try:
        return simulate(**arguments)
    except SimulationFailed as failure:
        return failure
