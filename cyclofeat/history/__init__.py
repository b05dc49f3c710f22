"""History of the counts of gearboxes in one SQLite file, and an alarm where a count has risen."""

from cyclofeat.history._history import History
from cyclofeat.history.alarm import AlarmRule, GearboxState, HistoryRow, choose_rule

__all__ = ["AlarmRule", "GearboxState", "History", "HistoryRow", "choose_rule"]
