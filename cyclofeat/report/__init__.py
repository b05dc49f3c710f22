"""Self-contained HTML reports: one file, no network, fit for print and for dark screens.

=============================  ================================================================
function                       what the page tells
=============================  ================================================================
``write_count_report``         what a model says of recordings, and on what grounds
``write_evaluation_report``    how often counters are right on assemblies that they have not seen
``write_gap_report``           where model and measurement disagree, and what is missing
``write_demo_report``          the demonstration on surrogate recordings
``write_animation``            the gearbox turning, with its forces and its torque
=============================  ================================================================

A report is first summarised to a dictionary of plain values (:func:`summarise_count` and its like), then
rendered by a template that escapes all of them. Needs ``pip install "cyclofeat[report]"``.
"""

from cyclofeat.report._animation import summarise_animation, write_animation
from cyclofeat.report._count import CountedRecording, summarise_count, write_count_report
from cyclofeat.report._demo import summarise_demo, write_demo_report
from cyclofeat.report._evaluation import summarise_evaluation, write_evaluation_report
from cyclofeat.report._gap import summarise_gap, write_gap_report
from cyclofeat.report._gap_findings import GapFindings

__all__ = [
    "CountedRecording",
    "GapFindings",
    "summarise_animation",
    "summarise_count",
    "summarise_demo",
    "summarise_evaluation",
    "summarise_gap",
    "write_animation",
    "write_count_report",
    "write_demo_report",
    "write_evaluation_report",
    "write_gap_report",
]
