"""Benchmark of spoiled recordings; ``python -m benchmarks.spoiled`` writes ``benchmarks/spoiled.md``."""

# Importing a module of kinds registers them.
from benchmarks.spoiled import _converter, _course, _surroundings

__all__ = ["_converter", "_course", "_surroundings"]
