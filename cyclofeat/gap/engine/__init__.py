"""Effects that a simulator lacks, from its own simulations of the measured session.

`problem`: what a simulator states and offers; `sizes`: fits of a set of effects; `search`: the effects that
recordings left out of the fit need. For simulators with random parts, `projection`: responses with common
random numbers; `sets`: all sets of effects and their sizes.
"""
