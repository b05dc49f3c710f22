"""Models of whole recordings as scikit-learn sees them."""

import copy

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from sklearn.base import clone, is_classifier
from sklearn.exceptions import NotFittedError
from sklearn.model_selection import GridSearchCV, GroupKFold, StratifiedGroupKFold, cross_val_predict
from sklearn.pipeline import Pipeline, make_pipeline
from sklearn.preprocessing import FunctionTransformer
from small_model import labelled, recording, shaft_model, small_model, unlike_training

from cyclofeat.counting import GroupCalibratedCounter, LobeModel, Protocol, evaluate
from cyclofeat.counting.estimators.trees import CountingTrees
from cyclofeat.counting.model.lobe_count import AnsweredWindows
from cyclofeat.datasets import make_rig_recordings
from cyclofeat.features import LobeMap
from cyclofeat.recordings.windower import lobe_windower
from cyclofeat.simulators import BrakeRotor, Noise, Rig


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
        for name in ("defect_count", "refused", "reason", "lobes"):
            assert getattr(together, name) == getattr(alone, name), name
        assert_allclose(list(together.probability.values()), list(alone.probability.values()))
        assert_allclose(together.lobe_probability, alone.lobe_probability)


@pytest.mark.slow
def test_predictions_are_those_of_count(some):
    model = shaft_model()
    answers = model.count_all(iter(some))
    assert answers[2].refused
    counts = [answer.defect_count for answer in answers]
    assert model.predict(some).tolist() == counts
    assert (counts[0], counts[1], counts[3]) == (3, 0, 1)
    proba = model.predict_proba(some)
    assert_allclose(proba.sum(axis=1), 1)
    assert proba[2].tolist() == list(answers[2].probability.values())
    assert model.classes_.tolist() == [0, 1, 3]
    assert model.score(some[:2], [3, 1]) == 0.5
    assert model.score([some[0], some[2]], [3, counts[2]]) == 1  # a refused recording has a count too
    assert model.predict([]).shape == (0,)


@pytest.mark.slow
def test_a_domain_learned_from_other_machines_leaves_the_counts_as_they_are(some):
    """Every fifth lobe worn is unlike the training of the model, and like that of its new domain."""
    model = small_model()
    apart = [recording(tuple((seed + k) % 15 for k in (0, 5, 10)), seed=900 + seed) for seed in range(24)]
    others = labelled() + apart
    learned = model.learn_domain(others)
    assert all(model.count(one).reason.startswith("outside the training data: ") for one in apart[3:7])
    assert not any("outside" in learned.count(one).reason for one in apart[:5])
    assert learned.predict_proba(some).tolist() == model.predict_proba(some).tolist()
    assert learned.card_["domain"].startswith("48 recordings, ")
    with pytest.raises(ValueError, match="at least 2 assemblies, got 1"):
        model.learn_domain([recording((1,), seed=5, turns=2)])


def test_a_window_a_hair_outside_does_not_silence_the_others():
    def reasons(*distances):
        at, said = np.arange(3), (("",) * 3, ("unlike",) * 3)
        return AnsweredWindows(at, at + 1, np.ones((3, 1)), np.array(distances), *said, None).window_reasons()

    assert reasons(0.9, 1.1, 0.8) == ["", "", ""]
    assert reasons(0.9, 1.4, 0.8) == ["", "unlike", ""]
    assert reasons(0.9, 1.1, 1.2) == ["", "unlike", "unlike"]


def test_a_count_less_probable_than_all_others_together_is_refused():
    model = copy.copy(shaft_model())
    model.domain_ = None
    count = model.count(recording((2, 3, 4), seed=80))
    assert 0.3 < max(count.probability.values()) < 0.5
    assert count.refused
    assert count.reason.startswith("no count reaches a probability of one half: 3 has 0.4")


def test_bad_recordings_are_named(some):
    model = shaft_model()
    for ask, given, error, message in (
        (model.predict, [some[0], some[0].crop(0.0, 0.5)], ValueError, "recording 1: the .* is too short"),
        (model.predict, [[1.0, 2.0]], TypeError, "recordings must be Recording objects, got list at 0"),
        (model.predict, some[0], TypeError, "got one: use count"),
        (model.count, "rig.csv", TypeError, "recording must be a Recording object, got str"),
    ):
        with pytest.raises(error, match=message):
            ask(given)


