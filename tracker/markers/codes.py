"""Codes of ArUco markers read in images by OpenCV, and how well the image shows the print that was read."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from tracker.arrays import FloatArray

# The largest dictionary of each family contains the markers of the smaller ones under the same ids.
FAMILIES: tuple[tuple[str, ...], ...] = (
    *(tuple(f"DICT_{n}X{n}_{count}" for count in (50, 100, 250, 1000)) for n in (4, 5, 6, 7)),
    ("DICT_ARUCO_ORIGINAL",),
    ("DICT_ARUCO_MIP_36h12",),
    ("DICT_APRILTAG_36h11",),
    ("DICT_APRILTAG_36h10",),
    ("DICT_APRILTAG_25h9",),
    ("DICT_APRILTAG_16h5",),
)
# Pixels per cell at which a reading is compared with its print, and blurs of the print, px of the image.
CELL_PX, BLURS_PX = 8, (0.0, 0.7, 1.4)


@dataclass(frozen=True)
class CodeReading:
    """Corners of one marker, clockwise from its own top left, pixel centres at integers; shape (4, 2)."""

    marker_id: int
    corners_px: FloatArray
    frame: int = 0


def dictionary_names() -> tuple[str, ...]:
    """Names that the setting ``dictionary`` accepts besides "auto"."""
    return tuple(name for family in FAMILIES for name in family)


def dictionary_of(name: str) -> cv2.aruco.Dictionary:
    """OpenCV's dictionary of this name."""
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))


def opencv_detector(dictionary: cv2.aruco.Dictionary, *, strict: bool) -> cv2.aruco.ArucoDetector:
    """OpenCV's detector, configured for small markers; a strict one accepts no code with a wrong bit."""
    parameters = cv2.aruco.DetectorParameters()
    parameters.minMarkerPerimeterRate = 0.01
    parameters.adaptiveThreshWinSizeMax = 33
    parameters.perspectiveRemovePixelPerCell = 8
    if strict:
        parameters.errorCorrectionRate = 0.0
    return cv2.aruco.ArucoDetector(dictionary, parameters)


def read_codes(
    image: NDArray[np.uint8], detector: cv2.aruco.ArucoDetector, *, upscaling: int = 1
) -> list[CodeReading]:
    """All markers in an image; an id that occurs twice is omitted as ambiguous."""
    if upscaling > 1:
        enlarged = cv2.resize(image, None, fx=upscaling, fy=upscaling, interpolation=cv2.INTER_CUBIC)
        image = np.asarray(enlarged, dtype=np.uint8)
    corners, ids, _ = detector.detectMarkers(image)
    if ids is None:
        return []
    seen: dict[int, list[FloatArray]] = defaultdict(list)
    for marker_id, quad in zip(ids.ravel(), corners, strict=True):
        # Resizing preserves areas: pixel p of the small image is centred at scale * p + (scale - 1) / 2.
        points = (quad.reshape(4, 2).astype(np.float64) - 0.5 * (upscaling - 1)) / upscaling
        seen[int(marker_id)].append(points)
    return [CodeReading(i, quads[0]) for i, quads in sorted(seen.items()) if len(quads) == 1]


def likeness(image: NDArray[np.uint8], reading: CodeReading, dictionary: cv2.aruco.Dictionary) -> float:
    """Correlation of the image with the print of the code, border included, at the best of some blurs.

    A code is read from a bit for each cell; shadows, bricks or texture can have the same bits by chance, but look
    otherwise.
    """
    bits = printed_bits(dictionary, reading.marker_id)
    side = len(bits) * CELL_PX
    corners = np.array([[0, 0], [side, 0], [side, side], [0, side]], dtype=np.float32) - np.float32(0.5)
    view = cv2.getPerspectiveTransform(reading.corners_px.astype(np.float32), corners)
    seen = cv2.warpPerspective(image, view, (side, side), flags=cv2.INTER_LINEAR).astype(np.float64)
    ideal = np.kron(bits, np.ones((CELL_PX, CELL_PX)))
    if np.ptp(seen) == 0.0:
        return 0.0
    enlarged = side / np.sqrt(max(abs(float(cv2.contourArea(reading.corners_px.astype(np.float32)))), 1.0))
    prints = (ndimage.gaussian_filter(ideal, blur * enlarged, mode="constant", cval=1.0) for blur in BLURS_PX)
    return max(float(np.corrcoef(seen.ravel(), p.ravel())[0, 1]) for p in prints)


def printed_bits(dictionary: cv2.aruco.Dictionary, marker_id: int) -> NDArray[np.uint8]:
    """Cells of a marker, border included, 1 white."""
    drawn = cv2.aruco.generateImageMarker(dictionary, marker_id, dictionary.markerSize + 2)
    return np.asarray(np.asarray(drawn) > 127, dtype=np.uint8)
