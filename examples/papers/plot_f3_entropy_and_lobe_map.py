"""
Finding: entropy follows the drift, the lobe map the lobes
==========================================================

A brake that fluctuates slowly changes Shannon entropy by more than wear does. The same torque, folded at
the rate at which lobes pass the load, has a slot for each lobe, and drift lies beside its lines.
**Surrogate** torque of the papers' free output (rig R0, both wheels worn, noise of 0.05 Nm); drift of
growing size, slower than 1.5 Hz, is added afterwards, as a drift of the sensor would be.
"""

import matplotlib.pyplot as plt
import numpy as np
from _papers import BOTH, RIG_RATE, shades
from scipy.signal import butter, sosfilt
from sklearn.ensemble import ExtraTreesClassifier
from sklearn.model_selection import GroupKFold, cross_val_score

from cyclofeat.datasets import make_rig_recordings, rig_preset
from cyclofeat.features import LobeMap, SpectralEntropy
from cyclofeat.simulators import Noise

COUNTS = (0, 1, 3, 5, 7)
N_ASSEMBLIES = 8
rig = rig_preset("R0").without("load_drift").with_effects(Noise(0.05))
recordings = make_rig_recordings(N_ASSEMBLIES, COUNTS, rig=rig, wheels=BOTH, random_state=5, kernel="auto")
X = np.array([recording.torque for recording in recordings])
y = np.array([recording.defect_count for recording in recordings])
assembly = np.arange(len(X))

random = np.random.default_rng(0).normal(size=(len(X), 4 * X.shape[1]))
drift = sosfilt(butter(2, 1.5, fs=RIG_RATE, output="sos"), random, axis=1)[:, -X.shape[1] :]
drift /= drift.std()
sizes = (0.0, 0.1, 0.3, 1.0, 3.0)
entropy = SpectralEntropy(RIG_RATE)
methods = {
    "Shannon entropy": entropy,
    "Shannon entropy, mean removed": SpectralEntropy(RIG_RATE, preset="ripple"),
    "lobe map": LobeMap(RIG_RATE),
}
trees, folds = ExtraTreesClassifier(100, random_state=0), GroupKFold(4)

fig, (left, middle, right) = plt.subplots(1, 3, figsize=(12.5, 4.2), layout="constrained")
for (name, method), style in zip(methods.items(), ("o-", "s--", "^-."), strict=True):
    accuracies = [
        cross_val_score(trees, method.fit_transform(X + size * drift), y, groups=assembly, cv=folds).mean()
        for size in sizes
    ]
    left.plot(range(len(sizes)), accuracies, style, label=name)
    print(f"{name:30}", " ".join(f"{value:.2f}" for value in accuracies))
left.axhline(1 / len(COUNTS), color="black", lw=0.8, ls=":", label="chance")
left.set_xticks(range(len(sizes)), [f"{size:g}" for size in sizes])
left.set(xlabel="drift in Nm rms", ylabel="accuracy, assemblies held out", ylim=(0, 1.05))
left.legend(fontsize="small", loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2)

for ax, size in ((middle, 0.0), (right, 1.0)):
    bits = entropy.fit_transform(X + size * drift)[:, 0]
    for count, colour in zip(COUNTS, shades(len(COUNTS)), strict=True):
        ax.plot(np.full(N_ASSEMBLIES, count), bits[y == count], "o", color=colour, alpha=0.7)
    ax.set(title=f"entropy with {size:g} Nm of drift", xlabel="worn lobes", ylabel="bits", xticks=COUNTS)
plt.show()

# %%
# Without drift the entropy grows with the count and measures the ripple. With 1 Nm of drift it shows
# nothing, and removing the mean restores a part of it, because the drift is not the mean. The lobe map
# hardly changes. (A drift of the *load* also changes the mesh's amplitude; at one speed the two drifts are
# almost impossible to distinguish. ``benchmarks/counting.md`` has the load's, with more assemblies.)
