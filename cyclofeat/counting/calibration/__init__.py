"""Calibration of counters on held-out assemblies, and the domain of their training."""
