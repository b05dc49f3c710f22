"""History of the counts of gearboxes in one file, and an alarm where a count has risen.

================  ======================================================================
name              job
================  ======================================================================
``History``       SQLite file with one row per recording
``HistoryRow``    one of its rows
``GearboxState``  count, baseline and alarm of one gearbox
``AlarmRule``     "k of the last n counts exceed the baseline", and how often it errs
``choose_rule``   the rule that notices a rise soonest at a stated rate of false alarms
================  ======================================================================
"""

from cyclofeat.history._history import History, HistoryRow
from cyclofeat.history.alarm import AlarmRule, GearboxState, choose_rule

__all__ = ["AlarmRule", "GearboxState", "History", "HistoryRow", "choose_rule"]
