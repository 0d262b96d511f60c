"""Sphinx's configuration. The sources of the site are the Markdown files of the repository."""

from __future__ import annotations

import inspect
import re
import sys
from importlib.metadata import version as installed_version
from pathlib import Path

import armrig
from numpydoc.xref import DEFAULT_LINKS

sys.path.insert(0, str(Path(__file__).parent))

project = "armrig"
author = "The armrig developers"
project_copyright = author
version = release = installed_version("armrig")

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.mathjax",
    "numpydoc",
    "site_parts.codes",
    "site_parts.commands",
    "site_parts.docstrings",
    "site_parts.figures",
    "site_parts.gallery",
    "site_parts.languages",
]
root_doc = "docs/index"
include_patterns = [
    "docs/**.md",
    "docs/generated/**.rst",
    "firmware_protocol/PROTOCOL.md",
    "firmware_protocol/simavr/README.md",
    "README.md",
    "ARCHITECTURE.md",
    "CHANGELOG.md",
    "CONTRIBUTING.md",
    "SECURITY.md",
]
exclude_patterns = ["docs/_build", ".venv", ".git", "tests", "clients", "daemon", "dist", "deploy"]

myst_heading_anchors = 4

default_role = "autolink"
highlight_language = "text"
smartquotes = False  # "--" is an option
templates_path = [str(Path(__file__).with_name("_templates"))]
autosummary_generate = True
autodoc_typehints = "none"
autodoc_member_order = "bysource"
numpydoc_show_class_members = False
numpydoc_class_members_toctree = False
# The types in "Parameters" and "Returns" link to the classes that docs/results.md lists.
numpydoc_xref_param_type = True
numpydoc_xref_ignore = "all"
DEFAULT_LINKS.clear()  # which lead to the sites of Python and numpy
numpydoc_xref_aliases = {
    full.rpartition(".")[2]: full
    for full in (
        *(f"armrig.{name}" for name in armrig.__all__ if inspect.isclass(getattr(armrig, name))),
        *re.findall(r"~(armrig[\w.]+)", Path(__file__).with_name("results.md").read_text("utf-8")),
    )
}

html_theme = "pydata_sphinx_theme"
html_sidebars = {
    page: [] for page in ("README", "docs/index", "docs/compared", "docs/generated/gallery")
}
html_title = f"armrig {version}"
html_copy_source = False
html_show_sourcelink = False
html_last_updated_fmt = None
html_theme_options = {
    "navigation_with_keys": False,
    "navbar_align": "left",
    "header_links_before_dropdown": 8,
    "show_prev_next": False,
    "secondary_sidebar_items": ["page-toc"],
    "footer_start": ["copyright"],
    "footer_end": [],
}
# The page of a search works from the file system, where no script may load another page.
html_show_search_summary = False
