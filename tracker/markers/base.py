"""What every detector offers: the markers of a recording, and the same markers again in a later frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from tracker.arrays import FloatArray, GrayImage
from tracker.template.spline import Template

FoundKind = Literal["aruco", "blob", "patch"]


@dataclass(frozen=True)
class Detection:
    """A marker as a detector saw it: good enough to start the registration.

    Attributes
    ----------
    name : str
    kind : str
        "aruco", "blob" or "patch".
    frame : int
        Index of the frame, among those that were given, in which it was seen.
    x_px, y_px : float
        Centre, to a pixel or so.
    warp : array, shape (2, 2)
        From the picture to the marker's own frame, in px.
    size_px : float
        Side of a marker, diameter of a dot, side of a patch's window.
    template : Template
        A first picture of it; values from 0 (dark) to 1 (light), or gray levels for a patch.
    bits : uint8 array or None
        Cells of an ArUco marker, border included, 1 white.
    position_mm : float
        Distance from the clamp; NaN where unknown.
    """

    name: str
    kind: FoundKind
    frame: int
    x_px: float
    y_px: float
    warp: FloatArray
    size_px: float
    template: Template
    bits: NDArray[np.uint8] | None = None
    position_mm: float = float("nan")


@dataclass(frozen=True)
class FoundMarkers:
    """Markers in order along the beam where that is known, and what the user should know."""

    detections: tuple[Detection, ...]
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class NothingFound:
    """No markers, or not those that were announced: falsy, with the reason.

    ``seen_px``, shape (c, 2), holds places in the first frame that might have been meant.
    """

    reason: str
    seen_px: FloatArray | None = None

    def __bool__(self) -> bool:
        return False


class MarkerDetector(Protocol):
    """One way of finding markers."""

    def detect(self, frames: list[GrayImage]) -> FoundMarkers | NothingFound:
        """Markers of a recording from its first good frames."""

    def redetect(self, image: GrayImage, sought: tuple[Detection, ...]) -> list[Detection]:
        """Those of `sought` that are seen in one frame; names are kept, identity is certain or not claimed."""
