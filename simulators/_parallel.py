"""Work in processes that may end before all of it is done."""

from __future__ import annotations

import warnings
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from typing import Any


@contextmanager
def stopped_quietly(made: Generator[Any, None, None]) -> Iterator[Generator[Any, None, None]]:
    """joblib's results as they come; what is still under way at the end is given up."""
    try:
        yield made
    finally:
        with warnings.catch_warnings():
            # After an error joblib would warn that the runs still under way are given up.
            warnings.simplefilter("ignore", UserWarning)
            made.close()
