"""The second stage of the gap: which effect of the library is missing.

:func:`learn_effects` simulates each effect many times and learns what it does to the summaries. The
:class:`EffectRanker` that it returns ranks the effects that could explain a disagreement, and names their
look-alikes and the measurement that separates them.
"""

from cyclofeat.gap.what._learned import Typical as Typical
from cyclofeat.gap.what._learned import sharpened as sharpened
from cyclofeat.gap.what._ranker import EffectRanker, RankedEffect, RankedPair, Ranking, learn_effects
from cyclofeat.gap.what._table import EffectTable
from cyclofeat.gap.what._table import make_table as make_table

__all__ = [
    "EffectRanker",
    "EffectTable",
    "RankedEffect",
    "RankedPair",
    "Ranking",
    "learn_effects",
]
