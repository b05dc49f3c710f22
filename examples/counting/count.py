"""Count the worn lobes of a recording from its file, and show a refusal; **surrogate** recordings."""

import tempfile
from pathlib import Path

from cyclofeat.counting import LobeModel
from cyclofeat.datasets import make_rig_recordings, read_recording, write_recording

known = make_rig_recordings(n_assemblies=5, defect_counts=(0, 3), rig="R1", random_state=4, with_angle=True)
model = LobeModel.train(known, n_splits=0)

(unknown,) = make_rig_recordings(
    n_assemblies=1, defect_counts=(3,), rig="R1", random_state=5, with_angle=True
)
with tempfile.TemporaryDirectory() as folder:
    write_recording(Path(folder, "unknown.npz"), unknown)
    recording = read_recording(Path(folder, "unknown.npz"))
result = model.count(recording)
print(f"{result.defect_count} worn lobes, probability {result.probability[result.defect_count]:.2f}")
print(f"at {result.lobes}, truly {recording.worn_lobes}")

backwards = model.count(recording.replace(torque=recording.torque[::-1]))
print(f"the same backwards: {'refused: ' + backwards.reason if backwards.refused else 'counted'}")
