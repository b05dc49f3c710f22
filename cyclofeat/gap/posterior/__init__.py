"""Joint posterior of all missing effects at once.

:class:`EffectPosterior` learns from the rigs of a :class:`cyclofeat.gap.world.World` and gives, for a session
of recordings, the probability of each effect and quantiles of its size. :func:`score_posterior` states how
often it is right on rigs that it has not seen.
"""

from cyclofeat.gap.posterior._answers import ABSENT, PRESENT, UNSEEN, answer_of, named_effects
from cyclofeat.gap.posterior._mean_torque import gain_and_offset
from cyclofeat.gap.posterior._posterior import EffectPosterior, load_posterior
from cyclofeat.gap.posterior._score import PosteriorScore, calibration_error, score_posterior
from cyclofeat.gap.posterior._strengths import detection_limit, ends, strengths_of

__all__ = [
    "ABSENT",
    "PRESENT",
    "UNSEEN",
    "EffectPosterior",
    "PosteriorScore",
    "answer_of",
    "calibration_error",
    "detection_limit",
    "ends",
    "gain_and_offset",
    "load_posterior",
    "named_effects",
    "score_posterior",
    "strengths_of",
]
