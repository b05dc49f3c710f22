"""Labels of a recording as files hold them."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from typing import Any

from cyclofeat._base.checks import is_whole, one_of, repr_of
from cyclofeat._base.quantities import QUANTITIES, from_1
from cyclofeat.recordings import Recording

FORMAT, FORMAT_KEY = "cyclofeat recording", "cyclofeat_recording"
VERSION = 2  # 1 counted lobes from 0
# Parameters of Recording that a caller may give, and that written files hold.
LABELS = (
    "quantity", "angle_of", "angle_is_absolute", "assembly", "run", "defect_count", "worn_lobes", "n_lobes",
    "speed_rpm", "load_nm", "source", "meta",
)  # fmt: skip


# The label of worn lobes in files, which says how they are counted.
WORN = "worn_lobes_from_1"
FILE_LABELS = tuple(WORN if name == "worn_lobes" else name for name in LABELS)


def labels_of_file(file: str, stated: Mapping[str, Any], version: Any = None) -> dict[str, Any]:
    """Return the labels that a file states, with lobes counted from 0.

    ``version`` is that of the format, None in files that other programs wrote.

    Raises
    ------
    ValueError
        If version or quantity are unknown, or the file's worn lobes are not counted from 1.
    """
    if version not in (None, 1, VERSION):
        raise ValueError(
            f"{file} is of format {version!r}, but 1 and {VERSION} can be read; update cyclofeat"
        )
    labels = dict(stated)
    if "quantity" in labels:
        one_of(f"{file}: quantity", labels["quantity"], QUANTITIES)
    if version == 1:
        return labels
    check_no_bare_lobes(file, labels)
    if WORN in labels:
        labels["worn_lobes"] = lobes_from_1(f"{file}: {WORN}", labels.pop(WORN))
    return labels


def check_no_bare_lobes(file: str, names: Iterable[str]) -> None:
    """Raise ``ValueError`` for a name that does not say from where the lobes are counted."""
    if "worn_lobes" in names:
        raise ValueError(
            f"{file}: worn_lobes does not say whether lobes count from 0 or from 1: name it {WORN} and "
            "count from 1"
        )


def lobes_from_1(called: str, numbers: Any) -> tuple[int, ...]:
    """Return lobes counted from 0; raise ``ValueError`` unless ``numbers`` count them from 1."""
    if not isinstance(numbers, (list, tuple)) or not all(is_whole(one) and one > 0 for one in numbers):
        raise ValueError(f"{called} must be lobes counted from 1, like [1, 5], got {repr_of(numbers)}")
    return tuple(one - 1 for one in numbers)


def samples_name(recording: Recording) -> str:
    """Return the name of the samples in files: ``torque`` is the output's."""
    return "torque" if recording.quantity == "output_torque" else recording.quantity


def labels_to_write(recording: Recording) -> dict[str, Any]:
    """Labels of a recording, as JSON can hold them."""
    labels: dict[str, Any] = {"sampling_rate": recording.sampling_rate}
    for key in LABELS:
        value = getattr(recording, key)
        skipped = (
            (key == "meta" and not value)
            or (recording.angle is None and key.startswith("angle"))
            or (key, value) in (("n_lobes", 15), ("quantity", "output_torque"))  # the defaults of files
        )
        if value is not None and not skipped:
            labels[key] = value
    if "worn_lobes" in labels:
        labels[WORN] = from_1(labels.pop("worn_lobes"))
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
