"""Traces thinned for the eye: the smallest and the largest sample of every pixel column are kept."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tracker.arrays import FloatArray

MAX_POINTS = 4000


def min_max(time_s: FloatArray, values: FloatArray, columns: int) -> tuple[FloatArray, FloatArray]:
    """Trace with at most two samples in each of `columns` equal spans of time, its extremes among them.

    Parameters
    ----------
    time_s : array, shape (n,)
        Not decreasing.
    values : array, shape (n,)
        NaN where missing. A span with no value at all keeps one NaN, so that the line breaks there.
    columns : int
        Of pixels; at most ``MAX_POINTS // 2``.

    Returns
    -------
    time_s, values : array
        Untouched where the trace is short enough already.

    Raises
    ------
    ValueError
        If `columns` is not between 1 and ``MAX_POINTS // 2``, or the shapes differ.
    """
    if not 1 <= columns <= MAX_POINTS // 2:
        msg = f"columns must lie between 1 and {MAX_POINTS // 2}, got {columns}"
        raise ValueError(msg)
    if time_s.shape != values.shape or time_s.ndim != 1:
        msg = (
            f"time_s and values must be one-dimensional and of one length, got {time_s.shape}, {values.shape}"
        )
        raise ValueError(msg)
    if time_s.size <= 2 * columns:
        return time_s, values
    edges = np.linspace(time_s[0], time_s[-1], columns + 1)[1:-1]
    starts = np.unique(np.concatenate(([0], np.searchsorted(time_s, edges))))
    starts = starts[starts < time_s.size]
    missing = np.isnan(values)
    low = _first(np.where(missing, np.inf, values), starts, np.minimum)
    high = _first(np.where(missing, -np.inf, values), starts, np.maximum)
    keep = np.unique(np.concatenate((low, high)))
    return time_s[keep], values[keep]


def _first(values: FloatArray, starts: NDArray[np.intp], extreme: np.ufunc) -> NDArray[np.intp]:
    """Index of the first extreme in each run; where the run is missing, of its first sample."""
    lengths = np.diff(np.append(starts, values.size))
    at = values == np.repeat(extreme.reduceat(values, starts), lengths)
    index = np.where(at, np.arange(values.size), values.size)
    return np.asarray(np.minimum.reduceat(index, starts), dtype=np.intp)
