"""Offset and slow drift: cubic B-splines too slow to absorb a mode."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import BSpline
from scipy.sparse import csr_array

from tracker.arrays import FloatArray

# The baseline contains frequencies up to this fraction of the lowest mode's, and at first up to the ceiling, which
# `modal_id.fit.drift` may raise.
RELATIVE_BANDWIDTH = 0.4
_CEILING_HZ = 1.0
# Each sample lies in this many cubic splines. Samples at a time: the splines of a long record are its largest array.
_OVERLAPPING = 4
_BLOCK = 65_536


def bandwidth_hz(lowest_frequency_hz: float) -> float:
    """Highest frequency of the baseline when this is the lowest mode."""
    return min(RELATIVE_BANDWIDTH * lowest_frequency_hz, _CEILING_HZ)


def baseline_matrix(time_s: FloatArray, bandwidth: float) -> FloatArray:
    """The columns of `baseline_splines`, dense."""
    return np.asarray(baseline_splines(time_s, bandwidth).toarray())


def baseline_splines(time_s: FloatArray, bandwidth: float) -> csr_array:
    """Cubic B-splines with a knot every ``1 / (2 bandwidth)`` seconds.

    A record shorter than one knot interval gets a straight line instead: more columns could absorb the mode.
    B-splines, because a cosine series leaks the end-to-end step of a trend into the lowest mode.

    Times increase; `bandwidth` in Hz is positive. The columns span the constants.
    """
    start, end = float(time_s[0]), float(time_s[-1])
    intervals = int((end - start) * 2.0 * bandwidth)
    if intervals < 1:
        centred = (time_s - 0.5 * (start + end)) / max(end - start, np.finfo(float).tiny)
        return csr_array(np.column_stack([np.ones_like(time_s), centred]))
    inner = np.linspace(start, end, intervals + 1)
    knots = np.concatenate([np.full(3, start), inner, np.full(3, end)])
    entries = np.empty(_OVERLAPPING * time_s.size)
    columns = np.empty(entries.size, dtype=np.int32)
    for first in range(0, time_s.size, _BLOCK):
        part = BSpline.design_matrix(time_s[first : first + _BLOCK], knots, 3)
        own = slice(_OVERLAPPING * first, _OVERLAPPING * first + part.nnz)
        entries[own], columns[own] = part.data, part.indices
    rows = np.arange(0, entries.size + 1, _OVERLAPPING, dtype=np.int32)
    return csr_array((entries, columns, rows), shape=(time_s.size, knots.size - _OVERLAPPING))
