"""
Which of the papers' methods depends gradually on the count?
============================================================

Paper A asks which method shows each further worn lobe, and answers from one recording of each disc.
:func:`~cyclofeat.counting.rank_features` asks the same of many assemblies: how well does a feature's rank
follow the number of worn lobes, and how sure is that? **Surrogate** torque, six assemblies for each of eight
counts on the assumed rig R1. ``cyclofeat features`` makes the same table of your own recordings
(:doc:`/howto/features`).
"""

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from _surrogates import SAMPLING_RATE, dots_by_count, surrogate_windows
from sklearn.model_selection import StratifiedGroupKFold

from cyclofeat.counting import rank_features
from cyclofeat.features import TorqueFeatures

X, y, assemblies = surrogate_windows(n_assemblies=6)
methods = {
    "minima overlap": "WaveletMinimaOverlap",
    "envelope spectrum": "WaveletEnvelopeSpectrum",
    "coherence": "CoherenceToReference",
    "PSD centroid": "SpectralCentroid",
    "PSD roll-off": "SpectralRolloff",
    "narrowband ratio": "NarrowbandRatio",
    "flatness": "SpectralFlatness",
    "spectral entropy": "SpectralEntropy",
    "statistics": "TorqueStatistics",
    "lobe map (not in the papers)": "LobeMap",
}

# %%
# Minima overlap and coherence compare windows with references that they learn. Each window's features come
# from a transformer that has learned from other assemblies, or references would know their own recordings.

folds = [*StratifiedGroupKFold(3, shuffle=True, random_state=0).split(X, y, assemblies)]
features, tables = {}, {}
for method, name in methods.items():
    transformer = TorqueFeatures(SAMPLING_RATE, features=[name])
    held_out = [transformer.fit(X[train], y[train]).transform(X[test]) for train, test in folds]
    rows = np.argsort(np.concatenate([test for _, test in folds]))
    columns = transformer.get_feature_names_out()
    features[method] = pd.DataFrame(np.concatenate(held_out)[rows], columns=columns)
    tables[method] = rank_features(features[method], y, assemblies, random_state=0)

best = pd.concat({method: table.head(1) for method, table in tables.items()}).reset_index("feature")
best.insert(0, "of", [len(table) for table in tables.values()])
best = best.sort_values("trend", key=np.abs, ascending=False)
print(best[["feature", "of", "trend", "trend_low", "trend_high", "kruskal_p"]].round(2).to_string())

# %%
# The most gradual feature of each method, of as many as the table says. If the interval of its trend contains
# zero, the recordings show no dependence. Of many features, the best one looks better than it is: judge it on
# assemblies that did not choose it.

fig, ax = plt.subplots(figsize=(8, 4.2), layout="constrained")
low, high = best["trend"] - best["trend_low"], best["trend_high"] - best["trend"]
ax.errorbar(best["trend"], best.index, xerr=[low, high], fmt="o", capsize=3)
ax.axvline(0, color="black", lw=0.8)
ax.set(xlim=(-1, 1), xlabel="rank correlation with the number of worn lobes (bars: 95 % over assemblies)")
ax.invert_yaxis()

# %%
# Behind the number: one dot for the windows of each assembly, of the first, the second, and the last method.

fig, axes = plt.subplots(1, 3, figsize=(10, 3.4), layout="constrained")
for ax, method in zip(axes, best.index[[0, 1, -1]], strict=True):
    dots_by_count(ax, y, features[method][best.loc[method, "feature"]].to_numpy(), method, "")
plt.show()
