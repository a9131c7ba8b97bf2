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
    return BSpline.design_matrix(time_s, knots, 3)
