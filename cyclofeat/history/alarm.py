"""Alarm by a run rule, k of the last n counts or depths above the baseline, and the state of a gearbox."""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
import statistics
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any

import numpy as np
from scipy.special import betaincinv

from cyclofeat._base import checks

# Longest rule: 2^(n - 1) states. One-sided confidence of the error rate.
_LONGEST, _CONFIDENCE = 10, 0.9


@dataclass(frozen=True)
class AlarmRule:
    """Alarm where ``k`` of the last ``n`` counts exceed the baseline.

    The alarm lasts until none of the last ``n`` does. Refused recordings are no counts.

    Attributes
    ----------
    baseline : int
        Usual number of worn lobes.
    k, n : int
    error_rate : float
        Probability that one count exceeds the baseline although nothing has changed.
    detection_rate : float
        Probability that one count exceeds it once there is one class of worn lobes more.
    recordings_to_false_alarm, recordings_to_detection : float
        Mean number of counts until the alarm in either case.
    baseline_um : float or None
        Usual upper end of the interval of the wear's depth, which a count exceeds too if its whole interval
        lies above; None where depths are not known.
    """

    baseline: int
    k: int
    n: int
    error_rate: float
    detection_rate: float
    recordings_to_false_alarm: float
    recordings_to_detection: float
    baseline_um: float | None = None

    def __str__(self) -> str:
        depth = "" if self.baseline_um is None else f", or wear surely deeper than {self.baseline_um:.3g} um"
        return f"{self.k} of the last {self.n} counts above {self.baseline}{depth}"


@functools.lru_cache(maxsize=512)
def mean_run_length(k: int, n: int, probability: float) -> float:
    """Return the mean number of counts until k of the last n exceed the baseline, from the first one on.

    Each count exceeds it with this probability, independently of the others; 1 <= k <= n <= 10.

    Notes
    -----
    The last n - 1 outcomes are the state of a Markov chain that the alarm absorbs; the mean times m solve
    (I - Q) m = 1 with the transitions Q between the other states (Champ and Woodall, Exact results for
    Shewhart control charts with supplementary runs rules, Technometrics 29(4), 1987).

    Examples
    --------
    >>> [round(mean_run_length(n, n, 0.1), 6) for n in (1, 2)]  # 1/p, (1 + p)/p^2
    [10.0, 110.0]
    """
    # Bits of a state are the last outcomes. More than k - 1 of them are an alarm, which is not left.
    states = [state for state in range(2 ** (n - 1)) if state.bit_count() < k]
    place = {state: row for row, state in enumerate(states)}
    stay = np.eye(len(states))
    for row, state in enumerate(states):
        for bit, share in ((0, 1 - probability), (1, probability)):
            window = 2 * state + bit
            if window.bit_count() < k:
                stay[row, place[window % 2 ** (n - 1)]] -= share
    return float(np.linalg.solve(stay, np.ones(len(states)))[0])


def alarm_states(exceeds: Iterable[bool], rule: AlarmRule) -> list[bool]:
    """Return whether there is an alarm after each count; ``exceeds`` tells which exceed the baseline."""
    last = alarm = 0
    states = []
    for exceeds_now in exceeds:
        last = (2 * last + bool(exceeds_now)) % 2**rule.n
        # It ends where it began, with no such count in sight: false alarms are then as rare as stated.
        alarm = last.bit_count() >= rule.k or (alarm and last > 0)
        states.append(bool(alarm))
    return states


