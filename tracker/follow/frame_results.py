"""What is known of the markers in one frame, and how the compiled calls hand it over."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tracker import flags
from tracker.arrays import FloatArray
from tracker.follow.batch import take_over

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


# Rows of one array: enough that few are needed, and few enough that an unfinished one costs little memory.
CHUNK_ROWS = 1024


class RowStore:
    """Positions, their sd and flags of m markers, frame by frame: 36 m bytes a row, and no object of its own.

    Parameters
    ----------
    markers : int
    """

    def __init__(self, markers: int) -> None:
        self._markers = markers
        self._values: list[FloatArray] = []
        self._flags: list[NDArray[np.uint32]] = []
        self._count = 0

    def __len__(self) -> int:
        return self._count

    def append(
        self,
        x_px: FloatArray,
        y_px: FloatArray,
        sd_x_px: FloatArray,
        sd_y_px: FloatArray,
        flags: NDArray[np.uint32],
    ) -> None:
        """Copy the arrays of a frame, each of shape (m,)."""
        row = self._count % CHUNK_ROWS
        if row == 0:
            self._values.append(np.empty((4, CHUNK_ROWS, self._markers)))
            self._flags.append(np.empty((CHUNK_ROWS, self._markers), dtype=np.uint32))
        values = self._values[-1]
        values[0, row], values[1, row], values[2, row], values[3, row] = x_px, y_px, sd_x_px, sd_y_px
        self._flags[-1][row] = flags
        self._count += 1

    def columns(self, order: NDArray[np.int64]) -> dict[str, NDArray[Any]]:
        """``x_px, y_px, sd_x_px, sd_y_px`` and ``flags``, each of shape (n, m), with the rows in the order given."""
        names = ("x_px", "y_px", "sd_x_px", "sd_y_px")
        nothing = np.empty((4, 0, self._markers)), np.empty((0, self._markers), dtype=np.uint32)
        columns: dict[str, NDArray[Any]] = {}
        for k, name in enumerate(names):
            columns[name] = np.concatenate([nothing[0][k], *(v[k] for v in self._values)])[order]
        columns["flags"] = np.concatenate([nothing[1], *self._flags])[order]
        return columns
