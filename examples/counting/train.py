"""Train a model on **surrogate** recordings and print its scores.

The script uses few assemblies so that it runs in a minute; a model for use needs 100 or more of each count.
"""

from cyclofeat.counting import LobeModel
from cyclofeat.datasets import make_rig_recordings

recordings = make_rig_recordings(
    n_assemblies=5, defect_counts=(0, 3), rig="R1", duration=3.6, random_state=1, with_angle=True
)
model = LobeModel.train(recordings, description="surrogates of rig R1, two windows each")

scores = model.card["cross_validation"]
print(f"accuracy of one window, whole assemblies held out: {scores['accuracy']:.2f}")
print("95 % interval: {:.2f} to {:.2f}".format(*scores["accuracy_interval"]))
print(f"locates lobes: {model.locator is not None}")