def choose_rule(
    scores: Mapping[str, Any],
    baseline: int,
    *,
    false_alarms: float,
    seen: Sequence[bool] = (),
    depth_error: float = 0.0,
) -> AlarmRule:
    """Return the rule that notices a rise soonest among those with few enough false alarms.

    The error rate is the share of held-out windows of the baseline's class that were counted higher: the
    upper end of its one-sided 90 % interval (Clopper and Pearson, Biometrika 26, 1934), the windows of an
    assembly taken as one; at least the share in ``seen``. Errors of different recordings are taken to be
    independent. A gearbox whose count is always wrong is not, but then its baseline is wrong too.

    Parameters
    ----------
    scores : mapping
        Cross-validation of the model, as on its card: ``classes``, ``confusion``, ``n_windows`` and
        ``n_assemblies``.
    baseline : int
        One of the classes, and not the last.
    false_alarms : float
        Largest mean number of false alarms per recording.
    seen : sequence of bool
        Whether the counts from which the baseline was taken exceed it.
    depth_error : float
        Probability that the interval of an unchanged depth lies above; it adds to the error rate.

    Returns
    -------
    AlarmRule

    Examples
    --------
    >>> scores = {"classes": [0, 1], "confusion": [[98, 2], [5, 95]], "n_windows": 200, "n_assemblies": 100}
    >>> rule = choose_rule(scores, 0, false_alarms=1 / 7200)
    >>> str(rule), round(rule.error_rate, 3)
    ('4 of the last 5 counts above 0', 0.076)
    """
    checks.positive("false_alarms", false_alarms, "a number per recording")
    classes = np.asarray(scores["classes"])
    row = int(np.searchsorted(classes, baseline))
    if row >= classes.size or classes[row] != baseline:
        raise ValueError(f"baseline must be one of the model's counts {classes.tolist()}, got {baseline}")
    if row == classes.size - 1:
        raise ValueError(f"the model knows no count above {baseline}")
    confusion = np.asarray(scores["confusion"], dtype=float)
    above = confusion[:, row + 1 :].sum(axis=1)
    total = confusion.sum(axis=1)
    independent = scores["n_assemblies"] / scores["n_windows"]
    errors = above[row] * independent
    trials = total[row] * independent
    error_rate = float(betaincinv(errors + 1, trials - errors, _CONFIDENCE)) if errors < trials else 1.0
    error_rate = max(min(error_rate + depth_error, 1.0), float(np.mean(seen)) if len(seen) else 0.0)
    detection_rate = float(above[row + 1] / total[row + 1])
    if detection_rate <= error_rate:
        raise ValueError(
            f"counts above {baseline} are as frequent by error ({error_rate:.0%}) as they would be with "
            f"{classes[row + 1]} worn lobes ({detection_rate:.0%})"
        )
    rules = [
        AlarmRule(baseline, k, n, error_rate, detection_rate, false, mean_run_length(k, n, detection_rate))
        for n in range(1, _LONGEST + 1)
        for k in range(1, n + 1)
        if (false := mean_run_length(k, n, error_rate)) * false_alarms >= 1
    ]
    if not rules:
        raise ValueError(
            f"no rule of up to {_LONGEST} counts is wrong so rarely: up to {error_rate:.0%} of the counts "
            f"exceed {baseline} by error"
        )
    return min(rules, key=lambda rule: (rule.recordings_to_detection, rule.n))


# Counts from which the baseline is taken; seconds of an hour, the shortest time that shows how frequent
# recordings are (copying gives many files almost one time), and of a mean month.
N_BASELINE, HOUR_S, MONTH_S = 10, 3600, 365.25 / 12 * 86_400


@dataclass(frozen=True)
class HistoryRow:
    """One recording of a history.

    Attributes
    ----------
    time : float
        Time of the recording, in s since 1970.
    gearbox, file : str
    model : int
        Number of the model that counted.
    defect_count : int or None
        None where it was refused.
    reason : str
        Why it was refused, else empty.
    mean, deviation : float
        Mean and standard deviation of its samples.
    unit : str
        Unit of these two.
    answer : dict
        :meth:`LobeCount.to_dict`: probabilities, lobes, warnings; with the ``source`` of the recording.
    """

    time: float
    gearbox: str
    file: str
    model: int
    defect_count: int | None
    reason: str
    mean: float
    deviation: float
    unit: str
    answer: dict[str, Any]


