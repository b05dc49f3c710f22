"""The fourth stage of the gap: how far it shrank on recordings held out.

:func:`prove` compares distances between measured and simulated recordings for the corrected model and its
alternatives.
"""

from cyclofeat.gap.proof._alternatives import Simulated
from cyclofeat.gap.proof._distance import Part, Sample, describe
from cyclofeat.gap.proof._distance import Scale as Scale
from cyclofeat.gap.proof._prove import prove
from cyclofeat.gap.proof._scores import DistanceRow, Proof, ProofRow, score_alternatives

__all__ = [
    "DistanceRow",
    "Part",
    "Proof",
    "ProofRow",
    "Sample",
    "Simulated",
    "describe",
    "prove",
    "score_alternatives",
]
