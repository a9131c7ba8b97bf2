"""Samples that the model cannot have made: by its own residual, never by a filter on the raw data."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from modal_id.linear import FitData

FloatArray = NDArray[np.float64]

# In standard deviations estimated from the median absolute deviation: one good sample in two million goes.
_LIMIT = 5.0
_MAD_TO_SD = 1.4826
# More than this is no handful of outliers but a residual with heavy tails or an unmodelled part.
_MOST = 0.03


def reject_outliers(data: FitData, original_weights: FloatArray, residual: FloatArray) -> FitData:
    """The data with outlying samples at weight 0.

    A median filter on raw data would clip the peaks of the vibration; the residual has no peaks.

    Parameters
    ----------
    data : FitData
    original_weights : array, shape (n, k)
        Before any rejection: a sample rejected earlier may come back.
    residual : array, shape (n, k)
    """
    scaled = np.abs(residual) * np.sqrt(original_weights)
    weights = original_weights.copy()
    for channel in range(scaled.shape[1]):
        used = original_weights[:, channel] > 0.0
        if not np.any(used):
            continue
        spread = _MAD_TO_SD * float(np.median(scaled[used, channel]))
        bad = used & (scaled[:, channel] > _LIMIT * spread)
        if spread > 0.0 and np.count_nonzero(bad) <= _MOST * np.count_nonzero(used):
            weights[bad, channel] = 0.0
    return replace(data, weights=weights)