def test_a_model_is_an_estimator_of_recordings(some):
    model = shaft_model()
    assert is_classifier(model)
    given = {"counter": "trees", "n_splits": 2, "n_trees": 20, "random_state": 0}
    assert clone(model).get_params() == LobeModel().get_params() | given
    assert not hasattr(clone(model), "counter_")
    tail = FunctionTransformer(lambda recordings: [one.crop(0.0, one.duration - 0.01) for one in recordings])
    pipeline = Pipeline([("first_turn", tail), ("count", model)])
    assert pipeline.predict(some).tolist() == model.predict(tail.transform(some)).tolist()
    # A notebook shows the card, not scikit-learn's diagram.
    assert model._repr_mimebundle_()["text/html"] == model._repr_html_()
    assert "nothing yet" in LobeModel()._repr_html_()


@pytest.fixture(scope="module")
def known():
    """Recordings that state their counts and assemblies."""
    return labelled(per_count=4)


@pytest.mark.slow
def test_fit_learns_and_changes_no_parameter(known):
    model = LobeModel(n_trees=20, n_splits=0, random_state=0)
    for ask in (model.predict, model.count_all):
        with pytest.raises(NotFittedError):
            ask(known)
    counts = [one.defect_count for one in known]
    folds = {"groups": [one.assembly for one in known], "cv": GroupKFold(2)}
    predicted = cross_val_predict(model, known, counts, **folds)
    proba = cross_val_predict(model, known, counts, method="predict_proba", **folds)
    best = np.array([0, 1, 3])[proba.argmax(axis=1)]
    assert np.mean(best == counts) > 0.8  # chance: a third
    assert_array_equal(predicted, best)
    assert not hasattr(model, "counter_")
    assert model.fit(known, counts) is model
    assert_array_equal(model.classes_, [0, 1, 3])
    assert model.locator_ is not None
    assert model.get_params() == LobeModel(n_trees=20, n_splits=0, random_state=0).get_params()
    assert model.score(known, counts) > 0.9
    assert model.fit(known, [10 * count for count in counts]).classes_.tolist() == [0, 10, 30]
    assert {*model.predict(known).tolist()} == {0, 10, 30}
    assert model.score(known, [10 * count for count in counts]) > 0.9
    blank = [one.replace(worn_lobes=None, defect_count=None) for one in known]
    assert clone(model).set_params(n_trees=5).fit(blank, counts).locator_ is None
    with pytest.raises(ValueError, match="y must hold one value per recording, shape .12,., got shape .2,."):
        model.fit(known, [0, 1])
    for wrong in ([2] * len(known), [0, *counts[:-1]]):
        with pytest.raises(ValueError, match="y contradicts the defect_count of recordings"):
            model.fit(known, wrong)


def windows_counter():
    trees = GroupCalibratedCounter(CountingTrees(20, random_state=0), n_splits=2, random_state=0)
    return make_pipeline(LobeMap(sampling_rate=1.0), trees)


@pytest.mark.slow
def test_a_nested_counter_takes_the_place_of_the_default(known):
    model = LobeModel(counter=windows_counter(), n_splits=2, random_state=0).fit(known)
    assert model.counter_[0].sampling_rate == 128
    assert (model.counter_[0].speed_tolerance, model.counter_[0].input_speed_hz) == (0, 1)
    assert model.counter[0].sampling_rate == 1  # the parameter is as it was given
    default = LobeModel(n_trees=20, n_splits=2, random_state=0).fit(known)
    assert model.card_["cross_validation"] == default.card_["cross_validation"]
    assert model.card_["calibrated"]
    assert model.count(known[1]).defect_count == known[1].defect_count


