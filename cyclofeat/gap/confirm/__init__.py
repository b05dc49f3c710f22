"""Confirmation by simulation: sizes of the named effects, and what they leave unexplained."""
