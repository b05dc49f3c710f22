"""Evaluation with whole assemblies held out."""
