"""Sphinx: `sphinx-build -W docs site` writes the documentation as HTML into site/."""

from __future__ import annotations

from typing import Any

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


def _accessible(_app: Any, _page: str, _template: str, context: dict[str, Any], _tree: Any) -> None:
    """Captions of lists of pages have a level; code and tables that are wider than the page are scrolled by keys."""
    for part in {"body", "furo_navigation_tree"} & context.keys():
        for tag, with_attribute in (
            ('role="heading">', 'role="heading" aria-level="2">'),
            ("<pre>", '<pre tabindex="0">'),
            ('<div class="table-wrapper', '<div tabindex="0" class="table-wrapper'),
        ):
            context[part] = context[part].replace(tag, with_attribute)


def setup(app: Any) -> None:
    """After the theme has made its list of pages."""
    app.connect("html-page-context", _accessible, priority=900)
