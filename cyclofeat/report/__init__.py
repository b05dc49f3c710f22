"""Self-contained HTML reports: one file, no network, fit for print and for dark screens.

=============================  ================================================================
function                       page
=============================  ================================================================
``write_count_report``         answers of a model for recordings, with their evidence
``write_evaluation_report``    scores of counters on assemblies that they have not seen
``write_history_report``       counts of gearboxes over time, and their alarms
``write_gap_report``           where model and measurement disagree, and what is missing
``write_animation``            the gearbox turning, with its forces and its torque
``Report``                     a page of your own, with text, figures, tables and the pages above
=============================  ================================================================

A report is first summarised to a dictionary of plain values, then rendered by a template that escapes all of
them. Pages need jinja2, and pictures matplotlib: ``ImportError`` says which to install. A page of a folder
that does not exist is a ``FileNotFoundError``, and a name that does not end in ``.html`` a ``ValueError``,
before any work is done.
"""

from cyclofeat.report._animation import write_animation
from cyclofeat.report._count import CountedRecording, write_count_report
from cyclofeat.report._evaluation import write_evaluation_report
from cyclofeat.report._gap import write_gap_report
from cyclofeat.report._history import write_history_report
from cyclofeat.report._page import check_page_path as check_page_path
from cyclofeat.report._page import template_environment as template_environment
from cyclofeat.report._report import Report
from cyclofeat.report._report import write_features_report as write_features_report

__all__ = [
    "CountedRecording",
    "Report",
    "write_animation",
    "write_count_report",
    "write_evaluation_report",
    "write_gap_report",
    "write_history_report",
]
