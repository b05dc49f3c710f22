"""Layout of the descriptions of all data sets."""

from __future__ import annotations


def descr(title: str, *, origin: str, licence: str, units: str, inferred: str, more: str) -> str:
    """Return the text for ``DESCR``; ``inferred`` says what the source does not state."""
    head = f"{title}\n\nOrigin: {origin}\nLicence: {licence}\nUnits: {units}\nInferred: {inferred}\n"
    return f"{head}\n{more}"
