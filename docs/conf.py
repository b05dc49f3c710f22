"""Sphinx configuration: "make docs". Nothing is fetched from the network."""

import os
import sys
import warnings
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # no threads that fight with joblib's workers

import matplotlib

import cyclofeat

matplotlib.use("Agg")
warnings.filterwarnings("error", module="__main__")  # an example that warns fails

project = "cyclofeat"
author = "cyclofeat developers"
release = version = cyclofeat.__version__

extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.mathjax",
    "numpydoc",
    "sphinx_gallery.gen_gallery",
]
templates_path = ["_templates"]
exclude_patterns = ["_build", "decisions", "notes"]
source_suffix = {".rst": "restructuredtext"}  # the notes in Markdown are read in the repository

html_theme = "alabaster"
html_theme_options = {"description": cyclofeat.__doc__.splitlines()[0], "page_width": "1100px"}
html_show_sourcelink = False

autosummary_generate = True
autodoc_typehints = "none"  # numpydoc sections state them
numpydoc_show_class_members = False
numpydoc_class_members_toctree = False

sphinx_gallery_conf = {
    "examples_dirs": "../examples",
    "gallery_dirs": "gallery",
    "filename_pattern": r"[/\\]plot_",
    "ignore_pattern": "_surrogates",
    "doc_module": ("cyclofeat",),
    "backreferences_dir": "generated/backreferences",
    "abort_on_example_error": True,
    "run_stale_examples": True,  # an example that did not change may draw what did
    "download_all_examples": False,
    "show_signature": False,
    "remove_config_comments": True,
}

# Examples share a helper module that lies beside them.
sys.path.insert(0, str(Path(__file__).parents[1] / "examples" / "features"))
