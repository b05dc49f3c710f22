"""
Paper B, fig. 18: overlap of the scalograms' minima
===================================================

Fig. 18 marks the cells of the lowest colour that the scalogram of one to six worn lobes shares with that of
seven: at levels 3 and 4 their area grows with the count, with gaps at three and four. Of 130 wavelets only
mb32.3 was found to do so. This example shows the **surrogate** torque of this simulator, with mb32.3 and
with all of PyWavelets' discrete wavelets and the Morris family (statements B7 and B10).
"""

import matplotlib.pyplot as plt
from _papers import STEEL, graded_wavelets, minima_shared_with_seven, panels, torques

of_count = torques(STEEL)[1:]
shared, share = minima_shared_with_seven(of_count, levels=6)
axes = panels(3, "time in s", "level", size=(11, 7.5))
for count, ax in enumerate(axes.flat, 1):
    ax.imshow(~shared[count - 1], aspect="auto", cmap="gray", extent=(0, 0.6, 6.5, 0.5), interpolation="none")
    low, high = 100 * share[count - 1, 2:4]
    ax.set_title(f"{count} worn: {low:.0f} % of level 3, {high:.0f} % of level 4", fontsize="medium")
plt.show()

# %%
# The area grows at levels 3 and 4 at every step, without the paper's gaps, but mostly in the first 0.2 s,
# while drive and load still rise. Colours are relative to a row's largest value. The more lobes are worn, the
# larger that value, until the ringing of the start falls below 1/64 of it.

wavelets = graded_wavelets()
ramp = slice(0, 2000)
fig, (left, right) = plt.subplots(1, 2, figsize=(11, 4.2), layout="constrained")
for level, colour in ((3, "C0"), (4, "C1")):
    for part, style, when in (
        (slice(None), "o-", "whole record"),
        (ramp, "^:", "first 0.2 s"),
        (slice(2000, None), "s--", "after it"),
    ):
        of_part = 100 * shared[:, level - 1, part].mean(axis=-1)
        left.plot(range(1, 7), of_part, style, color=colour, label=f"level {level}, {when}")
left.set(xlabel="worn lobes", ylabel="cells shared with seven worn, %", title="mb32.3")
left.legend(fontsize="small")
graded = [name for name, rises in wavelets.items() if rises]
for name in wavelets:
    of_wavelet = minima_shared_with_seven(of_count, wavelet=name, levels=4)[1][:, 2:].mean(axis=1)
    chosen = {"color": "C1", "lw": 2, "zorder": 3} if name == "mb32.3" else {"color": "C0", "lw": 0.7}
    right.plot(range(1, 7), 100 * of_wavelet, alpha=1 if name in graded else 0.3, **chosen)
right.plot([], [], color="C1", lw=2, label="mb32.3")
right.plot([], [], color="C0", lw=0.7, label=f"the {len(graded) - 1} others that rise at both levels")
right.plot([], [], color="C0", lw=0.7, alpha=0.3, label=f"{len(wavelets) - len(graded)} that do not")
right.set(xlabel="worn lobes", title="mean of levels 3 and 4, all wavelets")
right.legend(fontsize="small")
plt.show()
print(f"{len(graded)} of {len(wavelets)} wavelets rise at every step at levels 3 and 4:")
print(*graded)

# %%
# mb32.3 has the steepest trend of all wavelets, but others rise, too: the quiet stretches are a property
# of the torque, not of that wavelet. All this requires noiseless torque and records that begin at the same
# angle of the input, ramp included; the feature :class:`~cyclofeat.features.WaveletMinimaOverlap` and paper
# A's fig. 9 show what remains otherwise.
