"""
Find, name and add all that a model lacks
=========================================

The papers' model has a free output. This rig has a brake behind a shaft, a load that drifts, mains hum and
noise: four effects at once, hidden in **surrogate** torque, simulated and not measured.
:func:`cyclofeat.gap.find_gap` receives recordings at two loads and the model without the effects, names what
is missing, estimates its size, and judges the corrected model on recordings held out. This script writes the
picture of the README:

.. image:: /figures/gap_workflow.png
   :alt: Probabilities of the missing effects, spectra before and after, share of the gap that closes
"""

# sphinx_gallery_thumbnail_path = 'figures/gap_workflow.png'

from pathlib import Path

import matplotlib.pyplot as plt

from cyclofeat.datasets import make_rig_recordings
from cyclofeat.gap import GapSettings, find_gap, hold_out
from cyclofeat.simulators import BrakeRotor, CycloidalGearbox, Drift, Hum, Noise, Rig

hidden = [BrakeRotor(0.02, 12_000.0, 0.03), Drift(1.0), Hum(0.3), Noise(0.1)]
recordings = [
    recording
    for load in (14.0, 28.0)
    for recording in make_rig_recordings(
        8,
        (0, 3),
        rig=Rig(CycloidalGearbox.steel(load_torque=load), hidden),
        duration=2.0,
        random_state=int(load),
    )
]
fitted, held_out = hold_out(recordings, 0.4, random_state=0)
result = find_gap(fitted, held_out, settings=GapSettings(random_state=0, n_jobs=-1))

# %%
# What is missing, and how much better the corrected model is
# ------------------------------------------------------------

figure, (missing, spectrum, helps) = plt.subplots(
    3, 1, figsize=(10.0, 10.5), height_ratios=[0.9, 1.4, 1], layout="constrained"
)
shown = [found for found in result.effects if found.probability > 0.15][::-1]
missing.barh([found.effect.replace("_", " ") for found in shown], [found.probability for found in shown])
missing.set(xlim=(0, 1.02), xlabel="probability that it is missing")
result.plot("spectrum", spectrum, label="simulated")
result.plot("closed", helps)
titles = {
    missing: "What is missing",
    spectrum: "Recordings, model and corrected model",
    helps: "How much of the gap closes on recordings held out",
}
for ax, title in titles.items():
    ax.set_title(title, loc="left", fontweight="bold", pad={missing: 8, spectrum: 30, helps: 40}[ax])
figure.savefig(Path(__file__).parents[2] / "docs" / "figures" / "gap_workflow.png", dpi=100)

# %%
# Sizes
# -----
# Intervals are of 90 %.

for effect in result.named:
    found = result.effect(effect.effect_id)
    for size in found.sizes:
        print(f"{found.effect}: {size}")
print(f"something left unexplained: {result.remainder.unexplained}")
for proof in result.proof:
    print(f"{proof.condition.text}: {proof.result.grr:.0%} of the gap closed")

# %%
# All that is hidden is named, and nothing else; nine tenths of the gap close.

assert {effect.effect_id for effect in result.named} == {effect.effect_id for effect in hidden}
assert not result.remainder.unexplained
assert min(proof.result.grr for proof in result.proof) > 0.9
