"""Many gearboxes at once: one in each lane of the processor's vectors, in single precision.

============  ==============================================================================
module        responsibility
============  ==============================================================================
``_vectors``  vectors as numba types
``_tables``   rows and columns of the tables, and the numbers of each gearbox in them
``_lanes``    one contact, its friction, the sleeves' spin and steps in time, in every lane
``_frames``   frames of all contacts of a lane, from which the others are counted
``_kernel``   time loop, drive and samples of all lanes
``runs``      runs from parameters to records
============  ==============================================================================

:func:`cyclofeat.simulators.simulate_many` runs it.
"""
