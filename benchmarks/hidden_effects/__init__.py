"""Simulated rig recordings with hidden effects from an independent generator, and a scorer.

See ``README.md`` beside this file.
"""

from benchmarks.hidden_effects._cases import Case, case_names, make_case, truth

__all__ = ["Case", "case_names", "make_case", "truth"]
