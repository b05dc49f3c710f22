"""
A rig engineer's Monday: count, and decide when the model refuses
=================================================================

You run the test bench. Over the weekend it wrote three files, one per gearbox, and you want to know which
discs are worn. We look into the files, train a model, count, and then deal with the files that the model
refuses.

The commands are those of the terminal. In Jupyter you would write ``!cyclofeat inspect ...``; here a small
function runs them, so that the page can show what they print. You need
``pip install -e ".[export,report]"``. The torque is **surrogate**: simulated on the assumed rig R1.
"""

import contextlib
import shlex
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from cyclofeat.cli import main
from cyclofeat.datasets import make_rig_recordings, read_recording
from cyclofeat.models import load_model
from cyclofeat.plotting import SpectrumDisplay, TrainingDisplay
from cyclofeat.simulators import CycloidalGearbox, Rig

desk = Path(tempfile.mkdtemp())


def run(line):
    print("$", line)
    with contextlib.chdir(desk):
        main(shlex.split(line)[1:])


# %%
# What the bench wrote
# --------------------
# Three CSV files with a column of time and one of torque, 3.9 s each at 25.6 kHz. With your own files, skip
# this cell. Remember for later: disc_a is healthy and disc_b has three worn lobes. disc_c has three as well,
# but somebody left the inverter at 460 RPM.

slow = Rig(CycloidalGearbox.steel(input_speed=460 * 2 * np.pi / 60), Rig.r1().effects, name="R1 at 460 RPM")
bench = {"disc_a": ("R1", 0), "disc_b": ("R1", 3), "disc_c": (slow, 3)}
for seed, (name, (rig, worn)) in enumerate(bench.items(), start=21):
    (recording,) = make_rig_recordings(1, [worn], rig=rig, duration=3.9, random_state=seed)
    time = np.arange(recording.n_samples) / recording.sampling_rate
    np.savetxt(
        desk / f"{name}.csv",
        np.column_stack([time, recording.torque]),
        fmt="%.7g",
        delimiter=";",
        header="time [s];torque [Nm]",
        comments="",
    )

# %%
# Look before you count
# ---------------------
# ``inspect`` reads the files as ``count`` will. Check three things: the range of the torque (a wrong scale
# shows here), the speed, and the length in output turns. One turn is enough for a count; two are better.

run("cyclofeat inspect disc_a.csv disc_b.csv disc_c.csv --speed 500")

# %%
# A model for this bench
# ----------------------
# The counter learns from simulated assemblies. This is a small model, so that the page builds quickly: four
# counts, six assemblies of each. For real use drop ``--assemblies`` and ``--max-count``, and describe your
# rig in a file (``--rig mine.json``). The accuracy that is printed holds whole assemblies out: no assembly
# is both in training and in test.

run("cyclofeat train --rig r1 --assemblies 6 --max-count 3 --jobs 2 --out model.skops")

# %%
# Count
# -----
# ``--report count.html`` would write the same as a page to send by mail.

run("cyclofeat count disc_a.csv disc_b.csv disc_c.csv --speed 500 --model model.skops")

# %%
# When the model refuses
# ----------------------
# Two files are refused. A refusal is an answer: *this recording is unlike everything that I have
# learned from, do not trust my count*. With ``--strict`` the exit code is 3, and in
# ``--json`` its ``defect_count`` is null.
#
# The reason tells where to look: the speed. At 500 RPM lobes pass 8.89 times per second, and the lobe lines
# are the multiples of that frequency. In disc_c they stand elsewhere: three lobes are worn, and the count
# without the refusal would have been 0. The healthy disc_a has hardly any lines; without a tachometer its
# speed cannot be told.

worn, refused = (read_recording(desk / f"disc_{letter}.csv", speed_rpm=500) for letter in "bc")
figure, (above, below) = plt.subplots(2, 1, figsize=(8, 7), layout="constrained")
for recording, label in ((worn, "disc_b, counted"), (refused, "disc_c, refused")):
    spectrum = SpectrumDisplay(recording)
    above.plot(spectrum.frequencies, spectrum.values, label=label)
above.set(xlim=(5, 55), yscale="log", xlabel="frequency (Hz)", ylabel="amplitude (Nm)")
above.set_title("The lines of disc_c lie 8 % lower")
above.legend()
display = TrainingDisplay(load_model(desk / "model.skops"), worn)
display.plot(below, kind="lobe_slot_rms", counts=(3, 2))
below.set_title("disc_b is as rough, lobe by lobe, as discs of three worn lobes", pad=40)
plt.show()

# %%
# What to do about it
# -------------------
# ================================  ====================================================================
# the refusal says                  do this
# ================================  ====================================================================
# other speed                       correct ``--speed`` or the inverter, record again with a tachometer, or
#                                   train at the speeds of your rig (``cyclofeat train --speeds 100:1500``)
# unlike all training data          compare with the other recordings of the bench: a new coupling, brake
#                                   or torque meter is not in the training rig. Describe it in the rig's
#                                   file and train again, or let ``cyclofeat gap`` find what is missing
# and the discs are known           train on your own labelled recordings:
#                                   ``cyclofeat train measured/ --out model.skops``
# ================================  ====================================================================
#
# Never lower the bar until the file passes. In this case the inverter is set back to 500 RPM, and both
# discs are recorded again on Tuesday, with a tachometer:

for name, worn in (("disc_a", 0), ("disc_c", 3)):
    (recording,) = make_rig_recordings(1, [worn], rig="R1", duration=3.9, random_state=9, with_angle=True)
    rate = recording.sampling_rate
    np.savez(desk / f"{name}.npz", torque=recording.torque, sampling_rate=rate, angle=recording.angle)
run("cyclofeat count disc_a.npz disc_c.npz --speed 500 --model model.skops")