@pytest.mark.slow
def test_a_search_by_assembly_chooses_settings_of_windows_and_counter(known):
    """Of windower and of steps of the counter; and evaluate nests the search."""
    model = LobeModel(lobe_windower(), windows_counter(), n_splits=0, random_state=0)
    grid = {"windower__samples_per_turn": [64, 128], "counter__lobemap__n_lines": [10, 20]}
    search = GridSearchCV(model, grid, cv=StratifiedGroupKFold(2))
    counts, groups = [one.defect_count for one in known], [one.assembly for one in known]
    search.fit(known, counts, groups=groups)
    chosen = search.best_params_
    assert search.best_estimator_.samples_per_turn_ == chosen["windower__samples_per_turn"]
    assert search.best_estimator_.counter_[0].n_lines == chosen["counter__lobemap__n_lines"]
    assert search.score(known, counts) > 0.8
    result = evaluate(search, known, protocol=Protocol(n_splits=2, random_state=0))
    assert result.accuracy > 0.6


@pytest.mark.slow
def test_evaluation_of_recordings_states_refusals_and_windows(known):
    model = shaft_model()
    unlike = unlike_training().replace(assembly="strange", defect_count=1)
    tested = [*known, unlike.replace(torque=np.tile(unlike.torque, 2))]
    result = evaluate(model, tested, protocol=Protocol("nothing", random_state=0))
    assert result.predictions.tolist() == model.predict(tested).tolist()
    answers = model.count_all(tested)
    assert result.reasons.tolist() == [answer.reason for answer in answers]
    assert result.refused == np.mean([answer.refused for answer in answers])
    right = [a.defect_count == one.defect_count for a, one in zip(answers, tested, strict=True)]
    accepted = [not answer.refused for answer in answers]
    assert result.accepted_accuracy == np.mean(np.array(right)[accepted])
    assert sum(result.to_dict()["reasons"].values()) == sum(answer.refused for answer in answers)
    assert result.windows.labels.size == sum(len(answer.windows) for answer in answers)
    assert result.exact_lobes is None  # one recording states no worn lobes
    untrained, protocol = clone(model).set_params(n_splits=0), Protocol(n_splits=2, random_state=0)
    crossed = evaluate(untrained, known, protocol=protocol)
    assert crossed.accuracy > 0.8
    assert crossed.exact_lobes > 0.5
    assert crossed.windows.groups.tolist() == crossed.groups.tolist()


@pytest.mark.slow
def test_more_recordings_than_fit_a_batch_are_all_counted():
    """Three recordings of 153 windows, of which two fill a batch."""
    long = recording((2, 3, 4), seed=83, turns=150)
    last = recording((7,), seed=84)
    *same, other = small_model().count_all(one for one in (long, long, long, last))
    assert [len(one.windows) for one in same] == [153] * 3
    assert same[0] == same[1]
    assert [one.defect_count for one in same] == [3] * 3
    assert other.defect_count == 1


@pytest.mark.slow
@pytest.mark.parametrize(("wear_um", "alone_is_sound"), [(None, True), (2.0, False)])
def test_lines_of_the_mesh_alone_are_of_a_sound_disc_unless_training_has_worn_ones(wear_um, alone_is_sound):
    made = make_rig_recordings(
        4, (0, 3), rig=Rig(effects=[BrakeRotor(0.02, 1e4, 0.02), Noise(0.05)]), wear_um=wear_um,
        output_turns=1.05, random_state=0, with_angle=True, kernel="auto",
    )  # fmt: skip
    assert LobeModel(n_trees=5, n_splits=None).fit(made).alone_is_sound_ is alone_is_sound


@pytest.mark.slow
def test_a_disc_with_lobe_lines_is_not_called_sound_unless_training_has_such_sound_discs():
    """The labels of training are swapped: worn discs are called sound."""
    swapped = [one.replace(worn_lobes=None, defect_count=3 - one.defect_count) for one in labelled()]
    model = LobeModel(n_trees=5, n_splits=None).fit(swapped)
    worn = recording((2, 3, 4), seed=83)
    assert (model.lines_are_worn_, model.count(worn).refused) == (False, False)
    model.lines_are_worn_ = True
    assert "no worn lobe is counted" in model.count(worn).reason
