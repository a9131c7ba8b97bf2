"""How well the stated standard deviations of positions agree with the scatter that the series themselves show."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tracker import FloatArray, IntArray, MarkerTracks, flags
from tracker.template import NEIGHBOURS, prediction

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
    edges = _bins(tracks.time_s.size)
    squares, count = np.zeros(edges.size - 1), np.zeros(edges.size - 1)
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
            residual = np.where(good, residual, 0.0)
            residual[good] /= sd[good, k]
            squares += np.add.reduceat(residual**2, edges[:-1])
            count += np.add.reduceat(good.astype(float), edges[:-1])
    if not np.isfinite(scatter).any():
        return None
    middle_s = 0.5 * (tracks.time_s[edges[:-1]] + tracks.time_s[edges[1:] - 1])
    with np.errstate(invalid="ignore"):
        return TrackingQuality(stated, scatter, middle_s, np.sqrt(squares / count))


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


def _bins(samples: int) -> IntArray:
    """First sample of each bin, and the number of samples."""
    return np.linspace(0, samples, min(BINS, max(samples // 20, 1)) + 1).astype(np.int64)
