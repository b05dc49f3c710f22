"""Searches over many definitions of a feature, with what a search owes: how often chance alone finds as much.

Both searches of the papers are here: :func:`scan_wavelets` (paper B section 5 tried 130 wavelets) and
:func:`find_monotone_bands` (paper A fig. 19 shows the bands in which entropy falls with the count). Among
many wavelets, levels and bands some always follow the count, so every result carries a p-value by permutation
of the counts among assemblies. Where each disc was recorded once, class and recording are one thing: a split
of such data can tell recordings apart, not counts.
"""

from cyclofeat._band_scan import MonotoneBands, find_monotone_bands
from cyclofeat._wavelet_scan import WaveletRow, WaveletScan, scan_wavelets

__all__ = ["MonotoneBands", "WaveletRow", "WaveletScan", "find_monotone_bands", "scan_wavelets"]
