"""Write a counter to a file that is safe to load, with its card, and load it; **surrogate** recordings."""

import tempfile
from pathlib import Path

from cyclofeat import Windower
from cyclofeat.counting import GroupCalibratedCounter, make_lobe_counter
from cyclofeat.datasets import make_rig_recordings
from cyclofeat.models import load_model, read_card, save_model

recordings = make_rig_recordings(n_assemblies=4, defect_counts=(0, 3), rig="R1", random_state=3)
windows = Windower().windows(recordings)
counter = GroupCalibratedCounter(make_lobe_counter(windows.sampling_rate, kind="ordinal"))
counter.fit(windows.X, windows.y, groups=windows.groups)

with tempfile.TemporaryDirectory() as folder:
    # A .joblib file is a pickle, which can run code: load_model requires trusted=True for it.
    file = save_model(Path(folder, "counter.skops"), counter, assemblies=set(windows.groups))
    loaded = load_model(file)
    card = read_card(file)
print(f"{card['window_s']:g} s at {card['sampling_rate']:g} Hz, counts {card['classes']}")
print(f"features: {card['features']['definitions']}")
print("as before:", (loaded.predict(windows.X) == counter.predict(windows.X)).all())
