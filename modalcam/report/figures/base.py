"""Figures of the report: the results that a figure shows, how it is drawn, and its caption."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache as remembered
from functools import partial
from importlib.metadata import version
from typing import TYPE_CHECKING, Any, Generic, Literal, NamedTuple, TypeVar

from modal_id import Identification, IdentifiedMode
from modalcam.pipeline import Cache, RecordingResult, code_sha256, digest
from modalcam.report.signals import shown_channel, shown_mode
from modalcam.report.style import (
    WIDTH_IN,
    FigureView,
    environment,
    figure_style,
    figure_svg,
    inline,
    new_figure,
    variables,
)
from sim.beam import BeamModes

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Half the width of a 90 % band in standard deviations: rounded, as the ids in the SVG depend on the last digit.
BAND_SD = 1.645
Shown = TypeVar("Shown")
Place = Literal["recording", "tracking", "overview", "damping", "comparison", "updating"]


class Target(NamedTuple):
    """The mode and the channel that the figures of a decay show."""

    found: Identification
    mode: IdentifiedMode
    channel: int


@dataclass(frozen=True)
class RecordingSubject:
    """One recording, the modes of the beam to compare shapes with, and the most channels to draw."""

    recording: RecordingResult
    theory: BeamModes | None = None
    strips: int = 8

    def target(self) -> Target | None:
        """The mode shown; None where no mode was identified."""
        found = self.recording.identified
        mode = None if found is None else shown_mode(found)
        return None if found is None or mode is None else Target(found, mode, shown_channel(found))

    def decaying(self) -> Target | None:
        """The mode shown, where the record holds its free decay."""
        target = self.target()
        return None if target is None or not target.found.has_decay else target


@dataclass(frozen=True)
class FigureKind(Generic[Shown]):
    """One kind of figure; add it to the report with `register_figure`.

    Attributes
    ----------
    key : str
        Lower-case letters and digits; ends the id of the figure in the page.
    place : {"recording", "tracking", "overview", "damping", "comparison", "updating"}
        Section of the report: after the facts of each recording, after its table of markers, directly under the
        verdict, below it, at the comparison of damping models, or at the updating of the beam.
    shows : callable
        ``shows(subject)`` gives the results that the figure is drawn from, or None without them: text, numbers,
        arrays, tuples, dicts or frozen dataclasses. `subject` is a `RecordingSubject` in the places "recording" and
        "tracking", a `RunResult` in the others. A figure is drawn again only when these results change.
    draw : callable
        ``draw(figure, shown)`` draws into an empty matplotlib figure; False leaves the figure out.
    height_in, width_in : float
    essential : bool
        Drawn also in a page of more than 12 recordings.
    words : str
        Jinja template that sets ``title`` and has the macros ``alt(shown)``, which describes the figure for readers who
        do not see it, and ``caption(shown)``, what this one shows. It may set ``reading``, what to look for in any
        figure of the kind, which stands once in the page. Empty for the file ``templates/figures/KEY.html.j2``.
    """

    key: str
    place: Place
    shows: Callable[[Any], Shown | None]
    draw: Callable[[Figure, Shown], bool | None]
    height_in: float = 2.5
    width_in: float = WIDTH_IN
    essential: bool = False
    words: str = ""

    def view(self, figure_id: str, shown: Shown, cache: Cache | None = None) -> FigureView | None:
        """The figure for the page, drawn unless `cache` holds it; None where there is nothing to draw."""
        svg = self.svg(shown, cache)
        if not svg:
            return None
        words = _words(self.key, self.words)
        alt, caption = words.alt(shown).strip(), words.caption(shown).strip()
        return FigureView(
            figure_id, self.key, words.title, inline(svg, figure_id, alt), caption, _reading(words)
        )

    def caption(self, shown: Shown) -> tuple[str, str]:
        """Title and caption of a figure that stands alone, with how to read it."""
        words = _words(self.key, self.words)
        return words.title, " ".join(f"{_reading(words)} {words.caption(shown)}".split())

    def cache_key(self, shown: Shown) -> str:
        """Hash of all that determines the drawing: results, size, colours, drawing code, version of matplotlib."""
        package = "modalcam.report"
        modules = (f"{package}.style", f"{package}.signals", self.draw.__module__)
        size = (self.height_in, self.width_in)
        return digest((self.key, size, variables(), code_sha256(*modules), _matplotlib_version(), shown))

    def svg(self, shown: Shown, cache: Cache | None = None) -> str:
        """The drawing for `inline`, taken from `cache` or put into it; empty where there is nothing to draw."""
        draw = partial(self._drawn, shown)
        return draw() if cache is None else cache.cached(self.cache_key(shown), draw)

    def _drawn(self, shown: Shown) -> str:
        with figure_style():
            figure = new_figure(self.height_in, self.width_in)
            return "" if self.draw(figure, shown) is False else figure_svg(figure)


@remembered
def _matplotlib_version() -> str:
    return version("matplotlib")


@remembered
def _words(key: str, source: str) -> Any:
    """Names that the template of a figure's words exports."""
    templates = environment()
    made = templates.from_string(source) if source else templates.get_template(f"figures/{key}.html.j2")
    return made.module


def _reading(words: Any) -> str:
    return str(getattr(words, "reading", "")).strip()
