"""The first stage of the gap: where measured and simulated torque disagree.

:func:`locate` first removes the part of the summaries that follows the speed and the mean torque of each
recording. It then tests each cell by permuting the labels of recordings, with p adjusted within and across
families of cells. :func:`locate_all` does so at each condition of a session.
"""

from cyclofeat.gap.where._conditions import locate_all
from cyclofeat.gap.where._locate import EQUIVALENT_DB, EQUIVALENT_SPREADS, LocatedGap, Row, locate
from cyclofeat.gap.where._permutation import SPREADS as SPREADS
from cyclofeat.gap.where._permutation import TOGETHER as TOGETHER
from cyclofeat.gap.where._permutation import Permuted as Permuted
from cyclofeat.gap.where._permutation import family_p, holm
from cyclofeat.gap.where._permutation import statistics_by_family as statistics_by_family
from cyclofeat.gap.where._session import SpeedAndLoad as SpeedAndLoad
from cyclofeat.gap.where._session import intraclass_correlation as intraclass_correlation
from cyclofeat.gap.where._session import widening as widening

__all__ = [
    "EQUIVALENT_DB",
    "EQUIVALENT_SPREADS",
    "LocatedGap",
    "Row",
    "family_p",
    "holm",
    "locate",
    "locate_all",
]
