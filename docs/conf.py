"""Sphinx configuration: "make docs". Nothing is fetched from the network."""

import os
import re
import shutil
import sys
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # no threads that fight with joblib's workers

import matplotlib

import cyclofeat

matplotlib.use("Agg")

project = "cyclofeat"
author = "cyclofeat developers"
release = version = cyclofeat.__version__

extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.mathjax",
    "myst_parser",
    "numpydoc",
    "sphinx_design",
    "sphinxarg.ext",
    "sphinx_gallery.gen_gallery",
]
templates_path = ["_templates"]
exclude_patterns = ["_build"]
# Curly quotes, but no dash in place of the two hyphens of an option.
smartquotes_action = "qe"

html_theme = "pydata_sphinx_theme"
html_theme_options = {
    "logo": {"image_light": "_static/logo.svg", "image_dark": "_static/logo.svg", "text": "cyclofeat"},
    "header_links_before_dropdown": 6,
    "navbar_align": "left",
    "navigation_with_keys": False,
    "secondary_sidebar_items": ["page-toc"],
    "show_toc_level": 2,
    "footer_start": ["copyright"],
    "footer_end": ["theme-version"],
}
html_title = f"cyclofeat {release}"
html_static_path = ["_static"]
html_css_files = ["custom.css"]
html_favicon = "_static/logo.svg"
html_sidebars = {"index": [], "gallery": [], "changelog": []}
html_show_sourcelink = False

autosummary_generate = True
autodoc_typehints = "signature"
autodoc_typehints_format = "short"
numpydoc_show_class_members = False
numpydoc_class_members_toctree = False

EXAMPLES = ("notebooks", "features", "gap", "papers")
sphinx_gallery_conf = {
    "examples_dirs": [f"../examples/{folder}" for folder in EXAMPLES],
    "gallery_dirs": [f"gallery/{folder}" for folder in EXAMPLES],
    "filename_pattern": r"[/\\]plot_",
    "within_subsection_order": "FileNameSortKey",
    "minigallery_sort_order": "_gallery.listed_order",
    "ignore_pattern": r"(^|[/\\])_\w+\.py$",
    "doc_module": ("cyclofeat",),
    "backreferences_dir": "generated/backreferences",
    "abort_on_example_error": True,
    "run_stale_examples": True,  # an example that did not change may draw what did
    "download_all_examples": False,
    "show_signature": False,
    "default_thumb_file": str(Path(__file__).parent / "_static" / "logo.svg"),
    "remove_config_comments": True,
    # An example that warns or draws nothing fails.
    "image_scrapers": ("_gallery.check_and_save",),
    "reset_modules": ("matplotlib", "_gallery.warnings_are_errors"),
    "reset_modules_order": "both",
}

# Examples share helper modules that lie beside them; the gallery's checks lie beside this file.
sys.path[:0] = [
    str(Path(__file__).parent),
    *(str(Path(__file__).parents[1] / "examples" / folder) for folder in ("features", "gap", "papers")),
]


# Tables that the benchmarks write, as pages of their own.
RESULTS = {
    "counting": "Counts of one window, beside other methods",
    "operating_points": "Counts at any speed and load",
    "speed_search": "Speeds found in the torque alone",
    "sampling_rates": "Counts at low sampling rates",
    "disc_sizes": "Counts on discs with other numbers of lobes",
    "wear": "Depth and count of early radial wear, rig R1",
    "wear_r2": "Depth and count of early radial wear, rig R2",
    "spoiled": "Spoiled recordings",
    "sound_discs": "Sound and worn discs of independent rigs",
    "gap": "Hidden effects: names, sizes and proof",
    "other_models": "Models that no packaged posterior knows",
    "drawn_rigs": "Counters trained on corrected models",
    "posterior_peers": "The joint posterior beside other methods",
    "hidden_effects/README": "Hidden effects: the sets, and how to compete",
    "real_gaps": "What simulators of two real measurements lack",
    "published_rig": "The rig called published",
    "simulator": "Speed of the simulator",
    "features": "Speed of the features",
    "campaign": "Cost of a campaign",
}
RESULTS_FOLDER = Path(__file__).parent / "generated" / "results"


def copy_results(app, config):
    """Benchmarks' tables into the pages' folder, with titles that differ."""
    shutil.rmtree(RESULTS_FOLDER, ignore_errors=True)
    for name, title in RESULTS.items():
        text = (Path(__file__).parents[1] / "benchmarks" / f"{name}.md").read_text(encoding="utf-8")
        heading, _, rest = text.partition("\n")
        page = RESULTS_FOLDER / f"{name}.md"
        page.parent.mkdir(parents=True, exist_ok=True)
        page.write_text(f"# {title}\n\n{rest if heading.startswith('# ') else text}", encoding="utf-8")


def link_results(app, name, source):
    """Links to tables, which lead to files in the repository, lead to their pages here."""
    for up, to in (("../../", "../"), ("../", "")):
        source[0] = source[0].replace(f"]({up}benchmarks/", f"]({to}generated/results/")


def escape_bars_and_powers(app, what, name, obj, options, lines):
    """Docstrings write |u| for a size and ``rms``^2 for a power: reST takes both for markup of its own."""
    inside = None  # indent of the directive (an equation) that the line belongs to
    for number, line in enumerate(lines):
        text = line.lstrip()
        indent = len(line) - len(text)
        if inside is not None and text and indent <= inside:
            inside = None
        if text.startswith(".. "):
            inside = indent
        if inside is not None or text.startswith((">>>", "...", "| ", "+")):
            continue
        line = re.sub(r"(``[^`]+``)(?=\^)", r"\1\\ ", line)
        parts = re.split(r"(``[^`]*``|:math:`[^`]*`)", line)
        parts[::2] = [re.sub(r"(?<!\\)\|(?=\S)", r"\\|", part) for part in parts[::2]]
        lines[number] = "".join(parts)


def setup(app):
    app.connect("config-inited", copy_results)
    app.connect("source-read", link_results)
    # After numpydoc, which has put the sections in order by then.
    app.connect("autodoc-process-docstring", escape_bars_and_powers, priority=900)
