"""Models of whole recordings as scikit-learn sees them."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from sklearn.base import clone, is_classifier
from sklearn.exceptions import NotFittedError
from sklearn.model_selection import GroupKFold, cross_val_predict
from sklearn.pipeline import Pipeline
from sklearn.preprocessing import FunctionTransformer
from small_model import labelled, recording, shaft_model, small_model, unlike_training

from cyclofeat.counting import REFUSED, LobeModel, RecordingCounter


@pytest.fixture(scope="module")
def some():
    """A worn, a sound and a refused disc, and one without an absolute angle."""
    unlike = unlike_training()
    return [
        recording((2, 3, 4), seed=83), recording((), seed=81),
        unlike.replace(torque=np.tile(unlike.torque, 2)),
        recording((9,), seed=82, turns=2, angle_is_absolute=False),
    ]  # fmt: skip


@pytest.mark.parametrize("make", [small_model, shaft_model])
def test_many_recordings_have_the_answers_of_each(make, some):
    model = make()
    for together, alone in zip(model.count_all(some), map(model.count, some), strict=True):
        assert together.defect_count == alone.defect_count
        assert (together.refused, together.reason, together.lobes) == (
            alone.refused,
            alone.reason,
            alone.lobes,
        )
        assert_allclose(list(together.probability.values()), list(alone.probability.values()))
        assert_allclose(together.lobe_probability, alone.lobe_probability)


def test_predictions_are_those_of_count(some):
    model = shaft_model()
    answers = model.count_all(iter(some))
    assert answers[2].refused
    assert model.predict(some).tolist() == [3, 0, REFUSED, 1]
    proba = model.predict_proba(some)
    assert_allclose(proba.sum(axis=1), 1)
    assert proba[2].tolist() == list(answers[2].probability.values())
    assert model.classes_.tolist() == [0, 1, 3]
    assert model.score([some[0], some[1], some[3]]) == 1
    assert model.score(some[:2], [3, 1]) == 0.5
    assert model.score([some[0], some[2]], [3, 0]) == 0.5  # a refusal is not right
    assert model.predict([]).shape == (0,)


def test_a_count_less_probable_than_all_others_together_is_refused():
    count = shaft_model().count(recording((2, 3, 4), seed=80))
    assert 0.3 < max(count.probability.values()) < 0.5
    assert count.refused
    assert count.reason.startswith("no count is more probable than all others together: 3 has 0.4")


def test_bad_recordings_are_named(some):
    model = shaft_model()
    with pytest.raises(ValueError, match="recording 1: the recording is too short"):
        model.predict([some[0], some[0].part(0.0, 0.5)])
    with pytest.raises(TypeError, match="recordings must be Recording objects, got list at 0"):
        model.predict([[1.0, 2.0]])
    with pytest.raises(TypeError, match="recording must be a Recording object, got str"):
        model.count("rig.csv")
    with pytest.raises(TypeError, match="got one: use count"):
        model.predict(some[0])
    with pytest.raises(ValueError, match="recording 1 states no defect_count"):
        model.score([some[0], some[2]])
    with pytest.raises(ValueError, match="at least one recording"):
        model.score([])


def test_fit_changes_no_trained_model_in_scikit_learn(some):
    model = shaft_model()
    assert is_classifier(model)
    assert clone(model) is model
    assert model.fit([], []) is model
    tail = FunctionTransformer(lambda recordings: [one.part(0.0, one.duration - 0.01) for one in recordings])
    pipeline = Pipeline([("first_turn", tail), ("count", model)]).fit(some)
    assert pipeline.predict(some).tolist() == [3, 0, REFUSED, 1]
    held_out = cross_val_predict(model, some[:2], [3, 0], cv=GroupKFold(2), groups=["a", "b"])
    assert held_out.tolist() == [3, 0]
    # A notebook shows the card, not scikit-learn's diagram.
    assert model._repr_mimebundle_()["text/html"] == model._repr_html_()


@pytest.mark.slow
def test_the_estimator_learns_in_fit():
    counter = RecordingCounter(n_trees=20)
    with pytest.raises(NotFittedError):
        counter.predict([])
    known = labelled(per_count=4)
    counts = [one.defect_count for one in known]
    groups = [one.assembly for one in known]
    folds = {"groups": groups, "cv": GroupKFold(2)}
    found = cross_val_predict(counter, known, counts, **folds)
    assert {*found.tolist()} <= {REFUSED, 0, 1, 3}
    proba = cross_val_predict(counter, known, counts, method="predict_proba", **folds)
    best = np.array([0, 1, 3])[proba.argmax(axis=1)]
    assert np.mean(best == counts) > 0.8  # chance: a third
    assert_array_equal(found[found != REFUSED], best[found != REFUSED])
    assert not hasattr(counter, "model_")
    assert counter.fit(known, counts) is counter
    assert_array_equal(counter.classes_, [0, 1, 3])
    assert isinstance(counter.model_, LobeModel)
    assert counter.model_.locator is not None
    assert counter.score(known) > 0.9
    assert counter.fit(known, [10 * count for count in counts]).classes_.tolist() == [0, 10, 30]
    assert counter.score(known) == counter.score(known, [10 * count for count in counts]) > 0.9
    blank = [one.replace(worn_lobes=None, defect_count=None) for one in known]
    assert clone(counter).set_params(n_trees=5).fit(blank, counts).model_.locator is None
    with pytest.raises(ValueError, match="one count per recording, shape .12,., got shape .2,."):
        counter.fit(known, [0, 1])
    for wrong in ([2] * len(known), [0, *counts[:-1]]):
        with pytest.raises(ValueError, match="y contradicts the defect_count of recordings"):
            counter.fit(known, wrong)


@pytest.mark.slow
def test_more_recordings_than_fit_a_batch_are_all_counted():
    """Three recordings of 150 windows, of which two fill a batch."""
    long = recording((2, 3, 4), seed=83, turns=150)
    last = recording((7,), seed=84)
    *same, other = small_model().count_all(one for one in (long, long, long, last))
    assert [len(one.windows) for one in same] == [150] * 3
    assert same[0] == same[1]
    assert [one.defect_count for one in same] == [3] * 3
    assert other.defect_count == 1
