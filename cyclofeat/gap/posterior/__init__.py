"""Joint posterior of all missing effects at once.

:class:`EffectPosterior` learns from the rigs of a :class:`~cyclofeat.gap.World` and gives, for a session
of recordings, the probability of each effect and quantiles of its size. :func:`score_posterior` states how
often it is right on rigs that it has not seen.
"""
