"""Storage of results while the length of the recording is not yet known."""

from __future__ import annotations

import numpy as np

from tracker.arrays import FlagArray, FloatArray, IntArray

# Rows per array: enough that few arrays are needed, few enough that an unfinished one costs little memory.
CHUNK_ROWS = 1024


class RowStore:
    """Results of m markers frame by frame: 36 m bytes per row, without an object for each."""

    def __init__(self, markers: int) -> None:
        self._markers = markers
        self._values: list[FloatArray] = []
        self._flags: list[FlagArray] = []
        self._count = 0

    def append(self, values: FloatArray, flags: FlagArray) -> None:
        """Copy the result of a frame: q values of m markers, x, y and their sd in px first, and flags, shape (m,)."""
        row = self._count % CHUNK_ROWS
        if row == 0:
            self._values.append(np.empty((len(values), CHUNK_ROWS, self._markers)))
            self._flags.append(np.empty((CHUNK_ROWS, self._markers), dtype=np.uint32))
        self._values[-1][:, row] = values
        self._flags[-1][row] = flags
        self._count += 1

    def columns(self, order: IntArray) -> tuple[FloatArray, FlagArray]:
        """Values of shape (q, n, m) and flags of shape (n, m), with the rows in the given order."""
        no_flags = np.empty((0, self._markers), dtype=np.uint32)
        values = np.concatenate(self._values or [np.empty((4, 0, self._markers))], axis=1)[:, order]
        return values, np.concatenate([no_flags, *self._flags])[order]
