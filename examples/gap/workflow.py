"""
A missing brake, found, named and added
=======================================

The papers' model has a free output; a rig has a brake behind shaft and torque meter. Here such a rotor is
hidden in **surrogate** torque, simulated and not measured, and the workflow is given that torque, the counts
of worn lobes and the model without it. The command line does the same with a folder of files
(``cyclofeat gap``) and the whole library; six effects and few simulations keep this script to some minutes.
It writes the picture of the README, ``docs/figures/gap_workflow.png``.
"""

from pathlib import Path

import matplotlib.pyplot as plt

from cyclofeat.gap import DiscrepancyWorkflow, NuisancePrior, make_bank
from cyclofeat.plotting import GapDisplay, GapReductionDisplay
from cyclofeat.simulators import BrakeRotor, CompositeSimulator

hidden = CompositeSimulator(effects=[BrakeRotor(inertia=0.02, stiffness=12_000.0, damping_ratio=0.03)])
prior = NuisancePrior()
fit = make_bank(hidden, prior, (0, 2, 4, 6), n=12, random_state=1)
held_out = make_bank(hidden, prior, (0, 1, 3, 4, 6), n=10, random_state=2)
workflow = DiscrepancyWorkflow(
    25_600,
    library=["brake_rotor", "torque_meter_low_pass", "load_drift", "contact_damping_scale", "noise", "hum"],
    n_bank=80,
    n_after=48,
    n_report=32,
    n_draws=12,
    n_null=48,
    n_sims=120,
    baselines=("nothing", "equaliser"),
    cache="build/gap-example",
)
workflow.fit(fit.X, held_out.X, y_fit=fit.counts, y_hold=held_out.counts)

# %%
# Where they disagree, what is missing, and what it helps
# -------------------------------------------------------

figure, (where, what, helps) = plt.subplots(
    3, 1, figsize=(10.0, 10.0), height_ratios=[1.4, 0.8, 1], layout="constrained"
)
GapDisplay.of_locator(workflow.locator_, label="surrogate").plot("spectrum", ax=where)

result = workflow.result_
ranking = result["ranking"][::-1]
what.barh([row["id"].replace("_", " ") for row in ranking], [row["probability"] for row in ranking])
what.set(xlim=(0, 1.02), xlabel="probability, given that the library holds what is missing")

GapReductionDisplay.from_report(workflow.report_, ax=helps)
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
# Intervals are of 90 %. What the recordings do not tell is said to be so; here, how well the rotor is damped.

for effect in result["effects"]:
    for name, value in effect["theta"].items():
        low, high = effect["interval"][name]
        told = "" if effect["identifiable"][name] else "; not told by these recordings"
        print(f"{effect['id']}.{name} = {value:.3g} ({low:.3g} to {high:.3g}{told})")
