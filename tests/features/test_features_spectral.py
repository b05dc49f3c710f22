"""Transformers of statistics and spectra, and their composite: names, values, parameters, properties."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from sklearn import config_context
from sklearn.base import clone
from sklearn.pipeline import make_pipeline
from transformers import RATE, SPECTRAL, STATISTICS, torque

from cyclofeat import features as f
from cyclofeat import signal
from cyclofeat.features.registry import REGISTRY, Feature, band_qualifier

PARTS = [*(name for name in f.__all__ if name not in ("HighPass", "TorqueFeatures")), "NormalizedEntropy"]

# Names: stored models and reports hold them, so they are written out here.


def test_names_and_order_of_the_features():
    X = torque(2, 500)
    names = [clone(t).fit(X).get_feature_names_out().tolist() for t in [*STATISTICS, *SPECTRAL[:-2]]]
    expected = [
        [
            *(f"torque_{name}_nm" for name in ("min", "max", "mean", "std", "range", "rms")),
            *(f"torque_{name}" for name in ("crest_factor", "skewness", "kurtosis", "ripple")),
        ],
        ["shannon_entropy_bits(matlab_pwelch)"],
        ["shannon_entropy_bits(ripple)"],
        ["normalized_entropy(matlab_pwelch;0..1500Hz)"],
        ["spectral_flatness(ripple)"],
        ["spectral_flatness(ripple;100..5000Hz;part0of2)", "spectral_flatness(ripple;100..5000Hz;part1of2)"],
        ["spectral_centroid_hz(ripple)"],
        [f"spectral_centroid_hz(ripple;part{part:02d}of12)" for part in range(12)],
        ["spectral_rolloff_hz(ripple;fraction0.95)"],
        ["spectral_rolloff_hz(ripple;100..5000Hz;fraction0.5)"],
        ["narrowband_ratio(ripple;allx100Hz+-5Hz)"],
        ["narrowband_ratio(ripple;7x133.3Hz+-10.5Hz)"],
        ["band_power_nm2(matlab_pwelch;0..1500Hz)", "band_power_nm2(matlab_pwelch;200..800Hz)"],
        ["psd_nm2_per_hz(matlab_pwelch;400Hz)", "psd_nm2_per_hz(matlab_pwelch;500Hz)"],
        ["psd_level_db(ripple;400Hz)", "psd_level_db(ripple;500Hz)"],
        ["amplitude_nm(hamming8192;12.5Hz)"],
        ["amplitude_nm(hann64;0Hz)", "amplitude_nm(hann64;400Hz)"],
        ["coherence(mscohere;healthy;0..1500Hz)"],
        ["coherence(mscohere;first;0..1500Hz)", "coherence(mscohere;first;100..300Hz)"],
        [f"order_amplitude_nm(output;k{k:03};v2)" for k in (1, 2, *range(224, 257))],
        [f"order_amplitude_nm(output;k{k:02};v2)" for k in range(1, 61)],
        [f"x{sample}" for sample in range(500)],
    ]
    assert names == expected


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


@pytest.mark.parametrize("preset", ["matlab_pwelch", "ripple"])
@pytest.mark.parametrize("band", [None, (100.0, 3000.0)])
def test_values_are_those_of_the_pure_functions(preset, band):
    X = torque(4, 2000)
    statistics = signal.torque_statistics(X)
    assert_array_equal(f.TorqueStatistics(RATE).fit_transform(X), np.column_stack([*statistics.values()]))
    lines, psd = signal.welch_psd(X, RATE, preset)
    entropy = f.SpectralEntropy(RATE, preset, band)
    around = 133.3, 60, 4
    for transformer, expected in [
        (entropy, signal.shannon_entropy(psd, lines, band)),
        (clone(entropy).set_params(normalize=True), signal.normalized_entropy(psd, lines, band)),
        (f.SpectralFlatness(RATE, preset, band), signal.spectral_flatness(psd, lines, band)),
        (f.SpectralCentroid(RATE, preset, band), signal.spectral_centroid(psd, lines, band)),
        (f.SpectralRolloff(RATE, preset, band, fraction=0.9), signal.spectral_rolloff(psd, lines, 0.9, band)),
        (f.NarrowbandRatio(RATE, preset, *around), signal.narrowband_ratio(psd, lines, *around)),
    ]:
        assert_array_equal(transformer.fit_transform(X)[:, 0], expected)
        assert_array_equal(transformer.frequencies_, lines)
    bands = None if band is None else [band, (0, 50)]
    powers = f.BandPower(RATE, preset, bands).fit_transform(X)
    assert_array_equal(powers, signal.band_power(psd, lines, bands))
    inside = slice(None) if band is None else (lines >= band[0]) & (lines <= band[1])
    density = f.WelchPSD(RATE, preset, band).fit_transform(X)
    assert_array_equal(density, psd[:, inside])
    level = f.WelchPSD(RATE, preset, band, decibels=True).fit_transform(X)
    assert_allclose(10 ** (level / 10), density, rtol=1e-12)
    lines, amplitudes = signal.amplitude_spectrum(X, RATE, 512, "blackman")
    inside = slice(None) if band is None else (lines >= band[0]) & (lines <= band[1])
    result = f.AmplitudeSpectrum(RATE, 512, "blackman", band).fit_transform(X)
    assert_array_equal(result, amplitudes[:, inside])


@pytest.mark.parametrize("n_samples", [1, 3, 4, 9, 2003])
def test_a_course_is_the_value_of_each_part(n_samples):
    X = torque(3, n_samples)
    length = max(n_samples // 4, 1)
    course = f.SpectralCentroid(RATE, n_parts=4).fit(X)
    starts = [min(part * length, n_samples - length) for part in range(4)]
    whole = f.SpectralCentroid(RATE)
    expected = [whole.fit_transform(X[:, start : start + length])[:, 0] for start in starts]
    assert_allclose(course.transform(X), np.column_stack(expected), rtol=1e-12)


def test_a_course_follows_a_rising_tone():
    """Paper A section 5.4: higher frequencies in a part of the window raise its centroid and roll-off."""
    time = np.arange(46_080) / RATE
    sweep = np.cos(2 * np.pi * (200 * time + 500 * time**2))[np.newaxis]
    for transformer in (f.SpectralCentroid, f.SpectralRolloff):
        course = transformer(RATE, preset="ripple", n_parts=9).fit_transform(22 + sweep)[0]
        assert (np.diff(course) > 150).all()
        assert (np.diff(course) < 250).all()


def test_high_pass_goes_before_any_other():
    X = torque(3, 5000) + 3 * np.sin(2 * np.pi * np.arange(5000) / RATE)
    alone = f.SpectralEntropy(RATE)
    pipeline = make_pipeline(f.HighPass(RATE, cutoff_hz=50.0, order=3), clone(alone))
    assert_array_equal(pipeline.fit_transform(X), alone.fit_transform(signal.high_pass(X, RATE, 50.0, 3)))
    assert_array_equal(pipeline.get_feature_names_out(), alone.get_feature_names_out())


# The composite


@pytest.mark.parametrize("preset", ["matlab_pwelch", "ripple"])
@pytest.mark.parametrize("n_samples", [50, 9000])  # too short for lobe lines, and not
def test_composite_is_its_parts_side_by_side(preset, n_samples):
    X = torque(5, n_samples)
    y = [0, 7, 0, 7, 0]
    whole = f.TorqueFeatures(RATE, PARTS, preset=preset, wavelet="db4").fit(X, y)
    assert list(whole.parts_) == PARTS
    parts = [clone(part).fit(X, y) for part in whole.parts_.values()]
    assert_array_equal(whole.transform(X), np.hstack([part.transform(X) for part in parts]))
    assert_array_equal(
        whole.get_feature_names_out(), np.concatenate([part.get_feature_names_out() for part in parts])
    )


def test_all_is_every_transformer_of_numbers():
    """A new transformer has to be entered in the composite or here."""
    parts = f.TorqueFeatures(RATE).fit(torque(2, 500), [0, 1]).parts_
    assert {*PARTS} - {*parts} == {"WelchPSD", "AmplitudeSpectrum"}


def test_parameters_reach_the_parts():
    whole = f.TorqueFeatures(RATE, preset="ripple", wavelet="db2", input_speed_hz=5, n_lobes=13)
    parts = whole.set_params(speed_tolerance=0.01).fit(torque(2, 500)).parts_
    expected = {
        "sampling_rate": RATE, "preset": "ripple", "wavelet": "db2", "input_speed_hz": 5, "shaft_hz": 5,
        "n_lobes": 13, "n_pins": 14, "speed_tolerance": 0.01,
    }  # fmt: skip
    seen = set()
    for part in parts.values():
        common = part.get_params().keys() & expected.keys()
        assert {name: part.get_params()[name] for name in common} == {name: expected[name] for name in common}
        seen |= common
    assert seen == expected.keys()


def test_threads_change_nothing():
    X = torque(5, 3000)
    one = f.TorqueFeatures(RATE).fit(X)
    two = f.TorqueFeatures(RATE, n_jobs=2).fit(X)
    with config_context(working_memory=6000 / 2**17):
        assert_array_equal(two.transform(X), one.transform(X))


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"features": ["LobeMap", "Entropy"]}, r"names of TorqueStatistics.*got \['LobeMap', 'Entropy'\]"),
        ({"features": ["LobeMap", "LobeMap"]}, r"different names of .*; got \['LobeMap', 'LobeMap'\]"),
        ({"features": []}, r"'all' or different names of .*; got \[\]"),
        ({"features": [3]}, r"got \[3\]"),
        ({"wavelet": "db99"}, "got 'db99'"),
        (
            {"sampling_rate": 600.0, "features": ["LobeMap"]},
            "n_lines=44 lobe lines at input_speed_hz=8.33333 reach 396.978",
        ),
    ],
)
def test_bad_parameters_of_the_composite(parameters, message):
    with pytest.raises(ValueError, match=message):
        f.TorqueFeatures(**{"sampling_rate": RATE, **parameters}).fit(torque(2, 500))


def test_order_lines_do_not_see_the_mean():
    X = np.round(1024 * torque(3, 4000)) / 1024
    before, after = (f.OrderSpectrum(RATE).fit_transform(windows) for windows in (X, X + 1000))
    assert_allclose(after, before, rtol=1e-6, atol=1e-9)
