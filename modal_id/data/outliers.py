"""Samples that the model cannot have made: by its own residual, never by a filter on the raw data."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from modal_id.fit.linear import FitData
from tracker.arrays import FloatArray

# In standard deviations estimated from the median absolute deviation: one good sample in two million goes.
_LIMIT = 5.0
_MAD_TO_SD = 1.4826
# So few may lie anywhere. More are outliers only when they are strewn over the record like chance hits ...
_FEW = 0.03
# ... and at most these: the median absolute deviation itself is then a third too large.
_MOST = 0.25
_EXCESS_SD = 5.0


def beyond_limit(data: FitData, weights: FloatArray, residual: FloatArray) -> NDArray[np.bool_]:
    """Samples more than five standard deviations from the model, the deviation from the channel's median; shape (n, k).

    Parameters
    ----------
    data : FitData
    weights : array, shape (n, k)
        Of the samples before any rejection.
    residual : array, shape (n, k)
    """
    scaled = np.abs(residual) * np.sqrt(weights)
    bad = np.zeros(data.values.shape, dtype=bool)
    for channel in range(scaled.shape[1]):
        used = weights[:, channel] > 0.0
        spread = _MAD_TO_SD * float(np.median(scaled[used, channel])) if np.any(used) else 0.0
        if spread > 0.0:
            bad[:, channel] = used & (scaled[:, channel] > _LIMIT * spread)
    return bad


def reject_outliers(data: FitData, original_weights: FloatArray, residual: FloatArray) -> FitData:
    """The data with outlying samples at weight 0.

    A median filter on raw data would clip the peaks of the vibration; the residual has no peaks. Many large residuals
    in one stretch are motion that is not modelled (yet), not outliers: they stay.

    Parameters
    ----------
    data : FitData
    original_weights : array, shape (n, k)
        Before any rejection: a sample rejected earlier may come back.
    residual : array, shape (n, k)
    """
    weights = original_weights.copy()
    bad = beyond_limit(data, original_weights, residual)
    for channel in range(weights.shape[1]):
        if _chance_hits(bad[original_weights[:, channel] > 0.0, channel]):
            weights[bad[:, channel], channel] = 0.0
    return replace(data, weights=weights)


def _chance_hits(bad: NDArray[np.bool_]) -> bool:
    """Whether the marked samples are few, or no more often neighbours, or in one half, than chance makes them."""
    n, count = bad.size, int(np.count_nonzero(bad))
    if count <= _FEW * n:
        return True
    if count > _MOST * n:
        return False
    fraction = count / n
    neighbours = int(np.count_nonzero(bad[1:] & bad[:-1]))
    expected = n * fraction**2
    tenths = np.array([np.count_nonzero(part) for part in np.array_split(bad, 10)])
    spread = np.sqrt(0.1 * n * fraction * (1.0 - fraction))
    even = np.max(np.abs(tenths - 0.1 * count)) < _EXCESS_SD * spread
    return bool(even and neighbours < expected + _EXCESS_SD * np.sqrt(expected) + _EXCESS_SD)
