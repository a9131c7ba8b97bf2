"""What is known of the markers in one frame, and how the compiled calls hand it over."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tracker import flags
from tracker.arrays import FloatArray
from tracker.register.batch import take_over

SEEN_SHARE = 0.98
BITS = np.array(
    [f.value for f in (flags.NOT_FOUND, flags.EDGE, flags.SATURATED, flags.BLURRED, flags.POOR_FIT)],
    dtype=np.uint32,
)


@dataclass(frozen=True)
class FrameResult:
    """Positions of m markers in one frame; NaN and NOT_FOUND where a marker is missing.

    Where the exposure is known, those of a frame in which markers are blurred are completed in place by the next
    step, or by `Follower.finish`: the path during an exposure is known from the frames on both sides.

    Attributes
    ----------
    x_px, y_px, sd_x_px, sd_y_px : array, shape (m,)
    flags : uint32 array, shape (m,)
    """

    x_px: FloatArray
    y_px: FloatArray
    sd_x_px: FloatArray
    sd_y_px: FloatArray
    flags: NDArray[np.uint32]


def missing_row(markers: int, flag: int) -> FrameResult:
    """The row of a frame without picture."""
    nothing = np.full(markers, np.nan)
    return FrameResult(
        nothing, nothing, nothing, nothing, np.full(markers, flag | flags.NOT_FOUND.value, dtype=np.uint32)
    )


def taken_over(
    results: FloatArray,
    marks: NDArray[np.uint32],
    motion: FloatArray,
    warps: FloatArray,
    centres_uv: FloatArray,
    limits: FloatArray,
    states: FloatArray,
    lost: NDArray[np.int64],
) -> tuple[FloatArray, FloatArray]:
    """Positions with sd, shape (4, m), and registered places, shape (m, 2); see `take_over`."""
    m = len(results)
    out, places = np.empty((4, m)), np.empty((m, 2))
    take_over(results, marks, motion, warps, centres_uv, limits, SEEN_SHARE, BITS, states, lost, places, out)
    return out, places
