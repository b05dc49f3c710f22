"""Joint posterior of all missing effects at once.

:class:`EffectPosterior` learns from the rigs of a :class:`cyclofeat.gap.world.World` and gives, for a session
of recordings, the probability of each effect and quantiles of its size. :func:`score_posterior` states how
often it is right on rigs that it has not seen.
"""

from cyclofeat.gap.posterior._inputs import gain_and_offset
from cyclofeat.gap.posterior._posterior import QUANTILES, EffectPosterior, load_posterior
from cyclofeat.gap.posterior._score import (
    ABSENT,
    PRESENT,
    TIES,
    PosteriorScore,
    calibration_error,
    named_effects,
    score_posterior,
)

__all__ = [
    "ABSENT",
    "PRESENT",
    "QUANTILES",
    "TIES",
    "EffectPosterior",
    "PosteriorScore",
    "calibration_error",
    "gain_and_offset",
    "load_posterior",
    "named_effects",
    "score_posterior",
]
