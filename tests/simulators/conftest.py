"""Fixtures of the simulators' tests."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from threadpoolctl import threadpool_limits


@pytest.fixture(autouse=True, scope="module")
def _one_blas_thread() -> Iterator[None]:
    """A 141 x 141 solve is too small to share: threads only make it slower."""
    with threadpool_limits(1):
        yield
