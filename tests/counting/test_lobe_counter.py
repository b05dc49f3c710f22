"""Counting lobe by lobe: sets of lobes against enumeration, recordings of assemblies never seen."""

from itertools import combinations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from small_model import first_of_each

from cyclofeat.counting import LobeCounter, LobeModel, passage_of_lobe_zero
from cyclofeat.counting.estimators.lobe_positions import best_sets, log_counts
from cyclofeat.recordings import Recording, Windower

SPEED = 500 / 60
PERIOD = 25_600 / (SPEED * 16 / 15)  # of the fold, in samples


def marked(sets, n_lobes=15):
    """Sets of lobes as rows of True and False."""
    return np.array([np.isin(np.arange(n_lobes), [*lobes]) for lobes in sets])


# Sets of lobes against enumeration


def sets_of(n, pattern):
    """All sets of n of six lobes that a pattern allows."""
    if pattern == "any":
        return marked(combinations(range(6), n), 6)
    return marked(([(first + j) % 6 for j in range(n)] for first in range(6)), 6)


@pytest.mark.parametrize("pattern", ["any", "consecutive"])
def test_counts_and_sets_against_enumeration(pattern):
    logits = np.random.default_rng(0).normal(scale=2, size=(3, 6))
    counted = log_counts(logits)
    for window, row in enumerate(logits):
        for n in range(7):
            sets = sets_of(n, pattern)
            weight = np.exp(sets @ row)
            assert pattern != "any" or counted[window, n] == pytest.approx(np.log(weight.sum()))
            best = best_sets(row[np.newaxis], np.array([n]), pattern)[0]
            assert row[best].sum() == pytest.approx((sets @ row).max())
            assert best.sum() == n


# Recordings


@pytest.fixture(scope="module")
def data(surrogates):
    windows = Windower(input_speed_hz=SPEED).windows(surrogates)
    return windows.X, windows.y, windows.worn_table(15), passage_of_lobe_zero(windows.start_angle)


def small(**changes):
    return LobeCounter(25_600, **{"n_trees": 40, "n_splits": 2, "random_state": 0, **changes})


@pytest.fixture(scope="module")
def parts(surrogates):
    """Six assemblies of each count to train, two to test."""
    first = first_of_each(surrogates, 6)
    return first, ~first


@pytest.fixture(scope="module")
def counter(data, parts):
    X, y, worn, passage = (values[parts[0]] for values in data)
    return small().fit(X, y, worn=worn, passage=passage)


@pytest.mark.slow
def test_count_and_lobes_of_assemblies_never_seen(data, parts, counter):
    X, y, worn, passage = (values[parts[1]] for values in data)
    assert np.mean(counter.predict(X) == y) >= 7 / 8
    found = counter.predict_lobes(X, passage)
    assert_array_equal(found.sum(axis=1), counter.predict(X))
    assert np.mean((found == worn).all(axis=1)) >= 6 / 8
    proba = counter.predict_lobe_proba(X, passage)
    assert proba[worn].mean() > 0.6
    assert proba[~worn].mean() < 0.15


@pytest.mark.slow
def test_without_a_tachometer_lobes_are_right_up_to_their_numbering(data, parts, counter):
    X, _, worn, _ = (values[parts[1]] for values in data)
    found = counter.predict_lobes(X)
    turned = [
        any(np.array_equal(np.roll(a, k), b) for k in range(15)) for a, b in zip(found, worn, strict=True)
    ]
    assert np.mean(turned) >= 6 / 8


def test_a_window_begun_some_lobes_later_gives_the_same_answers(data, parts, counter):
    X, _, _, passage = (values[parts[1]] for values in data)
    later = np.roll(X, -round(4 * PERIOD / 15), axis=1)
    assert_allclose(counter.predict_proba(later), counter.predict_proba(X), atol=0.15)
    assert_array_equal(counter.predict_lobes(later, passage - 4 / 15), counter.predict_lobes(X, passage))


@pytest.mark.slow
def test_counts_alone_teach_counting_too(data, parts):
    X, y, worn, passage = (values[parts[0]] for values in data)
    counter, same = small().fit(X, y), small().fit(X, y, worn=worn, passage=passage)
    assert_array_equal(counter.predict_proba(data[0]), same.predict_proba(data[0]))
    assert not counter.locates
    with pytest.raises(ValueError, match="y in fit must hold numbers of worn lobes, and worn"):
        counter.predict_lobes(X)


@pytest.mark.slow
def test_groups_keep_windows_of_an_assembly_in_one_fold(data, parts):
    """Windows that are copies: without groups the folds learn how sure trees are of what they have seen."""
    noise = 3 * np.random.default_rng(0).normal(size=data[0].shape)
    X, y, worn, passage = (values[parts[0]] for values in (data[0] + noise, *data[1:]))
    X, y, worn, passage, names = (np.concatenate([v, v]) for v in (X, y, worn, passage, np.arange(len(y))))
    new, column = (data[0] + noise)[parts[1]], np.searchsorted([0, 1, 3, 5], data[1][parts[1]])
    seeing, blind = (
        small(n_trees=30).fit(X, y, groups, worn, passage).predict_proba(new)[np.arange(len(new)), column]
        for groups in (names, None)
    )
    assert np.log(seeing).mean() > np.log(blind).mean()


