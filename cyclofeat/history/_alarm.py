"""Alarm by a run rule: k of the last n counts, or depths of wear, exceed the baseline."""

from __future__ import annotations

import functools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
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

    Parameters
    ----------
    k, n : int
        With 1 <= k <= n <= 10.
    probability : float
        That one count exceeds the baseline, independently of the others; above 0, at most 1.

    Raises
    ------
    ValueError
        If an argument lies outside its range.

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
    checks.whole("k", k, 1, n)
    checks.whole("n", n, 1, _LONGEST)
    if not 0 < probability <= 1:
        raise ValueError(f"probability must be above 0 and at most 1, got {probability!r}")
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
    """Return after each count whether there is an alarm.

    Parameters
    ----------
    exceeds : iterable of bool
        Whether each count exceeds the baseline, in the order of time.
    rule : AlarmRule
    """
    last = alarm = 0
    states = []
    for one in exceeds:
        last = (2 * last + bool(one)) % 2**rule.n
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

    Raises
    ------
    ValueError
        If no rule of up to ten counts is so rarely wrong, or no count can exceed the baseline.

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
    error_rate = _upper(above[row] * independent, total[row] * independent)
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


def _upper(errors: float, trials: float) -> float:
    """Return the upper end of the one-sided interval of a share."""
    return float(betaincinv(errors + 1, trials - errors, _CONFIDENCE)) if errors < trials else 1.0
