"""Sections that an app or a plugin adds to what the report shows of a recording, or of the run."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from modalcam.pipeline import RunResult

if TYPE_CHECKING:
    from modalcam.pipeline import Cache, RecordingResult


@dataclass(frozen=True)
class Section:
    """A part of each recording's article in the report, after its figures; with a `title`, one of the run.

    Attributes
    ----------
    name : str
        Unique; also the name of the template, ``NAME.html.j2``.
    package : str
        Package in whose folder ``templates`` the template is. It is rendered with `view`, the variables, `id`, a unique
        anchor, `r`, all variables of the recording, and the macros `part` and `say` of the report.
    variables : callable
        From a recording and the cache of the report, or None, to the variables; None where nothing is to be shown. Not
        called in a report of more than 12 recordings, which has no diagnostic figures. With a title, from the result of
        the run, in every report.
    notes : callable or None
        From a recording to sentences for its list of notes.
    reading : tuple of (str, str)
        Title and text on how to read the section, once in the page; empty without.
    title : str
        Of a section of the run, which follows "Model updating", has no `r` and no notes, and is in the contents.
    """

    name: str
    package: str
    variables: Callable[[Any, Cache | None], dict[str, Any] | None]
    notes: Callable[[RecordingResult], Iterable[str]] | None = None
    reading: tuple[str, str] | tuple[()] = ()
    title: str = ""

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


def added_sections(
    of: RecordingResult | RunResult, cache: Cache | None
) -> list[tuple[Section, dict[str, Any]]]:
    """Sections of a recording, or of the run, that show something, each with its variables."""
    shown = (one for one in SECTIONS.values() if bool(one.title) == isinstance(of, RunResult))
    views = ((section, section.variables(of, cache)) for section in shown)
    return [(section, view) for section, view in views if view is not None]
