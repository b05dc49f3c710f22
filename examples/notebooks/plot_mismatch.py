"""
A simulation engineer's mismatch: find what the model lacks, and train on what is left
======================================================================================

Your simulation and your rig disagree, and a counter that learned from the simulation is only as good as the
simulation. We compare the two, let the toolkit name what is missing, add it, judge the corrected model on
recordings that it has not seen, and train a counter on it.

The rig here is itself simulated (**surrogate** recordings), so that we know what it hides: the rotor of a
brake behind a shaft, a load that drifts, mains hum and noise. Like every rig, it also differs from recording
to recording within its tolerances (``MAY_DIFFER``), which the toolkit expects. The page takes few recordings
and few simulations, to build in a minute or two: expect wide intervals and effects that stay *unresolved*,
and use the defaults of ``cyclofeat gap`` and a second load for work that matters. The plots need matplotlib.
"""

import matplotlib.pyplot as plt
import numpy as np

from cyclofeat import Windower
from cyclofeat.counting import make_lobe_counter
from cyclofeat.datasets import make_rig_recordings
from cyclofeat.gap import GapSettings, find_gap, hold_out
from cyclofeat.gap.comparison import MAY_DIFFER
from cyclofeat.simulators import BrakeRotor, Drift, Hum, Noise, Rig

# %%
# Recordings of the rig
# ---------------------
# Twelve recordings, half of a healthy disc and half of one with three worn lobes; 40 % are held out and only
# used to judge. With files you would write ``read_folder("measured/")``.

model = Rig()  # the bare gearbox of the papers, at 500 RPM and 22 Nm
missing = [BrakeRotor(0.02, 12_000.0, 0.03), Drift(0.3), Hum(0.3), Noise(0.1)]
hidden = model.with_added(*MAY_DIFFER, *missing)
recordings = make_rig_recordings(6, (0, 3), rig=hidden, duration=2.0, random_state=1, kernel="auto")
fitted, held_out = hold_out(recordings, 0.4, random_state=0)

# %%
# Compare, name, add, judge
# -------------------------
# One call does all four. The defaults simulate more for the comparison and the proof than these settings.

settings = GapSettings(
    n_bank=60,
    n_permutations=399,
    n_after=24,
    n_report=24,
    random_state=0,
    n_jobs=2,
)
result = find_gap(fitted, held_out, settings=settings)
print("model and recordings:", result.verdict)
for effect in result.effects:
    if effect.probability > 0.05:
        sizes = [
            f"{size.name} {size.value:.2g} ({size.low:.2g} to {size.high:.2g}) {size.unit}"
            for size in effect.sizes
        ]
        print(f"{effect.effect:20} {effect.probability:4.0%} {effect.state:19} {', '.join(sizes)}")
print("something left unexplained:", result.remainder.unexplained)
named = {effect.effect for effect in result.effects if effect.state == "missing"}
assert named == {effect.effect_id for effect in missing}
assert not result.remainder.unexplained

# %%
# All four are found, and nothing else. The intervals are of 90 % and should hold the truth, which only a
# surrogate rig lets us check: 0.020 kg m², 12,000 Nm/rad and 3 % of damping of the brake, hum of 0.3 Nm,
# noise of 0.1 Nm, drift of 0.3 Nm. That of noise ends just below it, because the comparison gives the model
# 0.02 Nm of noise anyway. Where something stays unexplained, the sizes are wider.

# %%
# Look at the correction before you use it
# ----------------------------------------
# The corrected model should lie inside the band of the recordings. If it does not, something is missing that
# no effect of the library explains, and ``result.remainder`` lists where.

figure, (above, below) = plt.subplots(2, 1, figsize=(8, 6.6), height_ratios=[2.2, 1], layout="constrained")
result.plot("spectrum", above, label="recordings")
result.plot("closed", below)
plt.show()

# %%
# Train on the corrected rig
# --------------------------
# ``result.posterior_rig`` holds 200 sets of effects that the recordings leave possible; each simulated
# assembly has another one, so that the counter does not bet on a single guess. We train one counter on
# the model as it was and one on the corrected rig, and count new recordings of the hidden rig.


def counter_of(rig):
    known = make_rig_recordings(8, (0, 1, 3), rig=rig, duration=1.85, random_state=2, n_jobs=2, kernel="auto")
    X, y, _ = Windower(output_turns=1).transform(known)
    return make_lobe_counter(known[0].sampling_rate, n_trees=100, random_state=0).fit(X, y)


new = make_rig_recordings(6, (0, 1, 3), rig=hidden, duration=1.85, random_state=99, n_jobs=2, kernel="auto")
X, y, _ = Windower(output_turns=1).transform(new)
for name, rig in (("model as it was", model), ("corrected", result.posterior_rig), ("truth", hidden)):
    right = np.mean(counter_of(rig).predict(X) == y)
    print(f"trained on {name:16} {right:.0%} of {len(y)} new recordings counted right")

# %%
# In your project
# ---------------
# The same from the command line, with a page, the corrected rig as a file, and a counter trained on it:
#
# .. code-block:: console
#
#    $ cyclofeat gap measured/ --simulator mine.json --hold-out 0.4 --out gap.html \
#          --save-simulator corrected.json
#    $ cyclofeat train --rig corrected.json --out corrected.skops
