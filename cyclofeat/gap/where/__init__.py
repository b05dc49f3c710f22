"""The first stage of the gap: where measured and simulated torque disagree.

:func:`locate` first removes the part of the summaries that follows the speed and the mean torque of each
recording. It then tests each cell by permuting the labels of recordings, with p adjusted within and across
families of cells. :func:`locate_all` does so at each condition of a session.
"""
