"""One form for the descriptions of all data sets."""

from __future__ import annotations


def descr(title: str, *, origin: str, licence: str, units: str, inferred: str, more: str = "") -> str:
    """Text for ``DESCR``: what, whence, under which licence, in which units, and what was not measured.

    Parameters
    ----------
    title : str
        One line.
    origin, licence, units, inferred : str
        One paragraph each; ``inferred`` says what the source does not state.
    more : str
        What lies beside the data, e.g. their README.

    Returns
    -------
    str

    Examples
    --------
    >>> print(descr("Two springs.", origin="A drawer.", licence="CC0.", units="mm.", inferred="Nothing."))
    Two springs.
    <BLANKLINE>
    Origin: A drawer.
    Licence: CC0.
    Units: mm.
    Inferred: Nothing.
    <BLANKLINE>
    """
    head = f"{title}\n\nOrigin: {origin}\nLicence: {licence}\nUnits: {units}\nInferred: {inferred}\n"
    return f"{head}\n{more}" if more else head
