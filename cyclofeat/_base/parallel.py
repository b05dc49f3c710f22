"""Work in several processes or threads that may end early."""

from __future__ import annotations

import warnings
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from typing import Any


@contextmanager
def stopped_quietly(results: Generator[Any, None, None]) -> Iterator[Generator[Any, None, None]]:
    """Yield joblib's generator of results and close it, without the warning of calls that still run."""
    try:
        yield results
    finally:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            results.close()
