"""Results that the literature prints in tables."""

from __future__ import annotations

from importlib.resources import files
from typing import Any

import numpy as np
from sklearn.utils import Bunch

from cyclofeat.datasets._descr import descr

_TABLES = {
    "signal_statistics": "table4_measured_signal_statistics.csv",
    "spectral_centroid": "table5_spectral_centroid.csv",
    "spectral_entropy": "table6_shannon_spectral_entropy.csv",
}


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
    tables: dict[str, Any] = {}
    for name, file in _TABLES.items():
        with (folder / file).open(encoding="utf-8") as lines:
            tables[name] = np.genfromtxt(lines, delimiter=",", names=True, dtype=None, encoding="utf-8")
    description = descr(
        "Published statistics, centroids and entropies of torque measured on a cycloidal gearbox.",
        origin=(
            'tables 4, 5 and 6 of "Verification of the cycloidal gear train fault diagnosis methods based on '
            'measured data".'
        ),
        licence="single numbers are facts, given with their source; the articles are their publishers'.",
        units="torque in Nm, entropy in bits; the centroid's unit is not stated at the source.",
        inferred="nothing: values as printed. One recording per disc; the torque is not published.",
        more=(folder / "README.md").read_text(encoding="utf-8"),
    )
    return Bunch(**tables, DESCR=description)
