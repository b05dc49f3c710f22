"""Published tables and measured data of others, with their origin, licence and units."""

from __future__ import annotations

import math
import os
from importlib.resources import as_file, files
from pathlib import Path

import numpy as np
from sklearn.utils import Bunch

from cyclofeat.datasets.readers._binary import load_arrays
from cyclofeat.datasets.readers._read import file_path

_TABLES = {
    "signal_statistics": "table4_measured_signal_statistics.csv",
    "spectral_centroid": "table5_spectral_centroid.csv",
    "spectral_entropy": "table6_shannon_spectral_entropy.csv",
}
_DESIGNS = ("baseline", "split_pinwheel", "conic_disk")
_FOLDER = Path(__file__).parent / "oedi_gearbox"
_MINI = "oedi_gearbox_mini_8192.npz"
_URL = "https://data.openei.org/submissions/623"
_LABELS = ("recording", "broken_tooth", "load_percent", "channels", "fs_inferred_hz")


def load_published_tables() -> Bunch:
    """Load published statistics, centroids and entropies of measured torque, for 0 to 7 worn lobes.

    Returns
    -------
    sklearn.utils.Bunch
        Three structured arrays of shape (8,), one row per disc, all with the field ``defect_count`` (0 to 7):

        signal_statistics : table 4
            ``min_nm``, ``max_nm``, ``mean_nm``, ``std_nm``, ``range_nm`` of the output torque in Nm.
        spectral_centroid : table 5
            ``centroid`` (unit not stated at the source).
        spectral_entropy : table 6
            ``entropy_bits``: Shannon entropy of the power spectral density, in bits.

        DESCR : str
            Origin, licence, units and what is inferred.

    Notes
    -----
    From "Verification of the cycloidal gear train fault diagnosis methods based on measured data". With one
    recording per disc, these numbers allow comparisons but no estimate of accuracy.

    Examples
    --------
    >>> tables = load_published_tables()
    >>> tables.signal_statistics["std_nm"][:3].tolist()
    [2.912, 4.964, 4.557]
    >>> tables.spectral_entropy["entropy_bits"].argmin().item()
    0
    """
    folder = files(__package__) / "tables"
    tables = {}
    for name, file in _TABLES.items():
        with (folder / file).open(encoding="utf-8") as lines:
            tables[name] = np.genfromtxt(lines, delimiter=",", names=True, dtype=None, encoding="utf-8")
    return Bunch(**tables, DESCR=_read_description("tables"))


def load_jelmerv_cycloidal() -> Bunch:
    """Load measured torque-deflection loops of three printed cycloidal drives, their run-in and geometry.

    The output was locked while the motor's torque went slowly up and down. The loops show the play, stiffness
    and friction of a real cycloidal drive, without lobe faults.

    Returns
    -------
    sklearn.utils.Bunch
        loops : list of Bunch
            28 averaged loops, each with ``kind`` ("play": about 4 Nm, "stiffness": 25 to 40 Nm), ``design``
            ("baseline", "split_pinwheel", "conic_disk"), ``state`` ("initial", "after_runin" or "preload1"
            to "preload8"), ``name`` (of the array), and of motor and encoder, referred to the output,
            ``torque`` (n,) in Nm and ``deflection`` (n,) in rad.
        run_in : list of Bunch
            Three records with ``design``, ``time`` (n,) in s, not evenly spaced, and ``torque`` (n,) in Nm.
        geometry : Bunch
            ``n_pins``, ``n_lobes``, ``n_output_rollers`` and, in m, ``pin_radius``, ``pin_circle_radius``,
            ``eccentricity``, ``clearance``, ``output_roller_radius``, ``output_roller_circle_radius``,
            ``disc_thickness``.
        DESCR : str
            Origin, licence (CC BY-SA 4.0, unlike the code's), units and what is inferred.

    Notes
    -----
    Torque is estimated from the motor's current, and all curves were read back from the source's figures:
    their points are not evenly spaced.

    Examples
    --------
    >>> data = load_jelmerv_cycloidal()
    >>> loop = next(loop for loop in data.loops if loop.name == "stiffness_baseline_initial")
    >>> loop.torque.shape == loop.deflection.shape, round(float(loop.torque.max()))
    (True, 25)
    """
    folder = files(__package__) / "jelmerv_cycloidal"
    with (
        as_file(folder / "jelmerv_cycloidal_curves.npz") as path,
        np.load(path, allow_pickle=False) as archive,
    ):
        arrays = {name: archive[name].astype(np.float64) for name in archive.files}
    loops: list[Bunch] = []
    run_in: list[Bunch] = []
    for name, array in arrays.items():
        kind, _, rest = name.removeprefix("runin_").partition("_")
        design = next(design for design in _DESIGNS if rest.startswith(design))
        if kind == "torque":
            run_in.append(Bunch(design=design, time=array[:, 0] * 60, torque=array[:, 1]))
        else:
            labels = {"kind": kind, "design": design, "state": rest.removeprefix(f"{design}_"), "name": name}
            loops.append(Bunch(**labels, torque=array[:, 0], deflection=array[:, 1] * (math.pi / 180)))
    geometry = Bunch(
        n_pins=14, n_lobes=13, pin_radius=3.5e-3, pin_circle_radius=34e-3, eccentricity=1.5e-3,
        clearance=0.05e-3, n_output_rollers=8, output_roller_radius=9e-3,
        output_roller_circle_radius=20e-3, disc_thickness=25e-3,
    )  # fmt: skip
    return Bunch(loops=loops, run_in=run_in, geometry=geometry, DESCR=_read_description("jelmerv_cycloidal"))


