"""Kept frames of a recording, and the same frames of the simulated beam."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tracker import FloatArray


@dataclass(frozen=True, eq=False)
class KeptFrames:
    """Frames of a recording, cropped to its markers and reduced by averaging whole blocks of pixels.

    `frame`, shape (n,), are rows of the tracks, evenly spaced. In `images`, shape (n, height, width), 0 is black, 255
    the camera's white. A block has `shrink` pixels of the recording at each side, in which the corner of the crop is at
    `left_px`, `top_px`. `noise_sd` is that of a pixel of the recording, in these gray levels; `period_s` is that of the
    mode that is shown.
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

    `images`, shape (n, height, width), have the crop, scale and gray levels of the kept frames. `largest_mm` is the
    largest simulated displacement of a marker from rest in them, `difference_mm` the rms distance between measured and
    simulated centres, NaN if none was measured; `most_moving_px` is the rest position, x and y in these images, of the
    marker with the largest displacement.
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
