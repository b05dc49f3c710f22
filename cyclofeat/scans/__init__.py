"""Searches over many definitions of a feature, with how often chance alone finds as much.

=========================  =====================================================================
name                       job
=========================  =====================================================================
``scan_wavelets``          rank wavelets by how their minima follow the count (paper B section 5)
``WaveletScan``            its result, of ``WaveletRow``
``find_monotone_bands``    find the bands in which entropy falls with the count (paper A fig. 19)
``MonotoneBands``          its result
``Search``                 permutations, processes and progress of either
=========================  =====================================================================

Among many wavelets, levels and bands some always follow the count, so every result carries a p-value by
permutation of the counts among assemblies. If each disc was recorded once, class and recording are the same
thing: a split of such data can tell recordings apart, not counts.
"""

from cyclofeat.scans._band_scan import MonotoneBands, find_monotone_bands
from cyclofeat.scans._search import Search
from cyclofeat.scans._wavelet_scan import WaveletRow, WaveletScan, scan_wavelets

__all__ = ["MonotoneBands", "Search", "WaveletRow", "WaveletScan", "find_monotone_bands", "scan_wavelets"]
