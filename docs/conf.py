# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Sphinx configuration; `make docs` builds the pages, and warnings are errors."""

from __future__ import annotations

import sys
from pathlib import Path

DOCS = Path(__file__).resolve().parent
sys.path[:0] = [str(DOCS.parent), str(DOCS / "_ext")]

import puma_sim_core  # noqa: E402

project = "puma-sim"
author = "the puma-sim contributors"
copyright = "the puma-sim contributors"
release = version = puma_sim_core.__version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.mathjax", "derived_pages"]
myst_enable_extensions = ["colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 3
# the table stands within the page of measures
exclude_patterns = ["_build", "_ext", "measures_table.md"]

# the theme that ships with Sphinx: nothing else to install or to keep up with
html_theme = "alabaster"
html_theme_options = {"description": "Simulator of the PUMA 560, and what a model lacks by measured logs"}
html_show_sourcelink = False

autodoc_typehints = "none"
autodoc_member_order = "bysource"
napoleon_google_docstring = False
napoleon_use_ivar = True
