"""Benchmark of the counters; ``python -m benchmarks.counting`` writes ``benchmarks/counting.md``."""
