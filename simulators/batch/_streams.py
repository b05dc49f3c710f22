"""Input and load of all lanes, evaluation by evaluation, and samples from the results of each step."""

from __future__ import annotations

from cyclofeat.simulators._jit import njit
from cyclofeat.simulators.batch import _rows as rows
from cyclofeat.simulators.batch._vectors import FASTMATH, addresses, filled, load, rounded_to, store


@njit(fastmath=False, nogil=True)
def fill(courses, sizes, first, n, stages, n_lobes, angle, drive):
    """Write ``n`` evaluations from number ``first`` of a piece on into ``angle`` and ``drive`` of the kernel.

    ``courses`` (lanes, 4, evaluations) hold a piece of each lane's course, with one evaluation more than the
    lane's ``size``. A lane whose course has ended stands still: nothing reads what it does from there on.
    """
    for lane in range(sizes.size):
        course = courses[lane]
        own = max(min(sizes[lane] - first, n), 0)
        for k in range(own, n):
            angle[k, lane] = course[0, sizes[lane]]
            drive[k, :, lane] = 0.0
        for k in range(own):
            i = first + k
            angle[k, lane] = course[0, i]
            drive[k, rows.OMEGA, lane] = course[1, i]
            drive[k, rows.ALPHA, lane] = course[2, i]
            drive[k, rows.LOAD, lane] = course[3, i]
            # Where a ramp ends the acceleration jumps: the rule of one stage takes its part from the speed.
            push = course[2, i] if stages == 2 else course[1, i + 1] - course[1, i]
            drive[k, rows.PUSH, lane] = push / n_lobes


@njit(fastmath=FASTMATH, nogil=True)
def decimate(lanes, results_, first, row, phases_, down, begin, samples_):
    """Write the low-passed samples of one row of the results into ``samples`` (n_samples, lanes), in float64.

    As ``scipy.signal.resample_poly``, for all lanes at once. ``results`` begin with step ``first`` and hold
    all steps on which ``samples``, from number ``begin`` on, depend; ``phases`` (up, n_taps) holds the
    low-pass by phases, the latest step's weight last.
    """
    results, phases, samples = addresses((results_, phases_, samples_))
    up, n_taps = phases_.shape
    # The phases hold the middle of the low-pass at this place.
    middle = (n_taps * up) // 2
    for k in range(samples_.shape[0]):
        at = (begin + k) * down + middle
        phase, earliest = at % up, at // up - (n_taps - 1) - first
        total = filled(0.0, samples, lanes)
        for tap in range(n_taps):
            value = rounded_to(load(results, rows.N_RESULTS * (earliest + tap) + row, lanes), samples)
            total = total + phases[phase * n_taps + tap] * value
        store(samples, k, total)
