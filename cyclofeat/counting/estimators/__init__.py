"""Counters of windows: what is worn, from one window of torque."""