@dataclass(frozen=True)
class GearboxState:
    """State of one gearbox, by the counts of the model that counted last.

    Attributes
    ----------
    gearbox : str
    n_recordings, n_refused : int
        Recordings of that model, and how many of them were refused.
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
            f"{false_alarms:.2g} false alarms per month at {self.recordings_per_month:.3g} recordings; a "
            f"rise is noticed after {self.rule.recordings_to_detection:.2g} counts on average"
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the state in plain types, for JSON; times as text in UTC.

        Returns
        -------
        dict
        """
        content = dataclasses.asdict(self) | {"first": _iso_time(self.first), "last": _iso_time(self.last)}
        del content["alarms"]
        return content | {"alarm_since": _iso_time(self.alarms[-1][0]) if self.alarm else None}

    def __str__(self) -> str:
        if self.rule is None:
            return f"no alarm possible: {self.no_rule}"
        if self.alarm:
            return f"ALARM since {time_text(self.alarms[-1][0])}: {self.rule}"
        return f"no alarm (it takes {self.rule}, after the first ten)"


def time_text(time: float) -> str:
    """Return a time in s since 1970 as people read it, to the minute, in UTC."""
    return datetime.fromtimestamp(time, UTC).strftime("%Y-%m-%d %H:%M UTC")


def _iso_time(time: float) -> str:
    return datetime.fromtimestamp(time, UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


def state_of(
    rows: Sequence[HistoryRow],
    scores: Mapping[str, Any] | None,
    *,
    false_alarms_per_month: float,
    recordings_per_month: float | None,
) -> GearboxState:
    """Return the state of a gearbox by at least one recording of one model, in the order of time."""
    checks.positive("false_alarms_per_month", false_alarms_per_month)
    if recordings_per_month is not None:
        checks.positive("recordings_per_month", recordings_per_month)
    counted = [row for row in rows if row.defect_count is not None]
    counts = [row.defect_count for row in rows if row.defect_count is not None]
    first, last = rows[0].time, rows[-1].time
    rate = recordings_per_month
    if rate is None and last - first >= HOUR_S:
        rate = (len(rows) - 1) / (last - first) * MONTH_S
    baseline, rule, no_rule = None, None, ""
    baseline_um, depth_error, exceeds = None, 0.0, list[bool]()
    if len(counted) >= N_BASELINE:
        baseline = min(statistics.multimode(counts[:N_BASELINE]))
        # Usual upper end of the depth's interval, and how often a lower one lies above the truth.
        usual = [row.answer for row in counted[:N_BASELINE] if row.answer.get("wear_um_high") is not None]
        if len(usual) == N_BASELINE:
            baseline_um = float(np.median([answer["wear_um_high"] for answer in usual]))
            depth_error = (1 - usual[0]["wear_um_coverage"]) / 2
        deepest = math.inf if baseline_um is None else baseline_um
        exceeds = [
            count > baseline or (row.answer.get("wear_um_low") or 0.0) > deepest
            for count, row in zip(counts, counted, strict=True)
        ]
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
    alarms: tuple[tuple[float, float | None], ...] = ()
    if rule is not None:
        states = zip(alarm_states(exceeds[N_BASELINE:], rule), counted[N_BASELINE:], strict=True)
        begun = [(now, next(group)[1].time) for now, group in itertools.groupby(states, lambda one: one[0])]
        ends: list[float | None] = [*(time for _, time in begun[1:]), None]
        alarms = tuple((time, end) for (now, time), end in zip(begun, ends, strict=False) if now)
    return GearboxState(
        gearbox=rows[0].gearbox, n_recordings=len(rows), n_refused=len(rows) - len(counted),
        first=first, last=last, defect_count=counts[-1] if counts else None,
        wear_um=counted[-1].answer.get("wear_um") if counted else None,
        baseline=baseline, recordings_per_month=rate, rule=rule, no_rule=no_rule,
        alarm=bool(alarms) and alarms[-1][1] is None, alarms=alarms,
    )  # fmt: skip
