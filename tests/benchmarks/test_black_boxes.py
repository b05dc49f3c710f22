"""The alternatives that the benchmark of the gap compares the corrected model with."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import signal

from benchmarks import _black_boxes
from cyclofeat.gap import Comparison
from cyclofeat.gap.proof.prove import prove
from cyclofeat.simulators import (
    BrakeRotor,
    CycloidalGearbox,
    Noise,
    Rig,
    Scale,
)

FS, N = 6400.0, 11_520
# At the usual speed: the averaged spectra of the equaliser take long records.
BASE = Rig(CycloidalGearbox.steel(ramp_time=0.05), [BrakeRotor(0.005, 1e4, 0.05), Noise(0.05)], name="R1")


def test_equaliser_recovers_a_filter_and_noise() -> None:
    """White noise through a known filter, and with noise added in the place of it."""
    rng = np.random.default_rng(5)
    X = 22 + 0.3 * rng.normal(size=(6, N))
    b, a = signal.butter(2, 800, fs=FS)
    filtered = 22.5 + signal.lfilter(b, a, X - 22, axis=1)
    box = _learned(_black_boxes.Equaliser, filtered, X)
    changed = np.array([box._changed(x, 0, np.random.default_rng(0)) for x in X])
    assert changed.mean() == pytest.approx(22.5, abs=0.01)
    frequencies, wanted = _black_boxes.averaged_psd(filtered, FS)
    _, got = _black_boxes.averaged_psd(changed, FS)
    band = (frequencies > 20) & (frequencies < 1500)
    difference = 10 * np.log10(got.mean(axis=0)[band] / wanted.mean(axis=0)[band])
    assert abs(np.mean(difference)) < 0.2
    assert np.std(difference) < 1.0
    loud = 22 + 3.0 * rng.normal(size=(6, N))  # ten times the amplitude: gain stops at 2, noise does the rest
    box = _learned(_black_boxes.Equaliser, loud, X)
    changed = np.array([box._changed(x, 0, np.random.default_rng(k)) for k, x in enumerate(X)])
    assert changed.std() == pytest.approx(3.0, rel=0.05)
    assert np.corrcoef(changed[0], X[0])[0, 1] < 0.5


def _learned(kind: type, measured: np.ndarray, simulated: np.ndarray) -> _black_boxes.FilteredModel:
    box = kind(12)
    box.sampling_rate_, box.by_count_ = FS, True
    frequencies, of_measured = _black_boxes.averaged_psd(measured, FS)
    _, of_simulated = _black_boxes.averaged_psd(simulated, FS)
    box._learn(
        frequencies,
        np.array([0]),
        of_measured.mean(axis=0)[None],
        of_simulated.mean(axis=0)[None],
        np.array([measured.mean() - simulated.mean()]),
    )
    return box


def test_gaussian_process_extrapolates_over_the_count() -> None:
    """Gain in dB and offset that are linear in the count: learnt from four counts, asked at another."""
    rng = np.random.default_rng(6)
    counts = np.array([0, 1, 2, 4])
    frequencies, of_simulated = _black_boxes.averaged_psd(0.3 * rng.normal(size=(8, N)), FS)
    simulated = np.tile(of_simulated.mean(axis=0), (4, 1))
    measured = simulated * 10 ** (2.0 * counts / 10)[:, None]
    box = _black_boxes.GaussianProcessGap(12)
    box.sampling_rate_, box.by_count_ = FS, True
    box._learn(frequencies, counts, measured, simulated, 0.1 * counts)
    x = 22 + 0.3 * rng.normal(size=N)
    changed = box._changed(x, 3, rng)
    assert 20 * np.log10(changed.std() / x.std()) == pytest.approx(6.0, abs=0.5)
    assert changed.mean() - x.mean() == pytest.approx(0.3, abs=0.03)


@pytest.mark.slow
def test_retuned_finds_the_contacts_of_the_rig() -> None:
    """Contacts of half the stiffness and three times the damping, and nothing else is added."""
    truth = [Scale("contact_stiffness", 0.5), Scale("contact_damping", 3.0)]
    comparison = Comparison(sampling_rate=FS, rig=BASE, random_state=0)
    bank = comparison.replace(rig=BASE.with_added(*truth)).bank(8, [0, 4], random_state=5)
    retuned = _black_boxes.Retuned(10).fit(comparison, comparison.measured(bank.X, y=bank.counts))
    assert retuned.rig_.without("contact_stiffness_scale", "contact_damping_scale") == BASE
    found = {effect.effect_id: effect for effect in retuned.rig_.effects}
    assert found["contact_stiffness_scale"].factor == pytest.approx(0.5, rel=0.15)
    assert found["contact_damping_scale"].factor == pytest.approx(3.0, rel=0.4)


@pytest.mark.slow
def test_equaliser_closes_a_gap_of_noise_where_it_was_fitted() -> None:
    """On counts of its fit, but by less than the true effect over all counts."""
    comparison = Comparison(sampling_rate=FS, rig=BASE, random_state=0)
    truth = BASE.with_added(Noise(0.3))
    fit, hold = (
        comparison.measured(bank.X, bank.counts)
        for bank in (
            comparison.replace(rig=truth).bank(n, counts, random_state=seed)
            for n, counts, seed in ((4, [0, 4], 101), (9, [0, 4, 7], 102))
        )
    )
    box = _black_boxes.Equaliser(10).fit(comparison, fit)
    proof = prove(
        comparison, truth, hold, fitted_counts=fit.counts, n_simulated=10, others={"equaliser": box.records}
    )
    by = {(row.alternative, row.condition): row.grr for row in proof.rows}
    assert by["equaliser", "seen"] > 0.6
    assert by["after", "all"] > by["equaliser", "all"]
