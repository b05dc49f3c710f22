"""Checks of the gallery's examples while "make docs" runs them (no warning, no empty picture); thumbnails."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from sphinx_gallery.scrapers import matplotlib_scraper

_WIDE = 1.6  # width over height from which a whole figure is a strip in a thumbnail

_LISTED = (Path(__file__).parent / "gallery.rst").read_text(encoding="utf-8")

_filters: list[warnings.catch_warnings[None]] = []


def warnings_are_errors(gallery_conf: dict[str, Any], fname: Path | str | None, when: str) -> None:
    """Turn warnings into errors before an example, and restore the filters after it."""
    while _filters:
        _filters.pop().__exit__(None, None, None)
    if when == "before" and fname is not None:
        _filters.append(warnings.catch_warnings())
        _filters[-1].__enter__()
        warnings.simplefilter("error")


def listed_order(path: str) -> tuple[int, str]:
    """Return the sort key of an example among thumbnails: its place on the gallery's page, then its name."""
    return _LISTED.find(Path(path).name), path


def check_and_save(
    block: Any, block_vars: dict[str, Any], gallery_conf: dict[str, Any], **options: Any
) -> str:
    """Save a block's figures; raise AssertionError if one of them is empty or shows NaN alone."""
    for number in plt.get_fignums():
        axes = [ax for ax in plt.figure(number).axes if ax.has_data()]
        assert axes, f"{block_vars['src_file']}: figure {number} is empty"
        for ax in axes:
            # An empty line or one of NaN alone leaves its axes as they were: from 0 to 1.
            assert np.isfinite(ax.dataLim.get_points()).all(), f"{block_vars['src_file']}: nothing finite"
            assert ax.dataLim.width > 0 or ax.dataLim.height > 0, f"{block_vars['src_file']}: one point only"
    paths = block_vars["image_path_iterator"]
    if plt.get_fignums() and not len(paths):
        # An example's first picture becomes its thumbnail. Not returned, it is not on the page.
        save_thumbnail(plt.figure(plt.get_fignums()[0]), Path(next(paths)))
    return str(matplotlib_scraper(block, block_vars, gallery_conf, **options))


def save_thumbnail(figure: Figure, path: Path) -> None:
    """Save a figure small enough to be read in a thumbnail: of several panels one, with its labels."""
    panels = [ax for ax in figure.axes if ax.has_data() and ax.get_label() != "<colorbar>"]
    if len(panels) <= 3 and figure.get_figwidth() < _WIDE * figure.get_figheight():
        figure.savefig(path, dpi=100)
        return
    for legend in figure.legends:
        legend.set_visible(False)
    figure.canvas.draw()
    # Many panels are mostly numbers of worn lobes in their order, of which the last shows most.
    shown = panels[-1] if len(panels) > 3 else panels[0]
    box = shown.get_tightbbox().transformed(figure.dpi_scale_trans.inverted())
    figure.savefig(path, bbox_inches=box.padded(0.06), dpi=100)
    for legend in figure.legends:
        legend.set_visible(True)
