"""
Search windows, features and counter at once
============================================

How long should a window be, which features does it need, and how should the trees be set? One search over
recordings answers all three, because :class:`~cyclofeat.counting.LobeModel` cuts windows itself. Its folds
hold out assemblies. A counter of windows that are split without regard to assemblies scores high without
having learned anything. The torque is **surrogate**: simulated on the assumed rig R1.
"""

import matplotlib.pyplot as plt
import numpy as np
from sklearn.ensemble import ExtraTreesClassifier
from sklearn.model_selection import GridSearchCV, StratifiedGroupKFold, StratifiedKFold, cross_val_score
from sklearn.pipeline import make_pipeline

from cyclofeat import Windower
from cyclofeat.counting import LobeModel
from cyclofeat.datasets import make_rig_recordings, rig_preset
from cyclofeat.features import TorqueFeatures, WelchPSD
from cyclofeat.recordings.windower import lobe_windower

recordings = make_rig_recordings(
    6, (0, 2, 4), rig=rig_preset("R1"), duration=3.6, random_state=0, kernel="auto", with_angle=True
)
counts = [recording.defect_count for recording in recordings]
assemblies = [recording.assembly for recording in recordings]

# %%
# Windows of half an output turn are the shortest that a :class:`~cyclofeat.Windower` cuts.

trees = ExtraTreesClassifier(n_estimators=30, random_state=0)
counter = make_pipeline(TorqueFeatures(sampling_rate=128), trees)  # the model sets rate, speed and lobes
search = GridSearchCV(
    LobeModel(lobe_windower(), counter, n_splits=0, random_state=0),
    {
        "windower__output_turns": [0.5, 0.98, 1.9],
        "counter__torquefeatures__features": [["TorqueStatistics"], ["OrderSpectrum"], ["LobeMap"]],
        "counter__extratreesclassifier__min_samples_leaf": [1, 2],
    },
    cv=StratifiedGroupKFold(n_splits=2),
)
search.fit(recordings, counts, groups=assemblies)
scores = search.cv_results_
names = [params["counter__torquefeatures__features"][0] for params in scores["params"]]
turns = [params["windower__output_turns"] for params in scores["params"]]

fig, ax = plt.subplots(figsize=(7, 3.6), layout="constrained")
for place, name in enumerate(dict.fromkeys(names)):
    for length, look in ((0.5, "o"), (0.98, "s"), (1.9, "^")):
        chosen = [
            s
            for s, n, t in zip(scores["mean_test_score"], names, turns, strict=True)
            if (n, t) == (name, length)
        ]
        label = f"{length:g} output turns" if place == 0 else None
        ax.plot(max(chosen), place + 0.2 * (0.98 - length), look, color="C0", markersize=8, label=label)
ax.set_yticks(range(3), list(dict.fromkeys(names)))
ax.axvline(1 / 3, color="black", ls="--", lw=0.8, label="chance")
ax.set(xlim=(0, 1.03), xlabel="recordings counted right, assemblies held out")
ax.legend(loc="upper left", fontsize="small")
plt.show()
print(search.best_params_, f"{search.best_score_:.2f}")

# %%
# **The leak.** Random labels for the assemblies leave nothing to learn. Folds by assembly say so;
# folds of windows put one window of a recording into training and the next into the test.

X, y, groups = Windower().transform(recordings)
_, member = np.unique(groups, return_inverse=True)
nonsense = np.random.default_rng(0).permutation(np.arange(18) % 3)[member]
spectrum = make_pipeline(WelchPSD(25_600, band=(5, 150), decibels=True), trees)
split = cross_val_score(spectrum, X, nonsense, cv=StratifiedKFold(3, shuffle=True, random_state=0)).mean()
held_out = cross_val_score(spectrum, X, nonsense, groups=groups, cv=StratifiedGroupKFold(3)).mean()
print(f"random labels: windows split {split:.2f}, assemblies held out {held_out:.2f}, chance {1 / 3:.2f}")
