"""
A high-pass filter removes drift and keeps the effect of wear
=============================================================

Does removing slow drift help? Paper A (section 2) tried high-pass filters at 0.5, 1, 10 and 50 Hz on
measured torque and rejected them: low frequencies mattered more there than in simulation.
:class:`~cyclofeat.features.HighPass` precedes any other transformer in a pipeline. **Surrogate** torque of
a healthy disc and one with three worn lobes, on the assumed rig R1.
"""

import matplotlib.pyplot as plt
import numpy as np
from _surrogates import SAMPLING_RATE, surrogate_windows

from cyclofeat.features import HighPass

X, y, _ = surrogate_windows(n_assemblies=1, counts=(0, 3))
time = np.arange(X.shape[1]) / SAMPLING_RATE

fig, axes = plt.subplots(5, 2, figsize=(10, 8), layout="constrained", sharex=True, sharey=True)
for row, cutoff in zip(axes, (None, 0.5, 1.0, 10.0, 50.0), strict=True):
    filtered = X if cutoff is None else HighPass(SAMPLING_RATE, cutoff_hz=cutoff).fit_transform(X)
    for ax, torque, count in zip(row, filtered, y, strict=True):
        ax.plot(time, torque - torque.mean(), lw=0.5, color="black")
        ax.set_title(f"{count} worn, std {torque.std():.2f} Nm", fontsize="medium")
    row[0].set_ylabel("no filter\nNm about mean" if cutoff is None else f"{cutoff:g} Hz\nNm about mean")
for ax in axes[-1]:
    ax.set_xlabel("time in s")
plt.show()

# %%
# Half of the healthy torque's variance is drift, which 10 Hz removes. The effect of wear remains, because
# on this rig it excites the resonance near 80 Hz. A cut-off of 50 Hz preserves the ringing and removes the
# lines of lobe and shaft (8.9 and 8.3 Hz). Near both ends of a window the filter is less accurate, over
# about one period of the cut-off; with 0.5 Hz this is the whole window of 1.8 s.
