"""Files that must be refused."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

from cyclofeat.datasets import read_recording


def check_error(path: Path, words: str, **options: Any) -> None:
    """Reading gives an error of one line with the file's name and these words, apart where dots are."""
    with pytest.raises((TypeError, ValueError)) as caught:
        read_recording(path, **options)
    message = str(caught.value)
    assert path.name in message
    assert "\n" not in message
    assert re.search(".*".join(map(re.escape, words.split(" ... "))), message), message
