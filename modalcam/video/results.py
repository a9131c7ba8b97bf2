"""Kept frames of a recording, and the same frames of the simulated beam."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tracker.arrays import FloatArray


@dataclass(frozen=True, eq=False)
class KeptFrames:
    """Frames of a recording, cropped to its markers and reduced by averaging whole blocks of pixels.

    Attributes
    ----------
    frame : int array, shape (n,)
        Rows of the tracks, evenly spaced.
    time_s : array, shape (n,)
    images : uint8 array, shape (n, height, width)
        0 is black and 255 the camera's white.
    shrink : int
        Side of a block in pixels of the recording.
    left_px, top_px : int
        Corner of the crop in the recording.
    noise_sd : float
        Of a pixel of the recording, in these gray levels.
    period_s : float
        Of the mode that is shown.
    """

    recording: str
    frame: NDArray[np.int64]
    time_s: FloatArray
    images: NDArray[np.uint8]
    shrink: int
    left_px: int
    top_px: int
    noise_sd: float
    period_s: float


@dataclass(frozen=True, eq=False)
class SimulatedFootage:
    """Frames of the simulated beam at the times of the kept frames of a recording.

    Attributes
    ----------
    images : uint8 array, shape (n, height, width)
        With the crop, scale and gray levels of the kept frames.
    mm_per_px : float
        Of these images.
    period_s : float
        Of the recording's mode.
    largest_mm : float
        Largest simulated displacement of a marker from rest in these frames.
    difference_mm : float
        Rms distance between measured and simulated centres in these frames; NaN if none was measured.
    most_moving_px : tuple of float
        Rest position, x and y in these images, of the marker with the largest displacement.
    """

    recording: str
    time_s: FloatArray
    images: NDArray[np.uint8]
    mm_per_px: float
    period_s: float
    largest_mm: float
    difference_mm: float
    most_moving_px: tuple[float, float]


@dataclass(frozen=True)
class NoFootage:
    """Frames that were not kept, or a simulation that was not rendered: falsy, with the reason."""

    recording: str
    reason: str

    def __bool__(self) -> bool:
        return False
