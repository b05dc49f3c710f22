"""Registry of features: name, unit, formula, source and version of each.

The name of a column is made of its row and of the definition behind the number::

    shannon_entropy_bits(matlab_pwelch;0..1500Hz)
    ^ name          ^ unit  ^ qualifiers, separated by semicolons

The unit is left out for pure numbers and the parentheses where there is nothing to state. Commas, colons,
quotes, spaces and square or curly brackets do not occur: XGBoost, LightGBM and plain CSV files choke on them.
A name is a promise. Changing a formula means raising the row's ``version``, which then appears as a last
qualifier (``v2``), so that a stored model never meets a new definition under an old name.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Feature:
    """One row of the registry: unique name in snake case, without unit; unit, formula in plain text, source.

    Units are ``"Nm"``, ``"Nm^2"``, ``"Nm^2/Hz"``, ``"Hz"``, ``"bit"``, ``"dB"`` or ``"1"`` for a pure number;
    ``version`` is that of the definition.
    """

    name: str
    unit: str
    formula: str
    source: str
    version: int = 1

    def column(self, *qualifiers: str) -> str:
        """Return the name of the feature's column; qualifiers are preset, band, lobe, level and the like.

        Examples
        --------
        >>> REGISTRY["shannon_entropy"].column("ripple")
        'shannon_entropy_bits(ripple)'
        """
        if self.version > 1:
            qualifiers = (*qualifiers, f"v{self.version}")
        stated = f"({';'.join(qualifiers)})" if qualifiers else ""
        unit = "_" + self.unit.lower().replace("^", "").replace("/", "_per_").replace("bit", "bits")
        return f"{self.name}{unit if self.unit != '1' else ''}{stated}"


def label_qualifier(label: object) -> str:
    """Return the label of a class as a qualifier; labels may hold what names may not."""
    return re.sub(r"[^\w.+-]", "_", str(label), flags=re.ASCII)


def band_qualifier(band: tuple[float, float]) -> str:
    """Return a band in Hz as a qualifier, such as ``0..1500Hz``."""
    return "{:.12g}..{:.12g}Hz".format(*band)


_ROWS: tuple[Any, ...] = (
    ("torque_min", "Nm", "min(x)", "paper A table 4"),
    ("torque_max", "Nm", "max(x)", "paper A table 4"),
    ("torque_mean", "Nm", "sum(x) / n", "paper A table 4"),
    ("torque_std", "Nm", "sqrt(sum((x - mean)^2) / (n - 1))", "paper A table 4, MATLAB std"),
    ("torque_range", "Nm", "max(x) - min(x)", "paper A table 4"),
    ("torque_rms", "Nm", "sqrt(sum(x^2) / n)", "standard definition"),
    ("torque_crest_factor", "1", "max(abs(x)) / rms", "standard definition"),
    ("torque_skewness", "1", "m3 / m2^(3/2), mk = sum((x - mean)^k) / n", "MATLAB skewness"),
    ("torque_kurtosis", "1", "m4 / m2^2, mk = sum((x - mean)^k) / n", "MATLAB kurtosis"),
    ("torque_ripple", "1", "std / abs(mean)", "standard definition"),
    ("shannon_entropy", "bit", "-sum(p log2(p)), p = psd / sum(psd)", "paper A eq. 8"),
    ("normalized_entropy", "1", "-sum(p log2(p + 2^-52)) / log2(N), p = psd / sum(psd)",
        "paper A eq. 4-7, epsilon assumed"),
    ("spectral_flatness", "1", "N exp(sum(log(p)) / N), p = psd / sum(psd)", "paper A eq. 9, log domain"),
    ("spectral_centroid", "Hz", "sum(f psd) / sum(psd)", "paper A 5.4"),
    ("spectral_rolloff", "Hz", "min f with cumsum(psd) >= fraction sum(psd)", "paper A 5.4"),
    ("narrowband_ratio", "1", "sum(psd within half a width of n f0 and nearest to it) / sum(psd)",
        "paper A 5.5, width assumed"),
    ("band_power", "Nm^2", "df sum(psd in the band)", "standard definition"),
    ("psd", "Nm^2/Hz", "Welch's density, one-sided", "paper A 5.3, MATLAB pwelch"),
    ("psd_level", "dB", "10 log10(max(psd, 1e-30)), psd in Nm^2/Hz", "paper A 5.3, MATLAB pwelch"),
    ("amplitude", "Nm", "c sqrt(mean over blocks(|dft(w x)|^2)) / sum(w)", "paper B 6, average assumed"),
    ("coherence", "1", "median over references(mean in the band(|Sxr|^2 / (Sxx Srr)))",
        "paper A 5.2, paper B 5, MATLAB mscohere"),
    ("order_amplitude", "Nm", "2 |mean(x exp(-2 pi i f k t))| over whole turns, f refined",
        "cyclofeat.signal.orders", 2),
    ("lobe_slot_mean", "1", "mean of the whitened, folded torque in a slot", "cyclofeat.signal.lobes", 2),
    ("lobe_slot_rms", "1", "std of the whitened, folded torque in a slot", "cyclofeat.signal.lobes", 2),
    ("lobe_line_prominence", "dB", "10 log10(|c_k|^2 / floor_k + 0.001)", "cyclofeat.signal.lobes", 2),
    ("lobe_line_contrast", "dB", "10 log10(|c_k|^2 / mean(|c_(k-2..k+2)|^2) + 0.001)",
        "cyclofeat.signal.lobes", 2),
    ("minima_overlap", "1",
        "median over the reference of: cells of a level with the lowest colour in both / cells",
        "paper B section 7, paper A 5.1", 2),
    ("wavelet_envelope_mean", "Nm", "mean(abs(analytic signal of the level that holds the mesh))",
        "paper A 5.1"),
    ("wavelet_envelope_line", "Nm",
        "largest Hann amplitude of that envelope within the speed tolerance of a harmonic", "paper A 5.1"),
    ("wavelet_rms", "Nm", "sqrt(mean(c^2) / 2^level) over cells", "paper B figs. 10-12"),
    ("wavelet_energy_share", "1", "rms^2 / sum over levels(rms^2)", "paper B figs. 10-12"),
    ("wavelet_kurtosis", "1", "m4 / m2^2, mk = mean((c - mean)^k) over cells", "standard definition"),
    ("wavelet_lowest_colour", "1", "cells of a level with the lowest colour / cells", "paper B figs. 10-12"),
)  # fmt: skip

REGISTRY: Mapping[str, Feature] = {row[0]: Feature(*row) for row in _ROWS}
"""Rows by name."""