def load_oedi_gearbox(path: str | os.PathLike[str] | None = None) -> Bunch:
    """Load measured vibration of a two-stage gearbox: two health states at ten load levels.

    Real signals to try features on; they hold no torque, and the gearbox is not cycloidal.

    Parameters
    ----------
    path : path, optional
        NPZ file of the recordings. Default: the small extract in cyclofeat's source tree, which wheels leave
        out. It holds scaled integers (``signals_i16``, ``scale``) or plain numbers (``signals``).

    Returns
    -------
    sklearn.utils.Bunch
        signals : ndarray of shape (20, n_samples, 4), float64
            Acceleration in the unit supplied (not documented); ``n_samples`` is 8192 in the extract.
        broken_tooth, load_percent : ndarray of shape (20,), int64
            1 for the gearbox with a broken tooth, 0 for the healthy one; load level, 0 to 90 in steps of 10.
        recording_names, channel_names : list of str
            Names of the source files, e.g. "h30hz40", and of the accelerometers, "a1" to "a4".
        sampling_rate, sampling_rate_inferred : float, bool
            12800.0 Hz, and True: inferred from the mesh line, since the source does not state it.
        shaft_hz : float
            Nominal speed of the input shaft, 30 Hz; the motor's slip makes it 29.6 to 29.8 Hz.
        DESCR : str
            Origin, licence, units and what is inferred.

    Notes
    -----
    Healthy and broken are two assemblies, so separating them says little about a method. The load level
    across the two states is the better task.

    Examples
    --------
    >>> try:
    ...     data = load_oedi_gearbox()
    ... except FileNotFoundError:
    ...     pass  # outside a checkout
    ... else:
    ...     assert data.signals.shape == (20, 8192, 4)
    """
    file = _FOLDER / _MINI if path is None else file_path(path)
    if file.is_dir():
        raise ValueError(f"{file} is a directory; give an NPZ file such as {_MINI}")
    if not file.exists():
        problem = f"no such file: {file}"
        if path is None:
            problem = "the OEDI gearbox recordings are not part of an installed cyclofeat"
        raise FileNotFoundError(
            f"{problem}; an extract ({_MINI}) is in "
            "datasets/oedi_gearbox of cyclofeat's source tree, give load_oedi_gearbox(path=...); the "
            f"original recordings are at {_URL}"
        )
    arrays = load_arrays(file)
    missing = {*_LABELS, *(["signals"] if "signals" in arrays else ["signals_i16", "scale"])} - arrays.keys()
    if missing:
        raise ValueError(
            f"{file.name} must hold the arrays signals (or signals_i16 and scale), {', '.join(_LABELS)}; "
            f"missing: {', '.join(sorted(missing))}"
        )
    # Acceleration as supplied, shape (n_recordings, n_samples, n_channels).
    if "signals" in arrays:
        signals = arrays["signals"].astype(np.float64)
    else:
        # float32 as printed: 0.004, not 0.0040000001899898052
        signals = arrays["signals_i16"] * float(str(arrays["scale"].reshape(())))
    n_recordings, n_channels = arrays["recording"].size, arrays["channels"].size
    if signals.ndim != 3 or signals.shape[::2] != (n_recordings, n_channels):
        raise ValueError(
            f"{file.name}: signals must have shape ({n_recordings}, n_samples, {n_channels}) for "
            f"{n_recordings} recordings of {n_channels} channels, got {signals.shape}"
        )
    return Bunch(
        signals=signals,
        broken_tooth=arrays["broken_tooth"].astype(np.int64),
        load_percent=arrays["load_percent"].astype(np.int64),
        recording_names=arrays["recording"].tolist(),
        channel_names=arrays["channels"].tolist(),
        sampling_rate=float(arrays["fs_inferred_hz"]),
        sampling_rate_inferred=True,
        shaft_hz=30.0,
        DESCR=_read_description("oedi_gearbox"),
    )


def _read_description(folder: str) -> str:
    """Return origin, licence, units and what is inferred, as stated beside the data of a folder."""
    texts = [files(__package__) / folder / name for name in ("README.md", "LICENSE.md")]
    return "\n".join(text.read_text(encoding="utf-8") for text in texts if text.is_file())
