"""Self-contained HTML reports: one file, no network, fit for print and for dark screens.

A report is first summarised to a dictionary of plain values (:func:`summarise_demo`,
:func:`summarise_gap`), then rendered by a template that escapes all of them. Needs
``pip install "cyclofeat[report]"``.
"""

from cyclofeat.report._demo import summarise_demo, write_demo_report
from cyclofeat.report._gap import GapFindings, summarise_gap, write_gap_report

__all__ = ["GapFindings", "summarise_demo", "summarise_gap", "write_demo_report", "write_gap_report"]
