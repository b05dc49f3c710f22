"""numba's ``njit`` with a cache on disk where one can be written, and addresses of arrays."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba
import numba.types
from numba.core.extending import intrinsic

_types: Any = numba.types
_config: Any = numba.config


def njit(**options: Any) -> Any:
    """Compile on first use and keep the result on disk; every use states ``fastmath``."""

    def compile_lazily(function: Callable[..., Any]) -> Any:
        try:
            return numba.njit(cache=True, error_model="numpy", **options)(function)
        except RuntimeError:  # no folder for the cache can be written
            return numba.njit(error_model="numpy", **options)(function)

    return compile_lazily


def inner_njit(**options: Any) -> Any:
    """As :func:`njit`, for functions that only compiled functions call and whose cache holds them.

    Each saves a fifth of a second or more at the first call.
    """
    compiler: Any = numba.njit  # whose stated types lack these options
    return compiler(error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True, **options)


# Interpreted functions take the arrays themselves.
_intrinsic: Any = (lambda function: lambda arrays: arrays) if _config.DISABLE_JIT else intrinsic


@_intrinsic
def addresses(typingctx: Any, arrays: Any) -> Any:
    """Addresses of the first elements of contiguous arrays (a tuple), which are indexed like the arrays.

    None stays None.

    numba counts references to an array wherever a branch hands it to a function, which costs a quarter of the
    kernel's time; it counts none to an address. The arrays have to be kept elsewhere as long.
    """

    def generate_ir(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        values = (builder.extract_value(arguments[0], i) for i in range(len(arrays)))
        pointers = [
            context.make_array(kind)(context, builder, value).data if kind is not _types.none else value
            for kind, value in zip(arrays, values, strict=True)
        ]
        return context.make_tuple(builder, signature.return_type, pointers)

    kinds = [_types.CPointer(kind.dtype) if kind is not _types.none else kind for kind in arrays]
    return _types.Tuple(kinds)(arrays), generate_ir
