"""The data of the benchmark rig-v1, by name."""

from __future__ import annotations

from benchmarks.counting._data import Design

RIGS = ("R0", "R1", "R2")

# Judged, in folds by assembly.
JUDGED = {rig: Design(rig, rig) for rig in RIGS}
# The first of them once more, longer: windows continue those of the shorter records.
EIGHT = Design("R1-eight", "R1", n_assemblies=10, n_windows=8)
# Only trained on: other seeds, so other assemblies, and a step twice as long, which halves their price.
COARSE = {"integrator": "adams_bashforth", "dt": 2e-5}
MORE = {rig: Design(f"{rig}-more", rig, n_assemblies=120, seed=1, options=COARSE) for rig in RIGS}
