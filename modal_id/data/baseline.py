"""Offset and slow drift: cubic B-splines too slow to absorb a mode."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.sparse import csr_array

from tracker import FloatArray

# The baseline contains frequencies up to this fraction of the lowest mode's, and at first up to the ceiling, which
# `modal_id.fit.model_order` may raise.
RELATIVE_BANDWIDTH = 0.4


@dataclass(frozen=True)
class Tuning:
    """Bandwidth of the baseline."""

    #: [Hz] largest frequency of the baseline at first
    #: convention: `modal_id.fit.model_order` may raise it.
    ceiling_hz: float = 1.0
    #: [1] number of values up to which functions of time are held in memory for all samples
    #: convention: Limits the memory.
    few_values: int = 500_000


TUNING = Tuning()
FEW_VALUES = TUNING.few_values

# Each sample lies in this many cubic splines; columns of a straight line.
_OVERLAPPING, _OF_LINE = 4, 2


def bandwidth_hz(lowest_frequency_hz: float) -> float:
    """Highest frequency of the baseline when this is the lowest mode."""
    return min(RELATIVE_BANDWIDTH * lowest_frequency_hz, TUNING.ceiling_hz)


@dataclass(frozen=True)
class Splines:
    """Cubic B-splines as columns, shape (n, b), or a straight line where there are no knots.

    Their rows are made when they are needed: held, those of a long record are its largest array.
    """

    time_s: FloatArray
    knots: FloatArray

    @property
    def shape(self) -> tuple[int, int]:
        """Of all columns."""
        return self.time_s.size, max(self.knots.size - _OVERLAPPING, _OF_LINE)

    def __getitem__(self, rows: slice | NDArray[np.intp]) -> csr_array:
        """Some rows of the columns, sparse."""
        if not self.knots.size:
            start, end = float(self.time_s[0]), float(self.time_s[-1])
            centred = (self.time_s[rows] - 0.5 * (start + end)) / max(end - start, np.finfo(float).tiny)
            return csr_array(np.column_stack([np.ones_like(centred), centred]))
        if _OVERLAPPING * self.time_s.size > FEW_VALUES:
            entries, columns = _cubic(np.ascontiguousarray(self.time_s[rows]), self.knots)
        else:
            entries, columns = self._held[0][rows], self._held[1][rows]
        # Put together from entries that are held: SciPy takes longer for some rows of an array than for most products.
        first = np.arange(0, entries.size + 1, _OVERLAPPING, dtype=np.int32)
        shape = (entries.shape[0], self.shape[1])
        return csr_array((entries.ravel(), columns.ravel(), first), shape=shape)

    @cached_property
    def _held(self) -> tuple[FloatArray, NDArray[np.int32]]:
        """Entries and columns of all rows, where they are few enough to be held."""
        return _cubic(np.ascontiguousarray(self.time_s), self.knots)


def baseline_matrix(time_s: FloatArray, bandwidth: float) -> FloatArray:
    """The columns of `baseline_splines`, dense."""
    return np.asarray(baseline_splines(time_s, bandwidth)[:].toarray())


def baseline_splines(time_s: FloatArray, bandwidth: float) -> Splines:
    """Cubic B-splines with a knot every ``1 / (2 bandwidth)`` seconds.

    A record shorter than one knot interval gets a straight line instead: more columns could absorb the mode.
    B-splines, because a cosine series leaks the end-to-end step of a trend into the lowest mode.

    Times increase; `bandwidth` in Hz is positive. The columns span the constants.
    """
    start, end = float(time_s[0]), float(time_s[-1])
    intervals = int((end - start) * 2.0 * bandwidth)
    if intervals < 1:
        return Splines(time_s, np.empty(0))
    inner = np.linspace(start, end, intervals + 1)
    return Splines(time_s, np.concatenate([np.full(3, start), inner, np.full(3, end)]))


@njit(cache=True, nogil=True, error_model="numpy")
def _cubic(time_s: FloatArray, knots: FloatArray) -> tuple[FloatArray, NDArray[np.int32]]:
    """The four splines that are not zero at each time and their columns, both of shape (n, 4).

    A fifth of the time of `scipy.interpolate.BSpline.design_matrix`, which counts because rows are made in each pass.
    Even knots, of which the first and the last are there four times. De Boor (1972), doi:10.1016/0021-9045(72)90080-9.
    """
    entries, columns = np.empty((time_s.size, 4)), np.empty((time_s.size, 4), dtype=np.int32)
    last = knots.size - 5
    per_s = 1.0 / (knots[4] - knots[3])
    above, below = np.empty(4), np.empty(4)
    for row in range(time_s.size):
        t = time_s[row]
        at = min(max(3 + int((t - knots[3]) * per_s), 3), last)
        while at > 3 and t < knots[at]:
            at -= 1
        while at < last and t >= knots[at + 1]:
            at += 1
        entries[row, 0] = 1.0
        for degree in range(1, 4):
            above[degree], below[degree] = knots[at + degree] - t, t - knots[at + 1 - degree]
            carried = 0.0
            for k in range(degree):
                share = entries[row, k] / (above[k + 1] + below[degree - k])
                entries[row, k] = carried + above[k + 1] * share
                carried = below[degree - k] * share
            entries[row, degree] = carried
        for k in range(4):
            columns[row, k] = at - 3 + k
    return entries, columns
