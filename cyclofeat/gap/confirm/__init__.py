"""Confirmation by simulation: sizes of the effects that a posterior names, and what they leave unexplained.

:func:`confirm` simulates sessions like the measured one with the named effects, fits their sizes, and states
how far the measured session lies from those of the corrected rig. :func:`draw_effects` draws effects
and sizes from what the recordings leave possible. :func:`simulate_possible` simulates such rigs, which tells
what further recordings would settle.
"""
