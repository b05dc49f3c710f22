"""Numbers by which recordings are compared (cells, in families), and torque folded over the turn."""
