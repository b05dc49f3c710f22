"""Records of the versions and of the code that made a result."""

from __future__ import annotations

import functools
import hashlib
import importlib.metadata
import platform
from collections.abc import Iterable
from pathlib import Path

# What a stored model depends on.
MODEL_PACKAGES = ("cyclofeat", "python", "numpy", "scipy", "scikit-learn", "joblib", "numba")


def package_versions(*names: str) -> dict[str, str]:
    """Return installed versions by the name of the distribution; ``"python"`` is the interpreter's.

    Examples
    --------
    >>> list(package_versions("python", "numpy"))
    ['python', 'numpy']
    """
    return {name: _version(name) for name in names}


@functools.cache
def _version(name: str) -> str:
    return platform.python_version() if name == "python" else importlib.metadata.version(name)


def code_sha256(root: Path, files: Iterable[Path]) -> str:
    """Return the SHA-256 of source files: of their paths below ``root`` and their content, in this order."""
    code = hashlib.sha256()
    for path in files:
        code.update(path.relative_to(root).as_posix().encode() + b"\0" + path.read_bytes())
    return code.hexdigest()
