"""The benchmarks of speed over commits still run; their times are no matter of a test."""

import inspect

import numpy as np
import pytest

from benchmarks.asv import speed

CLASSES = [one for _, one in inspect.getmembers(speed, inspect.isclass) if one.__module__ == speed.__name__]
CASES = [(one, args) for one in CLASSES for args in [(name,) for name in getattr(one, "params", ())] or [()]]


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "args"), CASES, ids=str)
def test_a_benchmark_runs(kind, args):
    one = kind()
    one.setup(*args)
    measured = [name for name in vars(kind) if name.startswith(("time_", "peakmem_"))]
    assert measured
    for name in measured:
        getattr(one, name)(*args)


def test_windows_are_torque_around_22_nm():
    assert np.abs(speed.torque(2).mean(axis=1) - 22).max() < 0.1
