"""
Which features count lobes of unseen assemblies?
================================================

:class:`~cyclofeat.features.TorqueFeatures` gives the features of all methods in one row per window and fits
into a pipeline like any other transformer. Which of them count worn lobes in assemblies that were not in
training? **Surrogate** torque, six assemblies for each of eight counts on the assumed rig R1: chance is
1/8.
"""

import matplotlib.pyplot as plt
import numpy as np
from _surrogates import SAMPLING_RATE, surrogate_windows
from sklearn.ensemble import ExtraTreesClassifier
from sklearn.pipeline import make_pipeline

from cyclofeat.counting import Protocol, evaluate
from cyclofeat.features import TorqueFeatures

X, y, assemblies = surrogate_windows(n_assemblies=6)
families = {
    "entropy": ["SpectralEntropy"],
    "statistics": ["TorqueStatistics"],
    "density": ["SpectralEntropy", "SpectralFlatness", "SpectralCentroid", "SpectralRolloff", "BandPower"],
    "coherence": ["CoherenceToReference"],
    "wavelets": ["WaveletMinimaOverlap", "WaveletEnvelopeSpectrum", "WaveletLevelStatistics"],
    "order lines": ["OrderSpectrum"],
    "lobe map": ["LobeMap"],
    "all": "all",
}

# %%
# ``fit`` learns the references (healthy windows, worst windows). Inside the pipeline it therefore learns them
# from the training assemblies of each fold alone. ``evaluate`` holds whole assemblies out.

results = {}
for name, features in families.items():
    trees = ExtraTreesClassifier(n_estimators=100, random_state=0)
    counter = make_pipeline(TorqueFeatures(SAMPLING_RATE, features=features), trees)
    results[name] = evaluate(counter, X, y, assemblies, protocol=Protocol(n_splits=3, random_state=0))
    print(f"{name:14} {results[name]}")

# %%

accuracy = np.array([result.accuracy for result in results.values()])
interval = np.array([result.accuracy_interval for result in results.values()]).T
fig, ax = plt.subplots(figsize=(8, 4), layout="constrained")
ax.barh(list(results), accuracy, xerr=np.abs(interval - accuracy), color="0.7", capsize=3)
ax.axvline(1 / 8, color="black", ls="--")
ax.set_title("counting worn lobes (dashed: chance, 1/8)")
ax.set(xlim=(0, 1.05), xlabel="accuracy, whole assemblies held out (whiskers: 95 % over assemblies)")
ax.invert_yaxis()
plt.show()

# %%
# Six assemblies per count are few, as the whiskers show: on this rig, entropy and statistics cannot be
# distinguished from chance, and the other published methods count little better. The lobe map, which treats
# each lobe separately, counts. More columns are not better: trees that choose among all 340 meet the useful
# ones less often.
