"""Cache of results, in memory and optionally on disk."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import joblib
import sklearn

from cyclofeat._base.versions import code_sha256
from cyclofeat.simulators.campaign import made_with

T = TypeVar("T")


class Memory:
    """Cache of results, by the content of their arguments and the version of the code.

    Results are stored in this process and, with a ``folder``, on disk, so that an interrupted run can
    continue. A file that cannot be read is replaced.
    """

    def __init__(self, folder: str | os.PathLike[str] | None = None) -> None:
        self._folder, self._kept = folder, dict[str, Any]()

    def __call__(self, call: Callable[[], T], kind: str, *key: Any, code: tuple[str, ...]) -> T:
        """Return the result of ``call``, computed once for equal ``kind``, ``key`` and code.

        ``kind`` is the name of the subfolder. ``code`` names folders of the package whose code affects the
        result; the simulators always do.
        """
        name = joblib.hash((kind, key, versions(*code)))
        if name not in self._kept:
            memory = joblib.Memory(None if self._folder is None else Path(self._folder) / kind, verbose=0)
            self._kept[name] = memory.cache(_called, ignore=["call"])(name, call)
        result: T = self._kept[name]
        return result


def _called(name: str, call: Callable[[], Any]) -> Any:
    return call()


def versions(*folders: str) -> dict[str, str]:
    """Versions of the simulators and of the code in some folders of the package."""
    package = Path(__file__).parents[2]
    files = sorted(path for folder in folders for path in (package / folder).rglob("*.py"))
    return made_with() | {"code_sha256": code_sha256(package, files), "scikit-learn": sklearn.__version__}
