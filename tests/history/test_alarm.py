"""Rules of alarm: how often they are wrong, and which is chosen."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from cyclofeat.history import AlarmRule, choose_rule
from cyclofeat.history.alarm import alarm_states, mean_run_length

SCORES = {
    "classes": [0, 1, 3], "confusion": [[95, 5, 0], [4, 90, 6], [0, 2, 98]], "n_windows": 300,
    "n_assemblies": 150,
}  # fmt: skip


def rule(k, n, baseline=0):
    return AlarmRule(baseline, k, n, 0.1, 0.9, 100.0, 2.0)


def brute_mean(k, n, p):
    """Mean over all courses of 40 counts, which an alarm has nearly surely ended, by their probabilities."""
    alive = {(): 1.0}
    mean = 0.0
    for _ in range(40):
        mean += sum(alive.values())
        following = {}
        for past, share in alive.items():
            for bit, odds in ((0, 1 - p), (1, p)):
                window = (*past, bit)[-n:]
                if sum(window) < k:
                    following[window] = following.get(window, 0.0) + share * odds
        alive = following
    return mean


@pytest.mark.parametrize(("k", "n", "p"), [(1, 1, 0.5), (2, 2, 0.8), (2, 3, 0.7), (3, 5, 0.8), (2, 10, 0.6)])
def test_the_mean_run_is_that_of_all_courses(k, n, p):
    assert_allclose(mean_run_length(k, n, p), brute_mean(k, n, p), rtol=1e-3)


def test_an_alarm_lasts_until_no_count_exceeds():
    series = [one == "1" for one in "0110100010000011"]
    states = "".join(str(int(one)) for one in alarm_states(series, rule(2, 3)))
    assert states == "0011111000000001"


@pytest.mark.parametrize("per_month", [1.0, 0.1])
def test_false_alarms_are_as_rare_as_stated(per_month):
    """Gearboxes that never change, counted for two years with the error rate of the rule."""
    monthly = 60.0
    chosen = choose_rule(SCORES, 0, false_alarms=per_month / monthly)
    random = np.random.default_rng(3)
    months, n_boxes = 24, 400
    exceeds = random.random((n_boxes, int(months * monthly))) < chosen.error_rate
    begun = [
        np.sum(np.diff(np.array([False, *alarm_states(row, chosen)]).astype(int)) == 1) for row in exceeds
    ]
    rate = np.sum(begun) / (n_boxes * months)
    assert rate <= per_month
    # Rules are few, so that the rate is often well below; the chosen one keeps what it states itself.
    stated = monthly / chosen.recordings_to_false_alarm
    spread = 4 * np.sqrt(stated * n_boxes * months) / (n_boxes * months)
    assert 0.8 * stated - spread < rate < stated + spread


def test_gearboxes_that_err_as_often_as_they_please_raise_no_more():
    """Most are never counted wrong and some often, 5 % of the counts as on the card; each has its rule."""
    random = np.random.default_rng(5)
    per_month, monthly, months = 0.1, 60.0, 24
    begun = judged = 0
    for error_rate in random.beta(0.2, 3.8, 60):
        exceeds = random.random(int(monthly * months)) < error_rate
        if exceeds[:10].mean() > 0.5:
            continue  # another baseline
        chosen = choose_rule(SCORES, 0, false_alarms=per_month / monthly, seen=exceeds[:10].tolist())
        states = np.array([False, *alarm_states(exceeds[10:], chosen)])
        begun += np.sum(states[1:] & ~states[:-1])
        judged += months
    assert begun / judged <= per_month


def test_a_rise_is_noticed_as_soon_as_stated():
    chosen = choose_rule(SCORES, 0, false_alarms=1 / 1000)
    random = np.random.default_rng(4)
    runs = [
        alarm_states(random.random(60) < chosen.detection_rate, chosen).index(True) + 1 for _ in range(2000)
    ]
    assert_allclose(np.mean(runs), chosen.recordings_to_detection, rtol=0.02)


def test_the_rule_follows_from_the_errors():
    usual = choose_rule(SCORES, 0, false_alarms=1 / 7200)
    # 2.5 of 50 assemblies: the upper end lies above the share of 5 %.
    assert 0.05 < usual.error_rate < 0.15
    assert usual.detection_rate == 0.96
    assert usual.recordings_to_false_alarm >= 7200
    assert choose_rule(SCORES, 0, false_alarms=1 / 100).k < usual.k
    fewer = SCORES | {"n_assemblies": 30}
    assert choose_rule(fewer, 0, false_alarms=1 / 7200).error_rate > usual.error_rate
    wavering = choose_rule(SCORES, 0, false_alarms=1 / 7200, seen=[True, False, False, False])
    assert wavering.error_rate == 0.25
    assert wavering.recordings_to_detection > usual.recordings_to_detection


def test_where_no_rule_can_be_right_it_is_said():
    with pytest.raises(ValueError, match="the model knows no count above 3"):
        choose_rule(SCORES, 3, false_alarms=0.01)
    with pytest.raises(ValueError, match=r"baseline must be one of the model's counts \[0, 1, 3\], got 2"):
        choose_rule(SCORES, 2, false_alarms=0.01)
    with pytest.raises(ValueError, match="no rule of up to 10 counts is wrong so rarely: up to 75%"):
        choose_rule(SCORES, 0, false_alarms=1e-4, seen=[True, True, True, False])
    with pytest.raises(ValueError, match="as frequent by error .100%. as they would be"):
        choose_rule(SCORES, 0, false_alarms=1e-4, seen=[True])
    with pytest.raises(ValueError, match="false_alarms must be positive"):
        choose_rule(SCORES, 0, false_alarms=0)
