"""The second stage of the gap: which effect of the library would explain the disagreement.

:func:`learn_effects` simulates each effect many times and learns what it does to the summaries. The
:class:`EffectRanker` that it returns names what would explain a disagreement, with look-alikes and the
measurement that tells them apart.
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
