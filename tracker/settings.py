"""What the user may tell the tracker about a recording."""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction
from typing import Literal

from tracker.geometry.lens import Lens

MarkerKind = Literal["aruco", "blob", "patch", "auto"]
ClampSide = Literal["top", "bottom", "left", "right"]
KINDS = ("aruco", "blob", "patch", "auto")
SIDES = ("top", "bottom", "left", "right")


@dataclass(frozen=True)
class TrackerSettings:
    """Settings of one recording; everything is optional.

    Attributes
    ----------
    fps : Fraction or None
        Rate at which the scene was recorded; overrides whatever the file says.
    mm_per_px, sd_mm_per_px : float or None
        Scale in the plane of the beam, and its standard deviation where it is known.
    exposure_s : float or None
        Exposure time of a frame: with it the motion blur is part of the template. None: told from the blur of markers
        that move by more than a px between frames, with a note.
    kind : str
        "aruco", "blob", "patch", or "auto" (the first of the three that fits the picture).
    dictionary : str
        Name of an OpenCV ArUco dictionary, or "auto".
    size_mm : float or None
        Side of an ArUco marker (outer edge of its black border) or diameter of a dot.
    positions_mm : tuple of float or None
        Distance of each marker from the clamp, in order along the beam; for ArUco in order of id.
    points_px : tuple of (x, y) or None
        Centres of the patches in the first frame.
    size_px : float or None
        Side of the square window of a patch; from the local texture when None.
    clamp_side : str or None
        Side of the picture at which the beam is clamped; decides the order of blobs.
    reference : tuple of str
        Names of markers that do not move: subtracted from the displacement of the others.
    lens : Lens or None
        Distortion of the camera's lens, from a calibration.
    readout_s : float or None
        Time from the exposure of the first row to that of the last; negative when rows are read from below.
    plane_mm : tuple of (x, y) or None
        Where each marker at rest lies in the plane of motion, x right, y up, in the order of `positions_mm`: four or
        more off one line tell how oblique the view is.

    Raises
    ------
    ValueError
        For a value that cannot be meant: a rate, size or scale that is not positive and finite, an unknown
        kind or side, a point that is not finite.
    """

    fps: Fraction | None = None
    mm_per_px: float | None = None
    sd_mm_per_px: float | None = None
    exposure_s: float | None = None
    kind: MarkerKind = "auto"
    dictionary: str = "DICT_4X4_50"
    size_mm: float | None = None
    positions_mm: tuple[float, ...] | None = None
    points_px: tuple[tuple[float, float], ...] | None = None
    size_px: float | None = None
    clamp_side: ClampSide | None = None
    reference: tuple[str, ...] = ()
    lens: Lens | None = None
    readout_s: float | None = None
    plane_mm: tuple[tuple[float, float], ...] | None = None

    def __post_init__(self) -> None:
        for name in ("fps", "mm_per_px", "exposure_s", "size_mm", "size_px"):
            value = getattr(self, name)
            if value is not None and not (math.isfinite(value) and value > 0):
                msg = f"{name} must be positive and finite, got {value}"
                raise ValueError(msg)
        if self.kind not in KINDS:
            msg = f"kind must be one of {', '.join(KINDS)}, got {self.kind!r}"
            raise ValueError(msg)
        if self.clamp_side is not None and self.clamp_side not in SIDES:
            msg = f"clamp_side must be one of {', '.join(SIDES)}, got {self.clamp_side!r}"
            raise ValueError(msg)
        if self.kind == "patch" and not self.points_px:
            msg = (
                "kind 'patch' follows points that you give: set points_px to their centres in the first frame"
            )
            raise ValueError(msg)
        _check_pairs("points_px", self.points_px)
        _check_pairs("plane_mm", self.plane_mm)
        if self.readout_s is not None and not math.isfinite(self.readout_s):
            msg = f"readout_s must be finite, got {self.readout_s}"
            raise ValueError(msg)
        if self.positions_mm is not None:
            if not all(math.isfinite(p) for p in self.positions_mm):
                msg = f"positions_mm must be finite, got {self.positions_mm}"
                raise ValueError(msg)
            if len(set(self.positions_mm)) != len(self.positions_mm):
                msg = f"positions_mm must differ from each other, got {self.positions_mm}"
                raise ValueError(msg)


def _check_pairs(name: str, pairs: tuple[tuple[float, float], ...] | None) -> None:
    for pair in pairs or ():
        if len(pair) != 2 or not all(math.isfinite(c) for c in pair):
            msg = f"each of {name} must be a finite (x, y), got {pair}"
            raise ValueError(msg)
