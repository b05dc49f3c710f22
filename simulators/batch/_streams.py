"""Input and load of all lanes, evaluation by evaluation."""

from __future__ import annotations

from cyclofeat.simulators._jit import njit
from cyclofeat.simulators.batch import _rows as rows


@njit(fastmath=False, nogil=True)
def fill(courses, first, n, stages, n_lobes, angle, drive):
    """Write ``n`` steps from step ``first`` on into ``angle`` and ``drive`` of the kernel.

    ``courses`` is a tuple of the lanes' courses at every half step, as the exact kernel takes them.
    """
    stride = 2 // stages
    for lane in range(len(courses)):
        course = courses[lane]
        for k in range(stages * n):
            i = 2 * first + stride * k
            angle[k, lane] = course[0, i]
            drive[k, rows.OMEGA, lane] = course[1, i]
            drive[k, rows.ALPHA, lane] = course[2, i]
            drive[k, rows.LOAD, lane] = course[3, i]
            # Where a ramp ends the acceleration jumps: the rule of one stage takes its part from the speed.
            push = course[2, i] if stages == 2 else course[1, i + 2] - course[1, i]
            drive[k, rows.PUSH, lane] = push / n_lobes
