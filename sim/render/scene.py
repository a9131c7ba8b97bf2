"""What the camera sees: markers on moving points, and the beam behind them."""

from __future__ import annotations

from dataclasses import dataclass

from sim.render.camera import Motion
from sim.render.markers import Marker, Texture
from sim.render.strip import BareStrip
from tracker import checked


@dataclass(frozen=True, kw_only=True)
class Strip:
    """The beam behind markers: a polyline of constant width and brightness, hidden where a marker covers it.

    Cheap; where the beam is to be measured itself, use `BareStrip`.

    Each segment is an exact blurred rectangle. At a joint two segments overlap or leave a gap of ``width^2 / 8`` times
    the angle between them, and a chord deviates from its arc by ``curvature length^2 / 8``: choose segments short
    enough for both to be well below a pixel.

    Attributes
    ----------
    width_mm, gray : float
    motion : Motion
        Of the points on the centreline, in order; the angles are not used.
    """

    width_mm: float
    gray: float
    motion: Motion

    def __post_init__(self) -> None:
        checked("width_mm of a strip", self.width_mm, positive=True)


@dataclass(frozen=True, kw_only=True)
class Scene:
    """Moving markers, point i of the motion carrying ``markers[i]``; optionally the beam and a pattern behind them.

    The pattern, a `backdrop` at rest, is added to the camera's background. It needs a bare strip, or nothing else: the
    image of a marker is that in front of an even background.
    """

    markers: tuple[Marker, ...]
    motion: Motion
    strip: Strip | BareStrip | None = None
    backdrop: Texture | None = None

    def __post_init__(self) -> None:
        if self.backdrop is not None and (self.markers or isinstance(self.strip, Strip)):
            msg = "a backdrop is rendered behind a bare strip without markers only; leave out the backdrop"
            raise ValueError(msg)
