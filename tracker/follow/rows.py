"""The measured rows of a recording, kept in arrays while its length is not yet known."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tracker.arrays import FloatArray

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
