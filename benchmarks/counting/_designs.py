"""The data of the benchmark rig-v1, by name."""

from __future__ import annotations

from benchmarks.counting._data import OPTIONS, Design

RIGS = ("R0", "R1", "R2")

# Tested, in folds by assembly.
JUDGED = {rig: Design(rig, rig) for rig in RIGS}
# The first of them again, longer: the windows continue those of the shorter records.
EIGHT = Design("R1-eight", "R1", n_assemblies=10, n_windows=8)
# Training only: other seeds, so other assemblies, and a step twice as long, which halves the cost.
COARSE = (*OPTIONS, ("dt", 2e-5))
MORE = {
    rig: Design(f"{rig}-more", rig, n_assemblies=n, seed=1, options=COARSE)
    for rig, n in (("R0", 60), ("R1", 120), ("R2", 60))
}

# Differences between training and test, rig R1.
FINER = Design("R1-midpoint", "R1", 10, seed=2, options=(("integrator", "midpoint"), ("dt", 5e-6)))
CONSERVATIVE = Design("R1-conservative", "R1", 10, seed=3, law="conservative")
BRAKED = Design("R0+brake", "R0+brake", 20, seed=4, options=COARSE)
LOADS = {
    load: Design(f"R1-{load:g}Nm", "R1", 20, seed=100 + int(load), load_nm=load, options=COARSE)
    for load in (18.0, 26.0)
}
SPEEDS = {
    rpm: Design(f"R1-{rpm:g}rpm", "R1", 20, seed=100 + int(rpm), speed_rpm=rpm, options=COARSE)
    for rpm in (400.0, 600.0)
}
NINTH = Design("R1-ninth", "R1", 40, seed=7, counts=(8,))
ANY = (
    Design("R1-any", "R1", 40, seed=8, consecutive=False, options=COARSE),
    Design("R1-any-more", "R1", 120, seed=12, consecutive=False, options=COARSE),
)
# Lobes counted from 0: the papers' (1, 5), (1, 4, 7), (1, 3, 5, 7) and (2, 4, 6, 8).
PATTERNS = Design("R1-patterns", "R1", 10, seed=9, patterns=((0, 4), (0, 3, 6), (0, 2, 4, 6), (1, 3, 5, 7)))
# Data of the plan: shallower wear, more windows. EIGHT holds depth 1.
DEPTHS = {
    depth: Design(f"R1-depth{depth:g}", "R1", 10, seed=10, n_windows=4, depth=depth, options=COARSE)
    for depth in (0.1, 0.2, 0.35, 0.5, 0.7)
}
