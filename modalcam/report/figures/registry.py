"""The figures of the report, in their order on the page."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any, get_args

from modalcam.pipeline import Cache
from modalcam.report.figures.base import FigureKind, Place
from modalcam.report.figures.damping import DAMPING, INSTANTANEOUS, VARIANTS
from modalcam.report.figures.decay import CLOSE_UP, DECAY, ENVELOPE, EXTREMES
from modalcam.report.figures.frequency import AMBIENT, RESPONSE, SPECTRUM, STABILITY
from modalcam.report.figures.posterior import POSTERIOR, TRACE
from modalcam.report.figures.shape import FIELDS, SHAPE, WATERFALL
from modalcam.report.figures.simulated import SIMULATED
from modalcam.report.figures.tracking import TRACKING
from modalcam.report.style import FigureView

_RECORDING = (
    DECAY,
    AMBIENT,
    RESPONSE,
    POSTERIOR,
    CLOSE_UP,
    ENVELOPE,
    INSTANTANEOUS,
    TRACE,
    SPECTRUM,
    STABILITY,
    SHAPE,
    WATERFALL,
    SIMULATED,
)
FIGURES: dict[str, FigureKind[Any]] = {
    kind.key: kind for kind in (*_RECORDING, TRACKING, EXTREMES, DAMPING, VARIANTS, FIELDS)
}


def register_figure(kind: FigureKind[Any]) -> None:
    """Add a figure after those of its place.

    Raises
    ------
    ValueError
        If its key is taken or not made of lower-case letters and digits, or its place is unknown.
    """
    if not re.fullmatch(r"[a-z][a-z0-9]*", kind.key) or kind.key in FIGURES:
        msg = f"figure {kind.key!r}: expected a key of lower-case letters and digits that is not in {sorted(FIGURES)}"
        raise ValueError(msg)
    if kind.place not in get_args(Place):
        msg = f"figure {kind.key!r}: place must be one of {', '.join(get_args(Place))}, got {kind.place!r}"
        raise ValueError(msg)
    FIGURES[kind.key] = kind


# Of a recording, and of the whole run; in the order on the page.
RECORDING_PLACES: tuple[Place, ...] = ("recording", "tracking")
RUN_PLACES: tuple[Place, ...] = ("overview", "damping", "comparison", "updating")


def shown_in(
    places: tuple[Place, ...], subject: object, *, only_essential: bool = False
) -> Iterator[tuple[FigureKind[Any], Any]]:
    """Kinds of figures of some places that have anything to show, each with what it shows."""
    for place in places:
        for kind in FIGURES.values():
            if kind.place == place and (kind.essential or not only_essential):
                shown = kind.shows(subject)
                if shown is not None:
                    yield kind, shown


def figures_of(
    place: Place, subject: object, prefix: str, *, only_essential: bool = False, cache: Cache | None = None
) -> Iterator[FigureView]:
    """Figures of one place; their ids begin with `prefix`."""
    for kind, shown in shown_in((place,), subject, only_essential=only_essential):
        view = kind.view(f"{prefix}-{kind.key}", shown, cache)
        if view is not None:
            yield view
