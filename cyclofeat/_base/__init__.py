"""Helpers for all packages: argument checks, file writes, versions, progress, private scikit-learn parts."""
