"""HTML of an object in a notebook: what it is, its numbers, small pictures, and what to do next.

The card takes its colours from the notebook, light or dark. Text is escaped here and nowhere else: names and
notes come from files of others.
"""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence

_ROW = "text-align:left;vertical-align:top;padding:.1em .9em .1em 0;background:none;border:0"
_TABLE = "border:0;margin:0;width:auto"
_NAME = "font-weight:normal;opacity:.75"
_NOTE = "border-left:3px solid #c98a00;padding-left:.6em;margin:.4em 0"


def card(
    title: str,
    rows: Mapping[str, object],
    *,
    pictures: Sequence[str] = (),
    notes: Sequence[str] = (),
    code: str = "",
) -> str:
    """Return the card of an object.

    Parameters
    ----------
    title : str
        What the object is, and its main number.
    rows : mapping from str to object
        Numbers with units by their names; rows whose value is None or empty text are left out.
    pictures : sequence of str
        From :mod:`cyclofeat._base.svg`: the only argument that is not escaped.
    notes : sequence of str
        Warnings.
    code : str
        One line that shows what to do next.

    Examples
    --------
    >>> "&lt;b&gt;" in card("Recording", {"run": "<b>"})
    True
    """
    cells = "".join(
        f'<tr style="background:none"><th style="{_ROW};{_NAME}">{html.escape(name)}</th>'
        f'<td style="{_ROW}">{html.escape(str(value))}</td></tr>'
        for name, value in rows.items()
        if value is not None and value != ""
    )
    parts = [
        f'<div style="font-weight:600;font-size:1.1em;margin-bottom:.3em">{html.escape(title)}</div>',
        '<div style="display:flex;flex-wrap:wrap;gap:1em 1.5em;align-items:flex-start">',
        *pictures,
        f'<div style="flex:1 1 20em;min-width:0"><table style="{_TABLE}">{cells}</table></div>',
        "</div>",
        *(f'<div style="{_NOTE}">{html.escape(note)}</div>' for note in dict.fromkeys(notes)),
    ]
    if code:
        # Pages, whose readers run nothing, hide it.
        parts.append(
            f'<div class="next" style="margin-top:.4em">Next: <code>{html.escape(code)}</code></div>'
        )
    return f'<div style="line-height:1.45">{"".join(parts)}</div>'
