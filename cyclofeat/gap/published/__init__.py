"""The gap in published statistics, without recordings (:func:`find_published_gap`)."""

from cyclofeat.gap.published._gap import Discrepancy, HeldOut, PublishedGap, find_published_gap
from cyclofeat.gap.published._scores import crps as crps
from cyclofeat.gap.published._scores import fewest_units, sign_flip_p
from cyclofeat.gap.published._scores import to_statistics as to_statistics
from cyclofeat.gap.published._search import Step, Tried
from cyclofeat.gap.published._settings import PublishedSettings

__all__ = [
    "Discrepancy",
    "HeldOut",
    "PublishedGap",
    "PublishedSettings",
    "Step",
    "Tried",
    "fewest_units",
    "find_published_gap",
    "sign_flip_p",
]