def test_labels_that_are_no_counts_have_no_lobes(data):
    X, y, _, _ = data
    counter = small(n_trees=5).fit(X, np.where(y > 1, "worn", "sound"))
    assert set(counter.predict(X)) == {"worn", "sound"}
    with pytest.raises(ValueError, match="y in fit must hold numbers of worn lobes.*'sound', 'worn'"):
        counter.predict_lobes(X)


# Lobes that are no neighbours


def bumps(sets, seed):
    """Torque at 2,560 Hz with a bump at every passage of a worn lobe, weaker beside another worn one."""
    random, worn = np.random.default_rng(seed), marked(sets)
    share = np.where(np.roll(worn, 1, axis=1), 0.6, 1.0) * worn
    begins = random.uniform(size=len(sets))
    slot = (np.arange(4608) / 2560 * SPEED * 16 / 15 - begins[:, np.newaxis]) * 15
    torque = np.take_along_axis(share, slot.astype(int) % 15, axis=1) * np.sin(np.pi * slot) ** 4
    return torque + 0.5 * random.normal(size=torque.shape), worn.sum(axis=1), None, worn, begins


def rows_and_any(n_sets, seed):
    """Half of the sets neighbours, half any lobes; 0 to 5 of them."""
    random = np.random.default_rng(seed)
    counts = np.arange(n_sets) % 6
    return [
        (np.arange(n) + random.integers(15)) % 15 if k % 12 < 6 else random.permutation(15)[:n]
        for k, n in enumerate(counts)
    ]


@pytest.mark.slow
def test_lobes_apart_are_counted_and_found_where_any_were_trained_on():
    """Every other lobe worn: no set of the training looks so."""
    every_other = [(np.arange(4) * 2 + k) % 15 for k in range(15)]
    training = [lobes for lobes in rows_and_any(360, 0) if set(np.diff(np.sort(lobes))) != {2}]
    counter = LobeCounter(2560, n_trees=50, n_splits=2, random_state=0).fit(*bumps(training, 1))
    assert counter.pattern_ == "any"
    X, y, _, worn, passage = bumps([*every_other, *rows_and_any(30, 2)], 3)
    assert np.mean(counter.predict(X) == y) >= 0.95
    assert np.mean((counter.predict_lobes(X, passage) == worn).all(axis=1)) >= 0.9
    by_rows = LobeCounter(2560, n_trees=50, n_splits=2, random_state=0)
    by_rows.fit(*bumps([(np.arange(k % 6) + k) % 15 for k in range(360)], 1))
    assert np.mean(by_rows.predict(X[:15]) == 4) < np.mean(counter.predict(X[:15]) == 4)


@pytest.mark.slow
def test_a_model_trained_on_lobes_apart_counts_lobe_by_lobe():
    cam = np.arange(4608) / 2560 * SPEED * 2 * np.pi
    recordings = []
    sets = [*rows_and_any(60, 0), (0, 2, 4), (3, 7)]
    X, y, _, _, begins = bumps(sets, 1)
    for x, n, lobes, passage in zip(X, y, sets, begins, strict=True):
        # the angle at which lobe 0 passes so much later, see passage_of_lobe_zero
        angle = cam + (-passage * 2 * np.pi * 15 - np.pi) / 16 % (30 * np.pi)
        known = {"defect_count": int(n), "worn_lobes": sorted(map(int, lobes)), "speed_rpm": 500}
        recordings.append(Recording(x, 2560, angle=angle, angle_is_absolute=True, **known))
    model = LobeModel(n_splits=0, n_trees=30, random_state=0).fit(recordings[:-2])
    assert model.counter_.pattern_ == "any"
    assert model.locator_ is model.counter_
    assert [model.count(recording).lobes for recording in recordings[-2:]] == [(0, 2, 4), (3, 7)]
    of_rows = [r for r, lobes in zip(recordings[:60], sets, strict=False) if len(lobes) < 2]
    by_rows = LobeModel(n_splits=0, n_trees=10, random_state=0).fit(of_rows)
    assert by_rows.counter_.pattern_ == "consecutive"


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"passage": None}, "passage must be given together with worn"),
        ({"worn": np.ones((32, 14))}, r"worn must have shape .* = \(32, 15\), got \(32, 14\)"),
        ({"worn": np.ones((32, 15))}, "y must hold the number of lobes that worn marks"),
        ({"passage": np.zeros(3)}, r"passage must hold one value .*, shape \(32,\), got shape \(3,\)"),
        ({"passage": np.full(32, np.nan)}, "passage must hold a value for every window, got nan at window 0"),
        ({"groups": [1, 2]}, "groups must hold one value per window"),
        ({"y": np.ones(32)}, "y must hold at least two classes, got 1 class"),
    ],
)
def test_bad_input(data, changes, message):
    X, y, worn, passage = data
    arguments = {"y": y, "worn": worn, "passage": passage, **changes}
    with pytest.raises(ValueError, match=message):
        small().fit(X, **arguments)
