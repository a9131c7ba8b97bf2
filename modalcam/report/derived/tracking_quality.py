"""How well the stated standard deviations of positions agree with the scatter that the series themselves show."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from tracker import flags
from tracker.arrays import FloatArray
from tracker.results import MarkerTracks
from tracker.template.compression import NEIGHBOURS, prediction

# Bins of time in which residuals are pooled.
BINS = 60


@dataclass(frozen=True)
class TrackingQuality:
    """Stated standard deviations and measured scatter.

    Median sd and scatter of x and of y of each marker, shape (2, m), NaN where a series is too short; middle of each
    bin of time, and rms of residual over stated sd of all markers within it, shape (b,).
    """

    stated_px: FloatArray
    scatter_px: FloatArray
    bin_time_s: FloatArray
    ratio: FloatArray


def tracking_quality(tracks: MarkerTracks) -> TrackingQuality | None:
    """Compare stated sd with scatter; None where no series is long enough.

    The scatter is what a linear prediction from neighbours on both sides leaves of each sample: vibration of a few
    frequencies is predictable, errors from frame to frame are not. Errors slower than a few frames are not seen.
    """
    m = len(tracks.markers)
    stated, scatter = np.full((2, m), np.nan), np.full((2, m), np.nan)
    squares = np.full((2 * m, tracks.time_s.size), np.nan)
    repeated = (tracks.flags & flags.LEFT_OUT) > 0
    axes = ((tracks.x_px, tracks.sd_x_px), (tracks.y_px, tracks.sd_y_px))
    for c, (values, sd) in enumerate(axes):
        for k in range(m):
            residual = prediction_residual(np.where(repeated[:, k], np.nan, values[:, k]))
            good = np.isfinite(residual) & (sd[:, k] > 0.0)
            if np.count_nonzero(good) < NEIGHBOURS:
                continue
            stated[c, k] = np.median(sd[good, k])
            # A median: a few lost frames or jumps are not the scatter of the rest.
            scatter[c, k] = 1.4826 * np.median(np.abs(residual[good]))
            squares[c * m + k, good] = (residual[good] / sd[good, k]) ** 2
    if not np.isfinite(scatter).any():
        return None
    time_s, ratio = _in_bins(tracks.time_s, squares)
    return TrackingQuality(stated, scatter, time_s, ratio)


def prediction_residual(series: FloatArray) -> FloatArray:
    """Part of each sample that its neighbours on both sides do not predict, scaled to the sd of white errors.

    Parameters
    ----------
    series : array, shape (n,)
        NaN where missing.

    Returns
    -------
    array, shape (n,)
        NaN at both ends, where a neighbour is missing, and everywhere in a series that is too short.
    """
    residual, sd = prediction(series, first=1, count=NEIGHBOURS)
    residual /= sd
    return residual


def _in_bins(time_s: FloatArray, squares: FloatArray) -> tuple[FloatArray, FloatArray]:
    bins = min(BINS, max(time_s.size // 20, 1))
    edges = np.linspace(0, time_s.size, bins + 1).astype(np.int64)
    middle, ratio = np.full(bins, np.nan), np.full(bins, np.nan)
    for b, (start, stop) in enumerate(pairwise(edges)):
        part = squares[:, start:stop]
        middle[b] = 0.5 * (time_s[start] + time_s[stop - 1])
        good = np.isfinite(part)
        if good.any():
            ratio[b] = np.sqrt(np.mean(part[good]))
    return middle, ratio
