"""Overlays of recordings and models: amplitudes, orders and densities by construction."""

from __future__ import annotations

import numpy as np
import pytest

from cyclofeat.gap import Comparison, Condition
from cyclofeat.gap.overlays import Overlay, summarise_overlays

RATE, SPEED = 6400.0, 500 / 60
TIME = np.arange(round(1.8 * RATE)) / RATE
COMPARISON = Comparison(sampling_rate=RATE)


def made(*parts: float, n: int = 6) -> np.ndarray:
    """Records of 22 Nm, with noise, lines of the mesh for the speed, and a line of 1.5 Nm at ``parts`` Hz."""
    random = np.random.default_rng(1)
    mesh = sum(np.cos(2 * np.pi * 16 * k * SPEED * TIME) for k in (1, 2, 3, 4))
    lines = sum(1.5 * np.cos(2 * np.pi * hz * TIME) for hz in parts)
    return 22 + 0.2 * mesh + lines + 0.05 * random.normal(size=(n, TIME.size))


def by_kind(*sets: np.ndarray | None) -> dict[str, Overlay]:
    return {overlay.kind: overlay for overlay in summarise_overlays(COMPARISON, *sets)}


def test_spectrum_holds_the_rms_of_a_line_and_all_of_the_noise() -> None:
    spectrum = by_kind(made(200.0), made())["spectrum"]
    at = np.argmin(np.abs(np.log(spectrum.x / 200)))
    # 200 Hz is a bin of 1.8 s: its neighbours, too, lie within the band.
    assert spectrum.measured.mean[at] == pytest.approx(1.5 / np.sqrt(2), rel=0.01)
    assert spectrum.model.mean[at] < 0.02
    white = 22 + np.random.default_rng(2).normal(size=(20, TIME.size))
    noise = summarise_overlays(COMPARISON, white, white)[0]
    # Up to 0.4 of the rate lie four fifths of its power.
    assert np.sum(noise.measured.mean**2) == pytest.approx(0.8, rel=0.03)


def test_orders_hold_the_amplitudes_at_the_speed_of_each_record() -> None:
    orders = by_kind(made(6 * SPEED), made())["orders"]
    at = {round(float(order), 4): k for k, order in enumerate(orders.x)}
    assert orders.measured.mean[at[6.0]] == pytest.approx(1.5, rel=0.02)
    assert orders.measured.mean[at[16.0]] == pytest.approx(0.2, rel=0.02)
    assert orders.model.mean[at[6.0]] < 0.01
    assert orders.x[-1] == 36


def test_densities_integrate_to_one() -> None:
    random = np.random.default_rng(3)
    flat = random.uniform(20, 24, size=(5, TIME.size))
    distribution = by_kind(flat, flat + 1)["distribution"]
    step = distribution.x[1] - distribution.x[0]
    for band in (distribution.measured, distribution.model):
        assert step * band.mean.sum() == pytest.approx(1, abs=0.002)
    inside = (distribution.x > 20.2) & (distribution.x < 23.8)
    assert distribution.measured.mean[inside] == pytest.approx(0.25, rel=0.1)


def test_bands_hold_nine_in_ten_recordings() -> None:
    loud = np.linspace(1, 2, 101)[:, None] * np.sin(2 * np.pi * 200 * TIME)
    spectrum = by_kind(made(n=1)[:, :] + loud, made())["spectrum"]
    at = np.argmin(np.abs(np.log(spectrum.x / 200)))
    band = spectrum.measured
    assert [band.low[at], band.high[at]] == pytest.approx(np.array([1.05, 1.95]) / np.sqrt(2), rel=0.01)
    assert band.low[at] < band.mean[at] < band.high[at]


def test_condition_and_corrected_model() -> None:
    corrected = by_kind(made(), made(), made(200.0))
    assert {overlay.condition for overlay in corrected.values()} == {Condition(500.0, 22.0)}
    assert all(overlay.corrected is not None for overlay in corrected.values())
    assert all(overlay.corrected is None for overlay in by_kind(made(), made()).values())


def test_refusals() -> None:
    with pytest.raises(ValueError, match=r"must be of equal length in samples, got .*'model': 11519"):
        summarise_overlays(COMPARISON, made(), made()[:, 1:])
    broken = made()
    broken[0, 7] = np.nan
    with pytest.raises(ValueError, match="corrected contains NaN"):
        summarise_overlays(COMPARISON, made(), made(), broken)
