"""History of the counts of gearboxes in one file, and an alarm where a count has risen.

=======================  ======================================================================
name                     job
=======================  ======================================================================
``History``              SQLite file with one row per recording
``HistoryRow``           one of its rows
``GearboxState``         count, baseline and alarm of one gearbox
``AlarmRule``            "k of the last n counts exceed the baseline", and how often it errs
``choose_rule``          the rule that notices a rise soonest at a stated rate of false alarms
``alarm_states``         the alarm after each of a series of counts
``mean_run_length``      mean number of recordings until a rule raises an alarm
``when``                 time of a history as text
=======================  ======================================================================
"""

from cyclofeat.history._alarm import AlarmRule, alarm_states, choose_rule, mean_run_length
from cyclofeat.history._state import GearboxState, when
from cyclofeat.history._store import History, HistoryRow

__all__ = [
    "AlarmRule",
    "GearboxState",
    "History",
    "HistoryRow",
    "alarm_states",
    "choose_rule",
    "mean_run_length",
    "when",
]
