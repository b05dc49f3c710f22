"""Transformers of statistics and entropy: names, agreement with the pure functions, examples."""

import numpy as np
from numpy.testing import assert_array_equal
from sklearn.base import clone
from sklearn.ensemble import RandomForestClassifier
from sklearn.model_selection import GridSearchCV
from sklearn.pipeline import make_pipeline, make_union
from transformers import SAMPLING_RATE, STATISTICS, torque

from cyclofeat.features import SpectralEntropy, TorqueStatistics
from cyclofeat.features.registry import REGISTRY, Feature, band_qualifier
from cyclofeat.signal import normalized_entropy, shannon_entropy, torque_statistics, welch_psd

# Names: stored models and reports hold them, so they are written out here.


def test_names_and_order_of_the_features():
    X = torque(2, 500)
    names = {str(t): clone(t).fit(X).get_feature_names_out().tolist() for t in STATISTICS}
    assert names == {
        "TorqueStatistics(sampling_rate=25600)": [
            "torque_min_nm",
            "torque_max_nm",
            "torque_mean_nm",
            "torque_std_nm",
            "torque_range_nm",
            "torque_rms_nm",
            "torque_crest_factor",
            "torque_skewness",
            "torque_kurtosis",
            "torque_ripple",
        ],
        "SpectralEntropy(sampling_rate=25600)": ["shannon_entropy_bits(matlab_pwelch)"],
        "SpectralEntropy(preset='ripple', sampling_rate=25600)": ["shannon_entropy_bits(ripple)"],
        "SpectralEntropy(band=(0.0, 1500.0), normalize=True, sampling_rate=25600)": [
            "normalized_entropy(matlab_pwelch;0..1500Hz)"
        ],
    }


def test_registry_rows_are_complete():
    for name, row in REGISTRY.items():
        assert name == row.name
        assert all((row.unit, row.formula, row.source))
        assert row.version >= 1
        # Characters that XGBoost, LightGBM or CSV files choke on
        assert not set(row.column("matlab_pwelch", band_qualifier((0.5, 1e-5)))) & set('[]{}<>,:" \\')


def test_a_new_definition_gets_a_new_name():
    row = Feature("torque_mean", "Nm", "median(x)", "nowhere", version=2)
    assert row.column() == "torque_mean_nm(v2)"
    assert row.column("lobe03") == "torque_mean_nm(lobe03;v2)"


# Values


def test_values_are_those_of_the_pure_functions():
    X = torque(4, 2000)
    assert_array_equal(
        TorqueStatistics(SAMPLING_RATE).fit_transform(X), np.column_stack([*torque_statistics(X).values()])
    )
    for preset in ("matlab_pwelch", "ripple"):
        frequencies, psd = welch_psd(X, SAMPLING_RATE, preset)
        for band in (None, (100.0, 3000.0)):
            for normalize, entropy in [(False, shannon_entropy), (True, normalized_entropy)]:
                transformer = SpectralEntropy(SAMPLING_RATE, preset, band, normalize=normalize).fit(X)
                assert_array_equal(transformer.transform(X), entropy(psd, frequencies, band)[:, np.newaxis])
                assert_array_equal(transformer.frequencies_, frequencies)


def test_pipelines_search_and_name():
    X = np.vstack([torque(12, 500), 22 + 3 * (torque(12, 500) - 22)])
    y = np.repeat(["healthy", "worn"], 12)
    union = make_union(TorqueStatistics(SAMPLING_RATE), SpectralEntropy(SAMPLING_RATE))
    search = GridSearchCV(
        make_pipeline(union, RandomForestClassifier(10, random_state=0)),
        {"featureunion__spectralentropy__preset": ["matlab_pwelch", "ripple"]},
        cv=2,
        error_score="raise",
    ).fit(X, y)
    assert search.best_score_ > 0.9
    frame = union.set_output(transform="pandas").fit_transform(X)
    assert frame.columns[-1] == "spectralentropy__shannon_entropy_bits(matlab_pwelch)"
