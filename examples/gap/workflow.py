"""
Find, name and add a missing brake
==================================

The papers' model has a free output; a rig has a brake behind shaft and torque meter. In this example, such
a rotor is hidden in **surrogate** torque, simulated and not measured. The workflow receives that torque,
the counts of worn lobes and the model without the rotor. This script uses :func:`cyclofeat.gap.find_gap`,
six effects and few simulations so that it runs in some minutes; the command ``cyclofeat gap`` asks for the
whole library at once. It writes the picture of the README, ``docs/figures/gap_workflow.png``.
"""

from pathlib import Path

import matplotlib.pyplot as plt

from cyclofeat.gap import Comparison, GapSettings, Windows, find_gap
from cyclofeat.plotting import GapDisplay, GapReductionDisplay
from cyclofeat.simulators import BrakeRotor, Rig

hidden = Rig(effects=[BrakeRotor(inertia=0.02, stiffness=12_000.0, damping_ratio=0.03)])
comparison = Comparison(sampling_rate=25_600, n_bank=80, cache="build/gap-example")
truth = comparison.replace(rig=hidden)
fit = truth.bank(12, (0, 2, 4, 6), random_state=1)
held_out = truth.bank(10, (0, 1, 3, 4, 6), random_state=2)
settings = GapSettings(
    library=["brake_rotor", "torque_meter_low_pass", "load_drift", "contact_damping_scale", "noise", "hum"],
    n_after=48,
    n_report=32,
    n_draws=12,
    n_null=48,
    n_sims=120,
    baselines=("nothing", "equaliser"),
)
result = find_gap(
    comparison,
    Windows(fit.X, fit.counts),
    Windows(held_out.X, held_out.counts),
    settings=settings,
)

# %%
# Where they disagree, what is missing, and what it helps
# -------------------------------------------------------

figure, (where, what, helps) = plt.subplots(
    3, 1, figsize=(10.0, 10.0), height_ratios=[1.4, 0.8, 1], layout="constrained"
)
GapDisplay(result.where, label="surrogate").plot("spectrum", where)

ranking = result.ranking[::-1]
what.barh([row.effect.replace("_", " ") for row in ranking], [row.probability for row in ranking])
what.set(xlim=(0, 1.02), xlabel="probability, given that the library holds what is missing")

GapReductionDisplay(result.proof.rows).plot(helps)
titles = {
    where: "Where model and recordings disagree",
    what: "What is missing",
    helps: "How much of the gap closes on recordings held out",
}
for ax, title in titles.items():
    ax.set_title(title, loc="left", fontweight="bold", pad=8 if ax is what else 30)
figure.savefig(Path(__file__).parents[2] / "docs" / "figures" / "gap_workflow.png", dpi=100)

# %%
# Its size
# --------
# Intervals are of 90 %. Parameters that the recordings do not determine are marked; here, the rotor's
# damping.

for row in result.parameters:
    doubt = "" if row.identifiable else "; poorly identified by these recordings"
    print(f"{row.effect}.{row.name} = {row.value:.3g} ({row.low:.3g} to {row.high:.3g}{doubt}) {row.unit}")
