"""The standard deviation of positions in lossily compressed footage, from the series itself."""

from __future__ import annotations

import numpy as np

from tracker.series import FloatArray

# Neighbours on each side that predict a sample.
NEIGHBOURS = 8
# A beam that swings in one mode and is disturbed by another moves in two shapes, or one with a phase; what
# fewer markers have beyond that says little.
LEAST_MARKERS = 6


def series_sd(values: FloatArray, *, predictive: bool) -> FloatArray:
    """Standard deviation of each column's errors as the series shows them.

    Parameters
    ----------
    values : array, shape (n, m)
        One coordinate of m markers; NaN where missing.
    predictive : bool
        Whether the codec predicts frames from others, which makes its errors slow.

    Returns
    -------
    array, shape (m,)
        NaN where a series is too short.

    Notes
    -----
    For codecs that predict, the larger of two estimates. One is the residual of a linear prediction of each
    sample from its neighbours on both sides: vibration of a few frequencies is predictable, errors from frame to
    frame are not. The other, with six markers or more, is the residual of the motion common to the markers (as few
    singular vectors as leave the smallest share): it sees errors that are slow, as those of motion-compensated
    codecs are. Both are biased towards too large a value where the true motion is rich. Errors that are slow and
    common to neighbouring markers are seen by neither.
    """
    n, m = values.shape
    local = np.array([_prediction_sd(values[:, k]) for k in range(m)])
    if not predictive or m < LEAST_MARKERS or n < 4 * m:
        return local
    return np.asarray(np.fmax(local, _common_motion_sd(values)))


def _prediction_sd(series: FloatArray) -> float:
    p = NEIGHBOURS
    if series.size < 8 * p:
        return float("nan")
    windows = np.lib.stride_tricks.sliding_window_view(series, 2 * p + 1)
    windows = windows[np.all(np.isfinite(windows), axis=1)]
    if windows.shape[0] < 6 * p:
        return float("nan")
    # The level is that of the neighbours alone: with the sample in it, it would predict itself.
    level = (windows.sum(axis=1, keepdims=True) - windows[:, p : p + 1]) / (2 * p)
    windows = windows - level
    target = windows[:, p]
    # Symmetric neighbours share a coefficient: half the unknowns, and no phase.
    design = windows[:, :p][:, ::-1] + windows[:, p + 1 :]
    coefs, *_ = np.linalg.lstsq(design, target, rcond=None)
    residual = target - design @ coefs
    # White errors reach the residual through the sample itself and through its neighbours.
    weights = coefs + (1.0 - 2.0 * coefs.sum()) / (2 * p)
    inflation = 1.0 + 2.0 * float(np.sum(weights**2))
    return float(1.4826 * np.median(np.abs(residual)) / np.sqrt(inflation))


def _common_motion_sd(values: FloatArray) -> FloatArray:
    m = values.shape[1]
    whole = values[np.all(np.isfinite(values), axis=1)]
    if whole.shape[0] < 4 * m:
        return np.full(m, np.nan)
    centred = whole - np.median(whole, axis=0)
    left, singular, right = np.linalg.svd(centred, full_matrices=False)
    rank = max(2, m // 3)
    rest = centred - (left[:, :rank] * singular[:rank]) @ right[:rank]
    # Each marker lost its share of the rank to the common motion.
    kept = np.maximum(1.0 - np.sum(right[:rank] ** 2, axis=0), 0.2)
    return np.asarray(np.sqrt(np.mean(rest**2, axis=0) / kept))
