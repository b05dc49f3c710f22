"""State of one gearbox: what was counted last, and whether the count has risen."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any, NamedTuple

import numpy as np

from cyclofeat._base import checks
from cyclofeat.history._alarm import AlarmRule, alarm_states, choose_rule

# Counts from which the baseline is taken; seconds of an hour, the shortest time that shows how frequent
# recordings are (copying gives many files almost one time), and of a mean month.
N_BASELINE, HOUR_S, MONTH_S = 10, 3600, 365.25 / 12 * 86_400


class Point(NamedTuple):
    """Time in s since 1970 of a recording, its count (None where it was refused), and depth of wear in um.

    Of the depth also the ends and the coverage of its interval.
    """

    time: float
    defect_count: int | None
    wear_um: float | None = None
    low_um: float | None = None
    high_um: float | None = None
    coverage: float | None = None

    def exceeds(self, baseline: int, baseline_um: float | None) -> bool:
        """Return whether count or depth exceed the baseline."""
        deeper = baseline_um is not None and self.low_um is not None and self.low_um > baseline_um
        return deeper or (self.defect_count is not None and self.defect_count > baseline)


@dataclass(frozen=True)
class GearboxState:
    """State of one gearbox, by the counts of the model that counted last.

    Attributes
    ----------
    gearbox : str
    n_recordings, n_refused : int
        Of that model.
    first, last : float
        Times of its first and last recording in s since 1970.
    defect_count : int or None
        Last count; None where all recordings were refused.
    wear_um : float or None
        Depth of the wear at the last count; None where none was seen, or the model does not learn it.
    baseline : int or None
        Most frequent of the first ten counts, the lowest of several; None before there are ten.
    recordings_per_month : float or None
        Stated, or as frequent as they were; None where they span less than an hour.
    rule : AlarmRule or None
    no_rule : str
        Why there is no rule, and so no alarm; else empty.
    alarm : bool
        Whether there is an alarm now.
    alarms : tuple of (float, float or None)
        Beginning and end of each alarm; None where it lasts.
    """

    gearbox: str
    n_recordings: int
    n_refused: int
    first: float
    last: float
    defect_count: int | None
    wear_um: float | None
    baseline: int | None
    recordings_per_month: float | None
    rule: AlarmRule | None
    no_rule: str
    alarm: bool
    alarms: tuple[tuple[float, float | None], ...] = field(repr=False)

    @property
    def rates(self) -> str:
        """False alarms of the rule and its delay, in words; empty without a rule."""
        if self.rule is None or self.recordings_per_month is None:
            return ""
        false_alarms = self.recordings_per_month / self.rule.recordings_to_false_alarm
        return (
            f"{false_alarms:.2g} false alarms per month at "
            f"{self.recordings_per_month:.3g} recordings; a rise is noticed after "
            f"{self.rule.recordings_to_detection:.2g} counts on average"
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the state in plain types, for JSON; times as text in UTC."""
        stated = dataclasses.asdict(self) | {"first": _iso(self.first), "last": _iso(self.last)}
        del stated["alarms"]
        return stated | {"alarm_since": _iso(self.alarms[-1][0]) if self.alarm else None}

    def __str__(self) -> str:
        if self.rule is None:
            return f"no alarm possible: {self.no_rule}"
        return (
            f"ALARM since {when(self.alarms[-1][0])}: {self.rule}" if self.alarm else f"no alarm: {self.rule}"
        )


def when(time: float) -> str:
    """Return a time in s since 1970 as people read it, to the minute, in UTC."""
    return datetime.fromtimestamp(time, UTC).strftime("%Y-%m-%d %H:%M UTC")


def _iso(time: float) -> str:
    return datetime.fromtimestamp(time, UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


def state_of(
    gearbox: str,
    points: Sequence[Point],
    scores: Mapping[str, Any] | None,
    *,
    false_alarms_per_month: float,
    recordings_per_month: float | None,
) -> GearboxState:
    """Return the state of a gearbox after at least one recording, in the order of time."""
    checks.positive("false_alarms_per_month", false_alarms_per_month)
    if recordings_per_month is not None:
        checks.positive("recordings_per_month", recordings_per_month)
    counted = [point for point in points if point.defect_count is not None]
    counts = [point.defect_count for point in points if point.defect_count is not None]
    first, last = points[0].time, points[-1].time
    rate = recordings_per_month
    if rate is None and last - first >= HOUR_S:
        rate = (len(points) - 1) / (last - first) * MONTH_S
    baseline, rule, no_rule = None, None, ""
    baseline_um, depth_error, exceeds = None, 0.0, list[bool]()
    alarms: list[tuple[float, float | None]] = []
    if len(counted) >= N_BASELINE:
        usual = counted[:N_BASELINE]
        frequent = Counter(counts[:N_BASELINE])
        baseline = min(frequent, key=lambda count: (-frequent[count], count))
        baseline_um, depth_error = _usual_depth(usual)
        exceeds = [point.exceeds(baseline, baseline_um) for point in counted]
    if baseline is None:
        no_rule = f"{len(counted)} of the {N_BASELINE} counts that make a baseline"
    elif scores is None:
        no_rule = "the model's card states no cross-validation, so that its error rate is unknown"
    elif rate is None:
        no_rule = (
            f"its recordings span {(last - first) / 60:.2g} minutes by their times, too short to tell how "
            "many there are in a month: state recordings_per_month. Where files state no time of recording, "
            "their time of change is taken: keep it when copying (cp -p)"
        )
    else:
        try:
            rule = choose_rule(
                scores, baseline, false_alarms=false_alarms_per_month / rate, seen=exceeds[:N_BASELINE],
                depth_error=depth_error,
            )  # fmt: skip
            rule = dataclasses.replace(rule, baseline_um=baseline_um)
        except ValueError as error:
            no_rule = str(error)
    if rule is not None:
        before = False
        later = counted[N_BASELINE:]
        for point, now in zip(later, alarm_states(exceeds[N_BASELINE:], rule), strict=True):
            if now and not before:
                alarms.append((point.time, None))
            elif before and not now:
                alarms[-1] = (alarms[-1][0], point.time)
            before = now
    return GearboxState(
        gearbox=gearbox,
        n_recordings=len(points),
        n_refused=len(points) - len(counted),
        first=first,
        last=last,
        defect_count=counts[-1] if counts else None,
        wear_um=counted[-1].wear_um if counted else None,
        baseline=baseline,
        recordings_per_month=rate,
        rule=rule,
        no_rule=no_rule,
        alarm=bool(alarms) and alarms[-1][1] is None,
        alarms=tuple(alarms),
    )


def _usual_depth(usual: Sequence[Point]) -> tuple[float | None, float]:
    """Return the usual upper end of the depth's interval, and how often a lower one lies above the truth."""
    ends = [point.high_um for point in usual if point.high_um is not None]
    if len(ends) < len(usual):
        return None, 0.0
    return float(np.median(ends)), (1 - float(usual[0].coverage or 0.0)) / 2
