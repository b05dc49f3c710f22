"""The report of an evaluation: the score with its interval first, and how it came about."""

import json

import numpy as np
import pytest
from matplotlib.figure import Figure
from pages import assert_in_order, parse, read_words, small_windows, summary_of, words
from sklearn.naive_bayes import GaussianNB

from cyclofeat.counting import evaluate
from cyclofeat.report import write_evaluation_report


@pytest.fixture(scope="module")
def data():
    return small_windows(60)


@pytest.fixture(scope="module")
def results(data):
    return {
        "bayes & co": evaluate(GaussianNB(), *data),
        "shrunk": evaluate(GaussianNB(var_smoothing=0.5), *data),
    }


@pytest.fixture(scope="module")
def page(data, results, tmp_path_factory):
    path = tmp_path_factory.mktemp("evaluation") / "evaluation.html"
    write_evaluation_report(
        results, path, sources=["surrogate"] * 60, folds="5 folds, seed 0", settings={"files": "x"}
    )
    return path.read_text(encoding="utf-8")


@pytest.mark.slow
def test_the_score_comes_first_with_its_interval(page, results):
    result = results["bayes & co"]
    low, high = result.accuracy_interval
    order = [
        "All recordings are SIMULATED", f"Accuracy {result.accuracy:.3f} {low:.3f} to {high:.3f}",
        "120 windows of 60 assemblies", "Methods on the same folds", "shrunk",
        "Details of bayes & co", "Confusion", "On the diagonal, answers are right as often as stated",
        "Each count by itself", "Assemblies counted wrong", "How the folds were made",
        "stratified; 5 folds, seed 0", "What the words mean", "Made from",
    ]  # fmt: skip
    assert_in_order(words(parse(page)), order)
    assert "A<" not in page


@pytest.mark.slow
def test_each_count_is_that_of_the_confusion_matrix(data, results):
    _, y, groups = data
    found = summary_of(write_evaluation_report, results)
    said = results["bayes & co"].predictions
    for row in found["classes"]:
        count = row["defect_count"]
        assert row["n_windows"] == np.sum(y == count)
        assert row["n_assemblies"] == 20
        assert row["recall"] == pytest.approx(np.mean(said[y == count] == count))
        assert row["precision"] == pytest.approx(np.mean(y[said == count] == count))
    wrong = {name for name in np.unique(groups) if np.any(said[groups == name] != y[groups == name])}
    assert len(found["wrong"]) + found["n_more_wrong"] == len(wrong)
    assert {row["assembly"] for row in found["wrong"]} <= wrong
    assert found["guess"] == pytest.approx(1 / 3)
    json.dumps(found)


def test_calibration_is_drawn_as_it_is(data, results):
    y, result = data[1], results["bayes & co"]
    ax = result.plot("calibration", Figure().subplots()).ax_
    said, was = ax.collections[0].get_offsets().T
    weight = (ax.collections[0].get_sizes() - 25) / 500
    probability = result.probabilities.max(axis=1)
    bins = np.minimum((10 * probability).astype(int), 9)
    for k, b in enumerate(np.unique(bins)):
        assert said[k] == pytest.approx(probability[bins == b].mean())
        assert was[k] == pytest.approx((result.predictions == y)[bins == b].mean())
    assert weight.sum() == pytest.approx(1)
    assert float(np.sum(weight * np.abs(said - was))) == pytest.approx(result.calibration_error)
    (diagonal,) = (line for line in ax.lines if line.get_label() == "right as often as stated")
    assert diagonal.get_xydata().tolist() == [[0, 0], [1, 1]]
    texts = {text.get_text().split(":")[0]: text.get_position() for text in ax.texts}
    assert texts["too careful"][1] > texts["too careful"][0]
    assert texts["too sure"][1] < texts["too sure"][0]


def test_the_confusion_is_drawn_as_it_is(results):
    result = results["bayes & co"]
    ax = result.plot(ax=Figure().subplots()).ax_
    assert [int(text.get_text()) for text in ax.texts] == result.confusion.ravel().tolist()


@pytest.mark.slow
def test_nothing_wrong_is_said_with_its_limit(data, tmp_path):
    _, y, groups = data
    perfect = evaluate(GaussianNB(), y[:, np.newaxis] + 1e-3 * np.arange(120)[:, np.newaxis] / 120, y, groups)
    text = read_words(write_evaluation_report({"a": perfect}, tmp_path / "a.html"))
    assert "None: every window of every assembly was counted right" in text
    assert "SIMULATED" not in text


def test_reports_refuse(data, results, tmp_path):
    with pytest.raises(ValueError, match="results must hold"):
        write_evaluation_report({}, tmp_path / "a.html")
    fewer = evaluate(GaussianNB(), *(values[6:] for values in data))
    with pytest.raises(ValueError, match="same windows, but 'fewer' is of others than 'bayes & co'"):
        write_evaluation_report(results | {"fewer": fewer}, tmp_path / "a.html")
