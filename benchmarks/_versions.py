"""Versions of the code and settings that made the stored results of a benchmark."""

from __future__ import annotations

import hashlib
import json
from typing import Any

from cyclofeat.gap.simulations import versions

# Read at import, because the files may change on disk while a process works.
_CODE = versions("signal", "gap")


def made_with(**design: Any) -> str:
    """Return a short hash of the code and of the settings that affect a result."""
    stated = [_CODE, {name: repr(value) for name, value in design.items()}]
    return hashlib.sha256(json.dumps(stated, sort_keys=True).encode()).hexdigest()[:10]
