"""The gap in torque-deflection loops of a drive with held output (:func:`find_loop_gap`)."""
