"""Write a counter to a file that is safe to load, with its card, and load it; **surrogate** recordings."""

import tempfile
from pathlib import Path

from cyclofeat import Windower
from cyclofeat.counting import make_lobe_counter
from cyclofeat.datasets import make_rig_recordings
from cyclofeat.persistence import load_model, read_card, save_model

recordings = make_rig_recordings(n_assemblies=4, defect_counts=(0, 3), rig="R1", random_state=3)
windows = Windower().windows(recordings)
counter = make_lobe_counter(windows.sampling_rate, kind="ordinal", calibrated=True)
counter.fit(windows.X, windows.y, groups=windows.groups)

with tempfile.TemporaryDirectory() as folder:
    # .joblib would be a pickle: code, which load_model takes with trusted=True only
    file = save_model(Path(folder, "counter.skops"), counter, assemblies=set(windows.groups))
    loaded = load_model(file)
    card = read_card(file)
print(f"{card['window_s']:g} s at {card['sampling_rate']:g} Hz, counts {card['classes']}")
print(f"features: {card['features']['definitions']}")
print("as before:", (loaded.predict(windows.X) == counter.predict(windows.X)).all())
