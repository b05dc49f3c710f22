"""Ranking of features by how they depend on the count."""

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose
from scipy import stats

from cyclofeat.counting import rank_features
from cyclofeat.features import TorqueFeatures
from cyclofeat.report import write_features_report

COUNT = np.repeat([0, 2, 4], 20)
ASSEMBLY = np.arange(60) // 2
noise = np.random.default_rng(0).normal(size=(60, 4))
NAMES = ["gradual", "falls", "noise", "constant"]
FEATURES = pd.DataFrame(noise * [0.5, 0.1, 1, 0] + np.outer(COUNT, [1, -1, 0, 0]), columns=NAMES)


def test_numbers_are_those_of_assemblies():
    table = rank_features(FEATURES, COUNT, ASSEMBLY, random_state=0)
    means = FEATURES.groupby(ASSEMBLY).mean()
    samples = [means.noise[COUNT[::2] == count] for count in (0, 2, 4)]
    row = table.loc["noise"]
    assert_allclose([row.anova_f, row.kruskal_h], [stats.f_oneway(*samples)[0], stats.kruskal(*samples)[0]])
    assert row.trend == pytest.approx(stats.spearmanr(means.noise, COUNT[::2])[0])
    assert row.trend_low < row.trend < row.trend_high
    assert set(table.index[:2]) == {"gradual", "falls"}
    assert table.monotonicity[["gradual", "falls"]].tolist() == [1, -1]
    assert (table.loc[["gradual", "falls"], ["anova_p", "kruskal_p"]] < 1e-3).all(axis=None)
    assert table.mutual_information["gradual"] > 1 > table.mutual_information["noise"]
    assert table.loc["constant", ["trend", "anova_f", "kruskal_h", "monotonicity"]].tolist() == [0] * 4
    assert table.notna().all(axis=None)


@pytest.mark.parametrize(
    ("y", "groups", "words"),
    [
        (COUNT, ASSEMBLY // 30, "assembly 0 has several counts"),
        (COUNT, COUNT, "count 0 must have at least two assemblies"),
        (COUNT * 0, ASSEMBLY, "at least two classes"),
    ],
)
def test_labels_are_checked(y, groups, words):
    with pytest.raises(ValueError, match=words):
        rank_features(FEATURES, y, groups)


def test_page_holds_table_histograms_and_code(tmp_path):
    table = rank_features(FEATURES, COUNT, ASSEMBLY, random_state=0)
    page = write_features_report(
        table, FEATURES, COUNT, ASSEMBLY, tmp_path / "p.html", transformer=TorqueFeatures(25_600)
    ).read_text()
    assert all(name in page for name in FEATURES)
    assert page.count("data:image/svg") == 4  # once for light and dark
    assert "features = TorqueFeatures(sampling_rate=25600)" in page
