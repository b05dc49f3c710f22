"""Simulated rig recordings in which an effect is hidden, made by code of their own, and a scorer.

See ``README.md`` beside this file.
"""

from benchmarks.hidden_effects._cases import Case, case_names, make_case, truth

__all__ = ["Case", "case_names", "make_case", "truth"]
