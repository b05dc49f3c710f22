"""
An ML engineer's pipeline: features, fair folds, calibration, export
====================================================================

You know scikit-learn and want to know whether a pipeline of yours counts worn lobes. We cut recordings into
windows, see why shuffled folds mislead here, compare four pipelines on the same folds, calibrate the best
one, and store it in a file that runs no code when it is loaded.

You need ``pip install -e ".[export,plot]"``. The torque is **surrogate**: simulated on the assumed
rig R1.
"""

import json
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from sklearn.ensemble import ExtraTreesClassifier
from sklearn.model_selection import StratifiedKFold, cross_val_score
from sklearn.pipeline import make_pipeline

from cyclofeat import Windower
from cyclofeat.counting import GroupCalibratedCounter, Protocol, evaluate
from cyclofeat.datasets import make_rig_recordings
from cyclofeat.features import LobeMap, SpectralEntropy, TorqueStatistics, WelchPSD
from cyclofeat.models import load_model, save_model
from cyclofeat.simulators import Noise, Rig

# %%
# Windows, labels, groups
# -----------------------
# Twelve assemblies for each of four counts, two windows of one output turn from each. ``X`` has one window
# per row, ``y`` the number of worn lobes, and ``groups`` the assembly: a gearbox as it was put
# together, with its own pins, friction and load.

rig = Rig.r1().with_effects(Noise(1.0))
recordings = make_rig_recordings(
    12, (0, 1, 3, 5), rig=rig, duration=3.6, random_state=3, n_jobs=2, kernel="auto"
)
rate = recordings[0].sampling_rate
X, y, groups = Windower(output_turns=1).transform(recordings)
print(X.shape, np.unique(y), len(set(groups)), "assemblies")

# %%
# Why the folds must be grouped
# -----------------------------
# Give the assemblies random labels, so that there is nothing to learn. Shuffled folds still score far above
# chance, because one window of an assembly is in the training data and its twin in the test. ``evaluate``
# always holds whole assemblies out, and is an error without ``groups``.

trees = ExtraTreesClassifier(100, random_state=0)
spectrum = make_pipeline(WelchPSD(rate, band=(5, 150), decibels=True), trees)
random = np.random.default_rng(0).permutation(y[::2])  # one label for both windows of an assembly
nonsense = np.repeat(random, 2)
shuffled = cross_val_score(spectrum, X, nonsense, cv=StratifiedKFold(3, shuffle=True, random_state=0))
protocol = Protocol(n_splits=3, random_state=0)
grouped = evaluate(spectrum, X, nonsense, groups, protocol=protocol)
print(
    f"random labels, chance 0.25: shuffled folds {shuffled.mean():.2f}, grouped folds {grouped.accuracy:.2f}"
)

# %%
# Four pipelines on the same folds
# --------------------------------
# Each feature of the papers is a transformer, so a pipeline takes one line. The intervals are bootstraps over
# assemblies: 48 assemblies carry less information than 96 windows.

pipelines = {
    "Shannon entropy (papers)": make_pipeline(SpectralEntropy(rate), trees),
    "torque statistics": make_pipeline(TorqueStatistics(rate), trees),
    "power spectrum": spectrum,
    "lobe map": make_pipeline(LobeMap(rate), trees),
}
results = {name: evaluate(counter, X, y, groups, protocol=protocol) for name, counter in pipelines.items()}

figure, ax = plt.subplots(figsize=(8, 4.2), layout="constrained")
for name, result in results.items():
    low, high = result.accuracy_interval
    ax.plot([low, high], [name, name], color="C0", linewidth=6, alpha=0.3, solid_capstyle="butt")
    ax.plot(result.accuracy, name, "o", color="C0")
    print(f"{name:25} {result}")
ax.axvline(0.25, color="grey", linestyle="--", linewidth=1)
ax.text(0.26, 0.4, "chance", color="grey")
ax.margins(y=0.1)
ax.set(xlim=(0, 1.02), xlabel="share of windows counted right, whole assemblies held out (95 % interval)")
ax.set_title("Spectral lines count worn lobes, the size of the ripple does not")
plt.show()

# %%
# Probabilities that are right as often as they say
# -------------------------------------------------
# A forest is too modest about easy windows and too sure about hard ones. ``GroupCalibratedCounter`` learns
# one number, a temperature, from held-out assemblies of the training data. It never changes the count. The
# calibration error is the mean distance between the probability and the share that is right.

counter = make_pipeline(LobeMap(rate), trees)
calibrated = GroupCalibratedCounter(counter, n_splits=3)
after = evaluate(calibrated, X, y, groups, protocol=protocol)
before = results["lobe map"]

figure, ax = plt.subplots(figsize=(5.6, 4.6), layout="constrained")
bins = np.linspace(0.3, 1, 36)
for result, name in ((before, "forest alone"), (after, "calibrated")):
    label = f"{name}: calibration error {result.calibration_error:.2f}"
    ax.hist(result.probabilities.max(axis=1), bins, alpha=0.6, label=label)
ax.set(xlabel="probability of the predicted count", ylabel="windows")
ax.set_title(f"{before.accuracy:.0%} are right: the forest is too modest")
ax.legend()
plt.show()

# %%
# Export
# ------
# Fit to all data and save. A ``.skops`` file holds no code; the card beside it is readable text with classes,
# sampling rate, features and versions. A model whose features have another definition is refused when it is
# loaded.

calibrated.fit(X, y, groups=groups)
with tempfile.TemporaryDirectory() as folder:
    path = save_model(Path(folder, "counter.skops"), calibrated, assemblies=set(groups), scores=after)
    loaded, card = load_model(path), json.loads(path.with_name("counter.skops.card.json").read_text())
print(f"counts {card['classes']} at {card['sampling_rate']:g} Hz, windows of {card['window_s']:g} s")
print(f"features: {card['features']['definitions']}, accuracy {card['scores']['accuracy']:.2f}")
print("same answers:", np.array_equal(loaded.predict(X), calibrated.predict(X)))
