"""Recordings simulated in batches train and are counted like those of the exact kernel."""

from __future__ import annotations

import numpy as np
import pytest

import cyclofeat.datasets
from cyclofeat import Windower
from cyclofeat.cli import make_parser, train
from cyclofeat.datasets import make_rig_recordings
from cyclofeat.features import LobeMap, SpectralCentroid, SpectralEntropy, TorqueStatistics
from cyclofeat.recordings import WindowSet
from cyclofeat.recordings.windower import lobe_windower
from cyclofeat.simulators import Solver

RATE = 5120.0
SOLVER = Solver(integrator="adams_bashforth")


@pytest.fixture(scope="module")
def by_kernel() -> dict[str, WindowSet]:
    """Windows of the same eight assemblies of rig R2, at a speed that makes them short."""
    options = {
        "rig": "R2", "speed_rpm": 1500.0, "output_turns": 1.05, "sampling_rate": RATE, "random_state": 11,
    }  # fmt: skip
    return {
        kernel: Windower(output_turns=1).windows(
            make_rig_recordings(2, (0, 2, 5, 7), kernel=kernel, solver=SOLVER, with_angle=True, **options)
        )
        for kernel in ("exact", "batch")
    }


@pytest.mark.slow
@pytest.mark.parametrize("transformer", [LobeMap, SpectralCentroid, SpectralEntropy, TorqueStatistics])
def test_features_differ_by_far_less_than_assemblies_do(by_kernel, transformer):
    """Features that count cells or bins jump by one of them now and then: none of them is here."""
    exact, batch = (transformer(RATE).fit_transform(by_kernel[kernel].X) for kernel in ("exact", "batch"))
    spread = np.std(exact, axis=0)
    differs = np.abs(batch - exact)[:, spread > 0].max(axis=0) / spread[spread > 0]
    assert differs.max() < 0.005
    assert not np.array_equal(exact, batch)


@pytest.mark.slow
def test_a_motor_that_yields_to_the_load_still_fills_its_windows(monkeypatch):
    """Of 4,800 motors at all speeds and loads, number 3,818 turns least in the time of one output turn."""

    def fewer(n, counts, **options):
        return make_rig_recordings(1, [2], first_assembly=3818, **options)

    monkeypatch.setattr(cyclofeat.datasets, "make_rig_recordings", fewer)
    command = (
        "train --quantity motor_current --speeds 100:1500 --loads 3:40 --windows 1 --jobs 1 --out m.skops"
    )
    ((recording,), _) = train._simulated_recordings(
        make_parser().parse_args([*command.split(), "--assemblies", "1"])
    )
    windower = lobe_windower(15)
    assert len(windower.windows(recording)) == 1
    as_stated = round(recording.sampling_rate * 15 / recording.input_speed_hz)
    with pytest.raises(ValueError, match=r"0\.97\d* output turns, too few for a window of 0\.98"):
        windower.windows(recording.crop(0, as_stated / recording.sampling_rate))
