"""Labels of a recording as files hold them."""

from __future__ import annotations

import json
from typing import Any

from cyclofeat.recordings import Recording

FORMAT, FORMAT_KEY = "cyclofeat recording", "cyclofeat_recording"
VERSION = 1
# Parameters of Recording that a caller may give, and that written files hold.
LABELS = (
    "angle_of", "angle_is_absolute", "assembly", "run", "defect_count", "worn_lobes", "n_lobes", "speed_rpm",
    "load_nm", "source", "meta",
)  # fmt: skip


def check_version(file: str, version: Any) -> None:
    """Raise ``ValueError`` for an unknown version of the format."""
    if version != VERSION:
        raise ValueError(f"{file} is of format {version!r}, but {VERSION} can be read; update cyclofeat")


def labels_to_write(recording: Recording) -> dict[str, Any]:
    """Labels of a recording, as JSON can hold them."""
    labels: dict[str, Any] = {"sampling_rate": recording.sampling_rate}
    for key in LABELS:
        value = getattr(recording, key)
        skipped = (
            (key == "meta" and not value)
            or (recording.angle is None and key.startswith("angle"))
            or (key == "n_lobes" and value == 15)  # the default of files
        )
        if value is not None and not skipped:
            labels[key] = list(value) if key == "worn_lobes" else value
    meta = labels.get("meta", {})
    try:
        same = json.loads(json.dumps(meta, allow_nan=False)) == meta
    except (TypeError, ValueError):
        same = False
    if not same:
        raise TypeError(
            "meta must hold only text, finite numbers, booleans, None, lists and dictionaries with text "
            f"keys, to be written to a file; got {meta!r}"
        )
    return labels
