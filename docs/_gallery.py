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

_filters: list[warnings.catch_warnings[None]] = []


def warnings_are_errors(gallery_conf: dict[str, Any], fname: Path | str | None, when: str) -> None:
    """Turn warnings into errors before an example, and restore the filters after it."""
    while _filters:
        _filters.pop().__exit__(None, None, None)
    if when == "before" and fname is not None:
        _filters.append(warnings.catch_warnings())
        _filters[-1].__enter__()
        warnings.simplefilter("error")


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
    """Save a figure, of a wide one its first axes with their labels."""
    figure.canvas.draw()
    box = None
    if figure.get_figwidth() > _WIDE * figure.get_figheight():
        first = next(ax for ax in figure.axes if ax.has_data())
        box = first.get_tightbbox().transformed(figure.dpi_scale_trans.inverted()).padded(0.06)
    figure.savefig(path, bbox_inches=box, dpi=100)
