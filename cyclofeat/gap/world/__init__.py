"""The training world of the joint posterior: random rigs, their sessions, and their summaries."""
