"""Page of a user's own: text, pictures and tables beside the sections of our pages."""

from __future__ import annotations

import io
import mimetypes
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Self

from cyclofeat._base.checks import is_number, is_whole, repr_of
from cyclofeat.recordings import Recording
from cyclofeat.report import _figures
from cyclofeat.report._count import write_count_report
from cyclofeat.report._evaluation import write_evaluation_report
from cyclofeat.report._figures import data_uri
from cyclofeat.report._gap import write_gap_report
from cyclofeat.report._page import Section, check_page_path, template_environment, write_page

_PAGES = (write_count_report, write_evaluation_report, write_gap_report)
_PICTURES = (".gif", ".jpeg", ".jpg", ".png", ".svg", ".webp")
_SIZE = (8.0, 3.6)


class Report:
    """Page of parts in the order in which they are added: one HTML file that needs no network.

    Text, names and cells of tables are escaped.

    Parameters
    ----------
    title : str
        Heading of the page.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> from cyclofeat import Recording
    >>> recording = Recording([22.0, 22.4, 21.8], 2.0, run="press 4")
    >>> report = Report("Press 4").add_text("Recorded after the bearing was changed.").add(recording)
    >>> report = report.add_table([{"day": "Monday", "torque (Nm)": 22.07}], "Mean torque")
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     page = report.write(pathlib.Path(folder, "press.html"))
    ...     "after the bearing" in page.read_text(encoding="utf-8")
    True
    """

    def __init__(self, title: str) -> None:
        self.title = str(title)
        self._parts: list[dict[str, Any]] = []

    def add_heading(self, text: str) -> Self:
        """Add a heading.

        Parameters
        ----------
        text : str

        Returns
        -------
        self : Report
        """
        return self._add(heading=str(text))

    def add_text(self, text: str) -> Self:
        """Add plain text; an empty line begins a new paragraph.

        Parameters
        ----------
        text : str

        Returns
        -------
        self : Report
        """
        return self._add(paragraphs=[part for part in str(text).split("\n\n") if part.strip()])

    def add_code(self, text: str) -> Self:
        """Add code, in its own lines.

        Parameters
        ----------
        text : str

        Returns
        -------
        self : Report
        """
        return self._add(code=str(text))

    def add(self, shown: Any) -> Self:
        """Add the card that a notebook shows of a recording, count, model, evaluation, rig or gap.

        Parameters
        ----------
        shown : object
            With ``_repr_html_``, whose HTML is trusted.

        Returns
        -------
        self : Report

        Raises
        ------
        TypeError
            If a notebook would show plain text of it.
        """
        if not hasattr(shown, "_repr_html_"):
            raise TypeError(
                "shown must be a recording, a result or another object with _repr_html_, got "
                f"{repr_of(shown)}: text, figures and tables have add_text, add_figure and add_table"
            )
        return self._add(card=shown._repr_html_())

    def add_figure(self, figure: Any, caption: str = "", *, size: tuple[float, float] = _SIZE) -> Self:
        """Add a picture.

        Parameters
        ----------
        figure : path, matplotlib.figure.Figure or object with ``plot(ax=...)``
            File (GIF, JPEG, PNG, SVG, WebP), which becomes part of the page; figure; recording, which one can
            zoom, with gaps, lost and clipped samples and bad spans; or a display or result, which is drawn
            in the colours of the page, light and dark.
        caption : str, optional
            Text below the picture, which also describes it to those who do not see it.
        size : tuple of float, default=(8.0, 3.6)
            Width and height in inches of what is drawn by ``plot``.

        Returns
        -------
        self : Report

        Raises
        ------
        ImportError
            If matplotlib is needed and not installed.
        FileNotFoundError
            If there is no such file.
        TypeError, ValueError
            If ``figure`` is none of these, or a file of another kind.
        """
        if isinstance(figure, (str, os.PathLike)):
            path = Path(figure)
            if path.suffix.lower() not in _PICTURES:
                raise ValueError(f"figure must be one of {', '.join(_PICTURES)}, got {path.name!r}")
            kind = mimetypes.guess_type(f"picture{path.suffix.lower()}")[0] or "image/webp"
            return self._add(image=data_uri(path.read_bytes(), kind), caption=str(caption))
        if isinstance(figure, Recording):
            return self._add(picture=_figures.draw_recording(figure, size), caption=str(caption))
        if hasattr(figure, "savefig"):
            drawn = io.BytesIO()
            figure.savefig(drawn, format="svg")
            return self._add(image=data_uri(drawn.getvalue()), caption=str(caption))
        if not hasattr(figure, "plot"):
            raise TypeError(
                "figure must be a file, a matplotlib figure or an object with plot(ax=...), got "
                f"{repr_of(figure)}"
            )
        picture = _figures.draw_picture(lambda ax: figure.plot(ax=ax), size, str(caption))
        return self._add(picture=picture, caption=str(caption))

    def add_table(self, table: Any, caption: str = "") -> Self:
        """Add a table.

        Parameters
        ----------
        table : pandas.DataFrame or sequence of mappings
            Rows; a named index of a data frame is its first column. Numbers have four digits.
        caption : str, optional
            Text above the table.

        Returns
        -------
        self : Report

        Raises
        ------
        TypeError
            If ``table`` is neither.
        """
        if hasattr(table, "to_dict") and hasattr(table, "index"):
            table = (table.reset_index() if table.index.name else table).to_dict("records")
        if not isinstance(table, Sequence) or not all(isinstance(row, Mapping) for row in table):
            raise TypeError(f"table must be a data frame or a sequence of mappings, got {repr_of(table)}")
        columns = list(dict.fromkeys(name for row in table for name in row))
        right = [all(row.get(name) is None or is_number(row[name]) for row in table) for name in columns]
        rows = [[_cell_text(row.get(name)) for name in columns] for row in table]
        return self._add(columns=list(zip(map(str, columns), right, strict=True)), rows=rows, caption=caption)

    def add_page(self, write: Callable[..., Path], *arguments: Any, **options: Any) -> Self:
        """Add a page as a section.

        Parameters
        ----------
        write : write_count_report, write_evaluation_report or write_gap_report
            Function that would write the page.
        *arguments, **options
            Its own, without the path.

        Returns
        -------
        self : Report
        """
        if write not in _PAGES:
            names = ", ".join(page.__name__ for page in _PAGES)
            raise TypeError(f"write must be one of {names}, got {repr_of(write)}")
        section = Section()
        write(*arguments, path=section, **options)
        # Sections of one kind must not share the anchors of their links.
        layout = {"layout": "part.html", "prefix": f"part-{len(self._parts) + 1}-"}
        page = template_environment().get_template(section.template)
        return self._add(section=page.render(section.summary, **layout))

    def write(self, path: str | os.PathLike[str]) -> Path:
        """Write the page, replacing a file of that name, and return its path.

        Parameters
        ----------
        path : path-like
            File to write, ``*.html``.

        Returns
        -------
        pathlib.Path

        Raises
        ------
        ValueError
            If nothing was added.
        """
        check_page_path(path)
        if not self._parts:
            raise ValueError("the report is empty: add text, a figure, a table or a result first")
        return write_page(path, "report.html", {"title": self.title, "parts": self._parts})

    def _add(self, **part: Any) -> Self:
        self._parts.append(part)
        return self


def _cell_text(value: Any) -> str:
    """Return a value as text; missing ones as a dash."""
    if value is None or value != value:  # NaN
        return "-"
    return f"{value:.4g}" if is_number(value) and not is_whole(value) else str(value)
