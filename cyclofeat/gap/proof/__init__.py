"""The fourth stage of the gap: how far it shrank on recordings held out.

Distances between measured and simulated recordings, the alternatives that a named effect has to beat, and the
worth of the corrected model to a counter that is trained on it (:func:`downstream_gain`).
"""

from cyclofeat.gap.proof._alternatives import BASELINES, Alternative, Simulated
from cyclofeat.gap.proof._distance import Part, Sample, describe
from cyclofeat.gap.proof._distance import Scale as Scale
from cyclofeat.gap.proof._downstream import DownstreamGain, downstream_gain
from cyclofeat.gap.proof._held_out import check_held_out
from cyclofeat.gap.proof._prove import prove
from cyclofeat.gap.proof._scores import AFTER, BEFORE, DistanceRow, Proof, ProofRow, score_alternatives

__all__ = [
    "AFTER",
    "BASELINES",
    "BEFORE",
    "Alternative",
    "DistanceRow",
    "DownstreamGain",
    "Part",
    "Proof",
    "ProofRow",
    "Sample",
    "Simulated",
    "check_held_out",
    "describe",
    "downstream_gain",
    "prove",
    "score_alternatives",
]
