"""Base of all rooms; here, how ``plot`` of recordings and results finds the displays, which lie above.

They register here; the root of the package, which knows all rooms, says how they are loaded
(:func:`load_with`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

Draw = Callable[..., Any]  # (object, ax, **options) -> display

_KINDS: dict[str, Mapping[str, Draw]] = {}
_LOADERS: list[Callable[[], object]] = []


def load_with(load: Callable[[], object]) -> None:
    """Have the displays loaded by a function when something is first drawn."""
    _LOADERS[:] = [load]


def register_plots(name: str, kinds: Mapping[str, Draw]) -> None:
    """Let objects of a class, by its name, be drawn in some kinds of pictures."""
    _KINDS[name] = kinds


def draw_plot(drawn: object, kind: str, ax: Any, **options: Any) -> Any:
    """Draw an object on axes or, where ``ax`` is None, on new ones, and return the display."""
    for load in _LOADERS:
        load()
    kinds = next(_KINDS[cls.__name__] for cls in type(drawn).__mro__ if cls.__name__ in _KINDS)
    if kind not in kinds:
        raise ValueError(f"kind must be one of {', '.join(map(repr, kinds))}, got {kind!r}")
    return kinds[kind](drawn, ax, **options)
