"""
Finding: one recording per disc gives no accuracy
=================================================

Paper A has eight discs and one recording of each: the effect of the disc cannot be separated from that of
the recording. Cut into windows, such data seem to allow a cross-validation. Here the eight discs are **all
healthy**: **surrogate** torque of eight assemblies on the assumed rig R1 has the labels 0 to 7. There is
nothing to count, and yet a classifier predicts the labels if windows of the same recording are on both
sides of the folds.
"""

import matplotlib.pyplot as plt
import numpy as np
from _papers import RIG_RATE
from sklearn.ensemble import ExtraTreesClassifier
from sklearn.model_selection import KFold, LeaveOneGroupOut, cross_val_predict

from cyclofeat.datasets import make_rig_recordings
from cyclofeat.features import WelchPSD

N_WINDOWS = 6  # of 0.45 s in each recording
recordings = make_rig_recordings(16, [0], rig="R1", duration=0.45 * N_WINDOWS, random_state=3)
X = np.concatenate([recording.torque.reshape(N_WINDOWS, -1) for recording in recordings])
number = np.repeat(np.arange(16), N_WINDOWS)
label = number % 8
densities = WelchPSD(RIG_RATE, preset="ripple", band=(0, 1500), decibels=True).fit_transform(X)
trees = ExtraTreesClassifier(200, random_state=0)

one_each = number < 8
shuffled = cross_val_predict(
    trees, densities[one_each], label[one_each], cv=KFold(4, shuffle=True, random_state=0)
)
# Two assemblies per label: one for training, one for testing.
held_out = cross_val_predict(trees, densities, label, groups=number // 8, cv=LeaveOneGroupOut())

fig, axes = plt.subplots(1, 2, figsize=(10, 4.9), layout="constrained", sharey=True)
for ax, truth, guess, title in (
    (axes[0], label[one_each], shuffled, "one recording per label, windows shuffled"),
    (axes[1], label, held_out, "two recordings per label, one held out"),
):
    cells = np.zeros((8, 8))
    np.add.at(cells, (truth, guess), 1)
    ax.imshow(cells / cells.sum(axis=1, keepdims=True), cmap="gray_r", vmin=0, vmax=1)
    ax.set(
        title=f"{title}\naccuracy {np.mean(truth == guess):.2f}", xlabel="predicted label", xticks=range(8)
    )
axes[0].set(ylabel="label of the (healthy) disc", yticks=range(8))
plt.show()

# %%
# Each assembly has its own pins and contacts, and a spectrum that is good enough to show wear shows them,
# too. With one recording per disc the only valid folds leave a class without training data. An evaluation
# needs several assemblies of every count, and folds by assembly, as everywhere in this toolkit
# (:func:`~cyclofeat.counting.evaluate` requires groups).
