"""Page of a user's own, of text, pictures, tables and our pages, and that of a ranking of features."""

from __future__ import annotations

import io
import mimetypes
import os
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cyclofeat._base.checks import is_number, is_whole, repr_of
from cyclofeat._base.quantities import number_of
from cyclofeat.plotting.drawing import legend_above
from cyclofeat.recordings import Recording
from cyclofeat.report import _figures
from cyclofeat.report._count import write_count_report
from cyclofeat.report._evaluation import write_evaluation_report
from cyclofeat.report._figures import data_uri
from cyclofeat.report._gap import write_gap_report
from cyclofeat.report._page import Section, check_page_path, template_environment, write_page

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes

    from cyclofeat.features import TorqueFeatures

_PAGES = (write_count_report, write_evaluation_report, write_gap_report)
_PICTURES = (".gif", ".jpeg", ".jpg", ".png", ".svg", ".webp")
_SIZE = (8.0, 3.6)

_N_HISTOGRAMS = 8
_N_CHOSEN = 5
_MEANING = (
    "Trend: rank correlation of assemblies with the count, from -1 to 1; monotonicity: steps of the class "
    "means upwards less those downwards, over all steps; both with 95 % bootstrap intervals over assemblies. "
    "Mutual information in bits. p-values of the one-way analysis of variance and the Kruskal-Wallis test "
    "are adjusted for the number of features; they tell whether counts differ, in any order."
)
_CODE = """from cyclofeat import Windower
from cyclofeat.datasets import read_folder
from cyclofeat.features import TorqueFeatures

X, y, groups = Windower().transform(read_folder("measured/"))
features = {transformer}
table = features.set_output(transform="pandas").fit_transform(X, y)
chosen = table[{chosen}]"""


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


def write_features_report(
    table: pd.DataFrame, features: pd.DataFrame, y: ArrayLike, groups: ArrayLike,
    path: str | os.PathLike[str], *, transformer: TorqueFeatures,
) -> Path:  # fmt: skip
    """Write the page of a ranking of features as one HTML file, and return its path.

    ``table`` is that of :func:`cyclofeat.counting.rank_features` of the ``features``, which an equal
    ``transformer`` computes.
    """
    labels = np.asarray(y)
    page = Report("Which features depend on the number of worn lobes?")
    assemblies = number_of(len(set(np.asarray(groups).tolist())), "assembly")
    page.add_text(
        f"{number_of(len(table), 'feature')} of {number_of(len(labels), 'window')} of {assemblies}. "
        f"The most gradual come first. {_MEANING}"
    )
    page.add_heading("Histograms of the most gradual")
    for name in table.index[:_N_HISTOGRAMS]:
        low, high = table.trend_low[name], table.trend_high[name]
        trend = f"trend {table.trend[name]:+z.2f}, {low:+z.2f} to {high:+z.2f}"
        histogram = SimpleNamespace(plot=partial(_draw_histogram, features[name].to_numpy(), labels))
        page.add_figure(histogram, f"{name}: {trend}", size=(8.0, 2.6))
    page.add_heading(f"Code for the {min(_N_CHOSEN, len(table))} most gradual")
    chosen = ",\n    ".join(map(repr, table.index[:_N_CHOSEN]))
    page.add_code(_CODE.format(transformer=transformer, chosen=f"[\n    {chosen},\n]"))
    page.add_heading("All features")
    return page.add_table(table).write(path)


def _draw_histogram(values: NDArray[Any], labels: NDArray[Any], ax: Axes) -> None:
    """Draw the histogram of a feature's windows for each count."""
    bins: Any = np.histogram_bin_edges(values, 30)
    counts = np.unique(labels)
    for k, count in enumerate(counts):
        shade = 0.15 + 0.7 * k / max(len(counts) - 1, 1)
        look: dict[str, Any] = {"color": ("C0", shade), "edgecolor": "C0", "linewidth": 0.6}
        ax.hist(values[labels == count], bins, label=f"{count} worn", **look)
    ax.set(ylabel="windows")
    legend_above(ax, ncols=len(counts))
