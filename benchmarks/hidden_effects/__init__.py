"""Simulated rig recordings with hidden effects from an independent generator, and a scorer.

See ``README.md`` beside this file.
"""

from benchmarks.hidden_effects._folders import read_set
from benchmarks.hidden_effects._sets import set_names

__all__ = ["read_set", "set_names"]
