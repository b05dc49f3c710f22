"""Versions of the code and settings that made the stored results of a benchmark."""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from collections.abc import Iterable, Mapping
from typing import Any

from cyclofeat.gap.simulations import versions

UNKNOWN = "unknown version"


# Read at import, because the files may change on disk while a process works.
_CODE = versions("signal", "gap")


def made_with(**design: Any) -> str:
    """Return a short hash of the code and of the settings that affect a result."""
    stated = [_CODE, {name: repr(value) for name, value in design.items()}]
    return hashlib.sha256(json.dumps(stated, sort_keys=True).encode()).hexdigest()[:10]


def version_note(results: Iterable[Mapping[str, Any]]) -> str:
    """Return the note for results of different or unknown versions; empty for one known version."""
    of = Counter(str(result.get("made_with", UNKNOWN)) for result in results)
    if not of or (len(of) == 1 and UNKNOWN not in of):
        return ""
    counted = ", ".join(f"{n} of {version}" for version, n in of.most_common())
    return f"The results are of different or unknown versions of code and settings: {counted}."
