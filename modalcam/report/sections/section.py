"""Sections that an app or a plugin adds to what the report shows of a recording."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from modalcam.pipeline import Cache, RecordingResult


@dataclass(frozen=True)
class Section:
    """A part of each recording's article in the report, after its figures.

    Attributes
    ----------
    name : str
        Unique; also the name of the template, ``NAME.html.j2``.
    package : str
        Package in whose folder ``templates`` the template is. It is rendered with `view`, the variables, `id`, a unique
        anchor, `r`, all variables of the recording, and the macros `part` and `say` of the report.
    variables : callable
        From a recording and the cache of the report, or None, to the variables; None where nothing is to be shown. Not
        called in a report of more than 12 recordings, which has no diagnostic figures.
    notes : callable or None
        From a recording to sentences for its list of notes.
    reading : tuple of (str, str)
        Title and text on how to read the section, once in the page; empty without.
    """

    name: str
    package: str
    variables: Callable[[RecordingResult, Cache | None], dict[str, Any] | None]
    notes: Callable[[RecordingResult], Iterable[str]] | None = None
    reading: tuple[str, str] | tuple[()] = ()

    @property
    def template(self) -> str:
        """Name of the template."""
        return f"{self.name}.html.j2"


SECTIONS: dict[str, Section] = {}


def register_section(section: Section) -> None:
    """Add a section, whose name must be new; it follows those registered before. ValueError otherwise."""
    if SECTIONS.setdefault(section.name, section) is not section:
        msg = f"a section named {section.name!r} is registered already; choose another name"
        raise ValueError(msg)
