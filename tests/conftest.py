"""Simulated recordings that several test modules share."""

import pytest

from cyclofeat.datasets import make_rig_recordings
from cyclofeat.simulators import Rig


@pytest.fixture(scope="session")
def surrogates():
    """Eight surrogate assemblies of rig R1 for each of four defect counts."""
    return make_rig_recordings(8, (0, 1, 3, 5), rig=Rig.r1(), random_state=11, n_jobs=2, with_angle=True)
