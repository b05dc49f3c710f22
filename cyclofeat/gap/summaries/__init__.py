"""Numbers by which recordings are compared.

A recording is reduced to numbers, the cells, which form families (:func:`summarise`). Measured windows are
checked, cut to output turns and collected by recording (:class:`MeasuredTurns`). Torque is folded over the
turn for pictures (:func:`phase_maps`).
"""
