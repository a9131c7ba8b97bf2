"""What is kept of a recording's footage, and of the simulated beam filmed beside it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tracker.arrays import FloatArray


@dataclass(frozen=True)
class KeptFrames:
    """Frames of a recording, cropped to its markers and reduced by averaging whole blocks of pixels.

    Attributes
    ----------
    recording : str
    frame : int array, shape (n,)
        Rows of the recording, evenly spaced.
    time_s : array, shape (n,)
    images : uint8 array, shape (n, height, width)
        0 is black and 255 the camera's white.
    shrink : int
        Side of a block in pixels of the recording.
    left_px, top_px : int
        The crop's corner in the recording.
    noise_sd : float
        Of a pixel of the recording in these gray levels.
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


@dataclass(frozen=True)
class NoKeptFrames:
    """A recording of which no frames were kept: falsy, with the reason."""

    recording: str
    reason: str

    def __bool__(self) -> bool:
        return False


@dataclass(frozen=True)
class SimulatedFootage:
    """Frames of the simulated beam at the instants of a recording's footage.

    Attributes
    ----------
    recording : str
    time_s : array, shape (n,)
    images : uint8 array, shape (n, height, width)
        As the footage's images.
    mm_per_px : float
        Of these pictures.
    period_s : float
        Of the recording's mode.
    largest_mm : float
        Largest simulated displacement from rest of a marker in these frames.
    difference_mm : float
        Rms distance between measured and simulated centres in these frames; NaN where none was measured.
    most_moving_px : tuple of float
        Place at rest in these pictures, x and y, of the marker that moves most.
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
class NoSimulatedFootage:
    """A recording whose beam was not filmed: falsy, with the reason."""

    recording: str
    reason: str

    def __bool__(self) -> bool:
        return False
