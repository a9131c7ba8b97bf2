"""Sphinx: `sphinx-build -W docs site` writes the documentation as HTML into site/."""

from __future__ import annotations

from modalcam import __version__

project = "modalcam"
author = "The modalcam developers"
copyright = author  # noqa: A001 - Sphinx's name
version = release = __version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "numpydoc"]
myst_enable_extensions = ["colon_fence", "dollarmath"]
myst_heading_anchors = 3
# Members are described in the sections of their class.
numpydoc_show_class_members = False
autodoc_typehints = "signature"
autodoc_member_order = "bysource"
# The draft for a journal is no page of the site.
exclude_patterns = ["*.py", "joss"]
html_theme = "furo"
html_title = f"modalcam {version}"
html_copy_source = False
html_show_sphinx = False
# The same sources give the same bytes.
html_last_updated_fmt = None
