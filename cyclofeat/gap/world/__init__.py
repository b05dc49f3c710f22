"""The training world of the joint posterior: random rigs, their sessions, and summaries of their recordings.

:class:`World` states the prior, :func:`prepare_world` simulates it into a folder, and :class:`Rigs` holds the
result. A :class:`Session` holds the recordings of one rig, measured or simulated.
"""
