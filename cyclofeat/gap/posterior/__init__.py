"""Joint posterior of all missing effects at once: probabilities and sizes, given a session's recordings."""
