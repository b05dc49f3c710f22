"""numba's ``njit`` with a cache on disk where one can be written, and without one where it cannot."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba


def njit(**options: Any) -> Any:
    """Compile on first use and keep the result on disk; every use states ``fastmath``."""

    def compile_lazily(function: Callable[..., Any]) -> Any:
        try:
            return numba.njit(cache=True, error_model="numpy", **options)(function)
        except RuntimeError:  # no folder for the cache can be written
            return numba.njit(error_model="numpy", **options)(function)

    return compile_lazily
