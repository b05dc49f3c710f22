"""
Ripple grows with wear, but assemblies differ as much
=====================================================

Paper A's table 4 states mean, standard deviation and range of the measured torque, one recording per disc.
:class:`~cyclofeat.features.TorqueStatistics` gives these and seven more. Here they are of **surrogate**
(simulated) torque: six assemblies for each number of worn lobes, on the assumed rig R1.
"""

import matplotlib.pyplot as plt
from _surrogates import SAMPLING_RATE, dots_by_count, surrogate_windows

from cyclofeat.datasets import load_published_tables
from cyclofeat.features import TorqueStatistics

X, y, _ = surrogate_windows(n_assemblies=6)
transformer = TorqueStatistics(sampling_rate=SAMPLING_RATE).fit(X)
features = dict(zip(transformer.get_feature_names_out(), transformer.transform(X).T, strict=True))

# %%
# The crosses are the papers' measured values. They share the axes, not the source: the rig is assumed.

published = load_published_tables().signal_statistics
shown = {
    "torque_mean_nm": ("mean", "Nm", "mean_nm"),
    "torque_std_nm": ("standard deviation", "Nm", "std_nm"),
    "torque_range_nm": ("range", "Nm", "range_nm"),
    "torque_crest_factor": ("crest factor", "pure number", None),
    "torque_kurtosis": ("kurtosis", "pure number", None),
    "torque_ripple": ("ripple (std / mean)", "pure number", None),
}
fig, axes = plt.subplots(2, 3, figsize=(10, 6), layout="constrained")
for ax, (name, (title, unit, column)) in zip(axes.flat, shown.items(), strict=True):
    dots_by_count(ax, y, features[name], title, unit)
    if column is not None:
        ax.plot(published["defect_count"], published[column], "x", color="black", label="measured (paper A)")
axes[0, 0].plot([], [], "o-", color="C0", label="surrogate, and mean")
fig.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=2)
plt.show()

# %%
# With a brake behind the torque meter, standard deviation and range grow with the number of worn lobes on
# average, but assemblies of one count differ by as much as several counts, because all of them have slow
# drift of 3 Nm rms. The measured standard deviation behaves differently: it jumps from the healthy disc to
# one worn lobe and tends to fall from there on. One recording per disc cannot show whether wear or another
# difference between the discs causes this. The mean is the load and contains no information about wear.
