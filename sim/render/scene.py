"""What stands before the camera: prints on moving points, and the beam behind them."""

from __future__ import annotations

from dataclasses import dataclass

from sim.render.markers import Print
from sim.render.motion import Motion


@dataclass(frozen=True, kw_only=True)
class Strip:
    """The beam seen edge-on: a polyline of constant width, hidden where a print's card covers it.

    Each segment is a blurred rectangle, exact by itself. At the joints of a bent line they overlap or gape by
    ``width^2 / 8`` times the angle, and a chord cuts its arc by ``curvature length^2 / 8``: take segments short
    enough for both to be well below a pixel.

    Attributes
    ----------
    width_mm, gray : float
    motion : Motion
        Of the points of the centreline, in order; the angles are not used.
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
    """Prints that move, and optionally the beam behind them.

    Attributes
    ----------
    prints : tuple of Print
    motion : Motion
        Point i of it carries ``prints[i]``.
    strip : Strip or None
    """

    prints: tuple[Print, ...]
    motion: Motion
    strip: Strip | None = None
