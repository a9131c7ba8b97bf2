"""Clipped signals: the last sample at the limit of a sensor."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from modal_id.data.samples import runs
from tracker.arrays import FloatArray

_MIN_RUN = 4
_MIN_RUNS = 2
# A clipped run is this many times longer than a sine stays within one quantisation step of its peak.
_FACTOR = 4.0


def last_saturated_row(values: FloatArray) -> int | None:
    """Row of the last sample that belongs to a clipped peak of any channel, or None.

    A peak is clipped when many neighbouring samples share the channel's largest or smallest value (within 0.2 % of the
    range above or below the median, on several peaks). Quantised slow signals also repeat their largest value: the run
    must be longer than the quantisation explains.

    Parameters
    ----------
    values : array, shape (n, k)
        NaN where missing.
    """
    rows = [row for column in values.T for row in (_last_run(column), _last_run(-column)) if row is not None]
    return max(rows) if rows else None


def _last_run(column: FloatArray) -> int | None:
    good = np.flatnonzero(np.isfinite(column))
    if good.size < 4 * _MIN_RUN:
        return None
    x = column[good]
    top, middle = float(np.max(x)), float(np.median(x))
    if top <= middle:
        return None
    tolerance = 0.002 * (top - middle)
    at_top = x >= top - tolerance
    starts, ends = runs(at_top).T
    lengths = ends - starts
    if np.max(lengths) <= _MIN_RUN:
        return None
    crossings = np.count_nonzero(np.diff(x > middle))
    period = 2.0 * x.size / max(float(crossings), 1.0)
    steps = np.diff(np.unique(x))
    resolution = float(np.min(steps)) if steps.size else 0.0
    stay = period * np.sqrt(2.0 * (tolerance + resolution) / (top - middle)) / np.pi
    long = lengths > max(_MIN_RUN, _FACTOR * stay)
    # Peaks: the signal leaves the limit between them, unlike noise on a level that it has stepped to.
    peaks = np.flatnonzero(long)
    left = [np.min(x[ends[a] : starts[b]]) < 0.5 * (top + middle) for a, b in pairwise(peaks)]
    if not peaks.size or np.count_nonzero(left) + 1 < _MIN_RUNS:
        return None
    # Later and shorter runs at the same limit are clipped too.
    return int(good[ends[lengths >= 2][-1] - 1])
