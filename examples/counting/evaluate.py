"""Evaluate counters on **surrogate** recordings: whole assemblies held out, sets of counts and refusals.

Windows of one assembly are not independent, so they are never on both sides of a fold.
"""

from cyclofeat import Windower
from cyclofeat.counting import ConformalCounter, Protocol, evaluate, make_lobe_counter, score_text
from cyclofeat.datasets import make_rig_recordings

recordings = make_rig_recordings(n_assemblies=6, defect_counts=(0, 3), rig="R1", random_state=2)
windows = Windower().windows(recordings)
rate = windows.sampling_rate

counters = {
    "lobe map": make_lobe_counter(rate, n_trees=100),
    "the papers' entropy ladder": make_lobe_counter(rate, kind="ladder"),
    "sets of counts": ConformalCounter(make_lobe_counter(rate, n_trees=100), coverage=0.75),
}
for name, counter in counters.items():
    result = evaluate(counter, windows.X, windows.y, windows.groups, protocol=Protocol(n_splits=3))
    print(f"{name}: {score_text(result.to_dict())}")
