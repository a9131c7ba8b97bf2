"""How templates become pages: autoescape on, nothing undefined, invisible characters made visible."""

from __future__ import annotations

from collections.abc import Callable
from importlib import resources
from typing import Any

import jinja2
from markupsafe import Markup

from modalcam.report.style.format import count, fixed, interval, percent, significant, thousands, with_sd
from modalcam.report.style.palette import damping_style
from modalcam.report.style.text import command, prose, sentence, trusted, visible

_PACKAGE = "modalcam.report"
# Available in templates under their own names: {{ value|fixed(2) }}, {{ value|with_sd(sd) }}.
_FILTERS: tuple[Callable[..., str], ...] = (
    command,
    count,
    fixed,
    interval,
    percent,
    prose,
    sentence,
    significant,
    thousands,
    with_sd,
)


def environment(*folders: tuple[str, str]) -> jinja2.Environment:
    """Templates of the report, after those of other packages where there are any.

    Parameters
    ----------
    folders : tuple of (str, str)
        Package and folder in it.
    """
    loaders: list[jinja2.BaseLoader] = [jinja2.PackageLoader(*folder) for folder in folders]
    made = jinja2.Environment(
        loader=jinja2.ChoiceLoader([*loaders, jinja2.PackageLoader(_PACKAGE)]),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        finalize=_finalize,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    for text_filter in _FILTERS:
        made.filters[text_filter.__name__] = text_filter
    return made


def style_sheet() -> Markup:
    """The one style sheet of all pages."""
    common = resources.files(_PACKAGE).joinpath("templates", "style.css").read_text(encoding="utf-8")
    return trusted(common + damping_style())


def _finalize(value: Any) -> Any:
    """Every text that a template puts out has its invisible characters made visible; markup of ours passes."""
    return visible(value) if isinstance(value, str) and not isinstance(value, Markup) else value
