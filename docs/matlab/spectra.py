# Density of a worn disc's torque, and its coherence with a healthy one's.
from cyclofeat.datasets import read_recording
from cyclofeat.signal import magnitude_squared_coherence, welch_psd

healthy, worn = (read_recording("rig.mat", channel=name, speed_rpm=500) for name in ("healthy", "worn"))
fs = worn.sampling_rate

# MATLAB's defaults are the defaults here. Windows are rows: one recording, one row.
f, (pxx,) = welch_psd(worn.torque[None], fs)
_, (cxy,) = magnitude_squared_coherence(worn.torque[None], healthy.torque[None], fs)
