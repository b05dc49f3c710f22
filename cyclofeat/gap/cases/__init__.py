"""Measurements without recordings of torque over time, as problems of the engine."""
