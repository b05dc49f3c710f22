"""Draw the figure of the page for users of MATLAB: ``python docs/matlab/draw.py`` (needs GNU Octave).

Octave runs ``spectra.m`` and Python ``spectra.py`` on the same file.
Both must agree before the figure is drawn.
"""

from __future__ import annotations

import contextlib
import runpy
import shutil
import subprocess
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from scipy.io import loadmat, savemat

from cyclofeat.datasets import make_rig_recordings

HERE = Path(__file__).resolve().parent
RESULTS = ("f", "pxx", "cxy")


def run_both(folder: Path) -> dict[str, dict[str, np.ndarray]]:
    """Run both scripts in a folder with a recording each of a healthy and a worn disc."""
    healthy, worn = make_rig_recordings(1, (0, 3), rig="R1", duration=1.8, random_state=1)
    columns = {"healthy": healthy.torque[:, None], "worn": worn.torque[:, None]}
    savemat(folder / "rig.mat", {**columns, "fs": worn.sampling_rate})
    octave = shutil.which("octave-cli") or "octave"
    script = str(HERE / "spectra.m")
    subprocess.run([octave, "--no-gui", "--no-init-file", "--quiet", script], cwd=folder, check=True)
    answers = loadmat(folder / "spectra.mat", squeeze_me=True)
    with contextlib.chdir(folder):
        ours = runpy.run_path(str(HERE / "spectra.py"))
    return {
        "GNU Octave": {name: answers[name] for name in RESULTS},
        "Python, cyclofeat": {name: ours[name] for name in RESULTS},
    }


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        of_program = run_both(Path(folder))
    octave, ours = of_program.values()
    for name in RESULTS:
        np.testing.assert_allclose(ours[name], octave[name], rtol=1e-9, atol=1e-12, err_msg=name)
    figure, axes = plt.subplots(2, 2, figsize=(10, 5.6), layout="constrained", sharex=True, sharey="row")
    for column, (program, result) in zip(axes.T, of_program.items(), strict=True):
        density, coherence = column
        density.plot(result["f"], 10 * np.log10(result["pxx"]), linewidth=1)
        coherence.plot(result["f"], result["cxy"], linewidth=1)
        density.set_title(program, fontweight="bold")
        coherence.set(xlabel="frequency (Hz)", xlim=(0, 400), ylim=(0, 1.02))
    axes[0, 0].set(ylabel="pwelch (dB over 1 Nm²/Hz)", ylim=(-60, 30))
    axes[1, 0].set_ylabel("mscohere")
    figure.savefig(HERE.parent / "figures" / "matlab.png", dpi=110)


if __name__ == "__main__":
    main()
