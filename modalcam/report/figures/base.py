"""What a figure of the report is: the results it shows, how it is drawn, and the text beside it."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache as remembered
from functools import partial
from typing import Any, Generic, Literal, NamedTuple, TypeVar

import matplotlib as mpl
from matplotlib.figure import Figure

from modal_id.results import Identification, IdentifiedMode
from modalcam.pipeline.results import RecordingResult
from modalcam.report.derived.signals import shown_channel, shown_mode
from modalcam.report.style.palette import WIDTH_IN, figure_style, new_figure, variables
from modalcam.report.style.svg import FigureView, figure_svg, inline
from modalcam.storage.cache import Cache, digest
from sim.beam.modes import BeamModes

Shown = TypeVar("Shown")
Place = Literal["recording", "tracking", "damping", "updating"]


class Target(NamedTuple):
    """The mode and the channel that the figures of a decay show."""

    found: Identification
    mode: IdentifiedMode
    channel: int

    @property
    def channel_name(self) -> str:
        """Name of the channel."""
        return self.found.series.channels[self.channel]


@dataclass(frozen=True)
class RecordingSubject:
    """One recording, the modes of the beam to compare shapes with, and the most channels to draw."""

    recording: RecordingResult
    theory: BeamModes | None = None
    strips: int = 8

    @property
    def found(self) -> Identification | None:
        """The identification; None where it failed or was not reached."""
        found = self.recording.identification
        return found if isinstance(found, Identification) else None

    def target(self) -> Target | None:
        """The mode shown; None where no mode was identified."""
        mode = None if self.found is None else shown_mode(self.found)
        if self.found is None or mode is None:
            return None
        return Target(self.found, mode, shown_channel(self.found))


@dataclass(frozen=True)
class FigureKind(Generic[Shown]):
    """One kind of figure; add it to the report with `register_figure`.

    Attributes
    ----------
    key : str
        Lower-case letters and digits; ends the id of the figure in the page.
    place : {"recording", "tracking", "damping", "updating"}
        Section of the report: after the facts of each recording, after its table of markers, at the comparison of
        damping models, or at the updating of the beam.
    title : str
    shows : callable
        ``shows(subject)`` gives the results that the figure is drawn from, or None without them: text, numbers,
        arrays, tuples, dicts or frozen dataclasses. `subject` is a `RecordingSubject` in the places "recording" and
        "tracking", a `RunResult` in the others. A figure is drawn again only when these results change.
    draw : callable
        ``draw(figure, shown)`` draws into an empty matplotlib figure; False leaves the figure out.
    alt, caption : str or callable
        Text, or a function of what is shown: what the figure shows for readers who do not see it, and what to look for.
    height_in, width_in : float
    essential : bool
        Drawn also in a page of more than 12 recordings.
    """

    key: str
    place: Place
    title: str
    shows: Callable[[Any], Shown | None]
    draw: Callable[[Figure, Shown], bool | None]
    alt: str | Callable[[Shown], str]
    caption: str | Callable[[Shown], str]
    height_in: float = 2.5
    width_in: float = WIDTH_IN
    essential: bool = False

    def view(self, figure_id: str, shown: Shown, cache: Cache | None = None) -> FigureView | None:
        """The figure for the page, drawn unless `cache` holds it; None where there is nothing to draw."""
        draw = partial(self._svg, shown)
        svg = draw() if cache is None else cache.cached(self.cache_key(shown), draw)
        if not svg:
            return None
        alt, caption = (text if isinstance(text, str) else text(shown) for text in (self.alt, self.caption))
        return FigureView(figure_id, self.title, inline(svg, figure_id, alt), caption)

    def cache_key(self, shown: Shown) -> str:
        """Hash of all that determines the drawing: results, size, colours, drawing code, version of matplotlib."""
        size = (self.height_in, self.width_in)
        return digest((self.key, size, variables(), _code(self.draw.__module__), mpl.__version__, shown))

    def _svg(self, shown: Shown) -> str:
        with figure_style():
            figure = new_figure(self.height_in, self.width_in)
            return "" if self.draw(figure, shown) is False else figure_svg(figure)


@remembered
def _code(module: str) -> tuple[str, ...]:
    """Source of a module and of the modules of this package that it was drawn with."""
    package = __name__.removesuffix(".figures.base")
    common = [n for n in sys.modules if n.startswith((f"{package}.style.", f"{package}.derived."))]
    return tuple(
        inspect.getsource(sys.modules[n]) for n in (*sorted(common), f"{package}.figures.axes", module)
    )
