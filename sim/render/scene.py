"""What the camera sees: markers on moving points, and the beam behind them."""

from __future__ import annotations

from dataclasses import dataclass

from sim.render.markers import Marker
from sim.render.motion import Motion


@dataclass(frozen=True, kw_only=True)
class Strip:
    """The beam seen edge-on: a polyline of constant width, hidden where a marker covers it.

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
        if not self.width_mm > 0.0:
            msg = f"width_mm of a strip must be positive, got {self.width_mm}"
            raise ValueError(msg)


@dataclass(frozen=True, kw_only=True)
class Scene:
    """Moving markers, point i of the motion carrying ``markers[i]``, and optionally the beam behind them."""

    markers: tuple[Marker, ...]
    motion: Motion
    strip: Strip | None = None
