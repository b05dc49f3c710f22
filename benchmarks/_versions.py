"""By which code and settings results were made, that are kept from one run of a benchmark to the next."""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from collections.abc import Iterable, Mapping
from typing import Any

from cyclofeat.gap._null import versions

UNKNOWN = "unknown version"


# Taken when the code is, which may change on the disk while a process works.
_CODE = versions()


def made_with(**design: Any) -> str:
    """Short sum of the code, and of the settings that decide about a result."""
    stated = [_CODE, {name: repr(value) for name, value in design.items()}]
    return hashlib.sha256(json.dumps(stated, sort_keys=True).encode()).hexdigest()[:10]


def told_of_versions(results: Iterable[Mapping[str, Any]]) -> str:
    """What a page says of results that are not all of one known version; nothing where they are."""
    of = Counter(str(result.get("made_with", UNKNOWN)) for result in results)
    if not of or (len(of) == 1 and UNKNOWN not in of):
        return ""
    counted = ", ".join(f"{n} of {version}" for version, n in of.most_common())
    return f"Results do not all stem from one known version of code and settings: {counted}."
