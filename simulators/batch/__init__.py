"""Many gearboxes at once: one in each lane of the processor's vectors, in single precision.

==============  ==========================================================================
module          responsibility
==============  ==========================================================================
``_vectors``    vectors as numba types
``_rows``       rows and columns of the tables
``_lanes``      one contact in every lane
``_friction``   friction, and the sleeves' spin
``_steps``      steps of the states in time
``_frames``     frames of all contacts of a lane, which the others are counted from
``_kernel``     time loop
``_streams``    input and load of all lanes over time, and the anti-alias filter
``_prepare``    tables of a batch
``_integrate``  a batch, piece by piece
``_samples``    samples of its runs
``_run``        runs from parameters to records
==============  ==========================================================================

:func:`cyclofeat.simulators.simulate_many` runs it.
"""

from cyclofeat.simulators.batch._run import (
    Request,
    Settings,
    batches,
    compile_error,
    integrated,
    n_lanes,
    obstacle,
    run_batch,
)

__all__ = [
    "Request",
    "Settings",
    "batches",
    "compile_error",
    "integrated",
    "n_lanes",
    "obstacle",
    "run_batch",
]
