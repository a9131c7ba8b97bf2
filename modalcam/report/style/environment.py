"""Environment of the templates: autoescape, undefined names refused, invisible characters made visible."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import cache
from typing import Any

import jinja2
from markupsafe import Markup

from modalcam.report.style import format as numbers
from modalcam.report.style import safe_text as texts
from modalcam.report.style.safe_text import trusted, visible
from sim.damping import DAMPING_MODELS
from tracker.markers import noun_of

_PACKAGE = "modalcam.report"
# Available in templates under their own names: {{ value|fixed(2) }}, {{ value|with_sd(sd) }}.
_FILTERS: tuple[Callable[..., str], ...] = (
    numbers.count,
    numbers.fixed,
    numbers.in_unit,
    numbers.interval,
    numbers.listed,
    numbers.mode_name,
    numbers.odds,
    numbers.p_value,
    numbers.percent,
    numbers.rate,
    numbers.signed,
    numbers.significant,
    numbers.superscript,
    numbers.thousands,
    numbers.with_sd,
    texts.command,
    texts.prose,
    texts.sentence,
)


@cache
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
    made.filters["damping"] = DAMPING_MODELS.__getitem__
    made.filters["noun"] = noun_of
    made.tests["finite"] = math.isfinite
    return made


def compiled_templates() -> Iterator[str]:
    """Compile one template of the report after the other, which takes a third of a second for all."""
    for name in environment().list_templates(filter_func=lambda name: name.endswith((".j2", ".css"))):
        environment().get_template(name)
        yield name


def style_sheet() -> Markup:
    """The one style sheet of all pages."""
    return trusted(environment().get_template("style.css").render(models=DAMPING_MODELS.values()))


def _finalize(value: Any) -> Any:
    """Text with its invisible characters made visible; trusted markup unchanged."""
    return visible(value) if isinstance(value, str) and not isinstance(value, Markup) else value
