"""Outliers, detected in the residual of the fitted model and never by filtering the raw data."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from modal_id.data.samples import FitData
from tracker import BoolArray, FloatArray

# In standard deviations estimated from the median absolute deviation: one good sample in two million is rejected.
_LIMIT = 5.0
_MAD_TO_SD = 1.4826
# Up to this share of a channel is rejected wherever it lies. A larger share, up to `_MOST`, only where the samples are
# spread at random over the record.
_FEW = 0.03
# The median absolute deviation itself is then a third too large.
_MOST = 0.25
# Marked samples are misfit of the model, not outliers, where at least this number has more than this share within this
# first part of the record.
_LEAST_MISFIT, _MOSTLY, _BEGINNING = 12, 0.8, 0.1
_EXCESS_SD = 5.0


def beyond_limit(weights: FloatArray, residual: FloatArray) -> BoolArray:
    """Samples more than five robust standard deviations from the model; shape (n, k), as weights and residual.

    The standard deviation of each channel is estimated from the median absolute residual; the weights are those before
    any rejection.
    """
    return np.asarray((weights > 0.0) & (np.abs(residual) > _limit(weights, residual)))


def limited(weights: FloatArray, residual: FloatArray) -> FloatArray:
    """The residual clipped at the limit of `beyond_limit`, to search for motion that a few large samples would hide."""
    limit = _limit(weights, residual)
    return np.clip(residual, -limit, limit)


def _limit(weights: FloatArray, residual: FloatArray) -> FloatArray:
    """Five robust standard deviations of each sample, shape (n, k); infinite where that is unknown."""
    root = np.sqrt(weights)
    used = weights > 0.0
    columns = zip(residual.T, root.T, used.T, strict=True)
    spread = np.array([np.median(np.abs(r[u]) * s[u]) if np.any(u) else 0.0 for r, s, u in columns])
    known = used & (spread > 0.0)
    limit = np.divide(_LIMIT * _MAD_TO_SD * spread, root, out=root, where=known)
    limit[~known] = np.inf
    return np.asarray(limit)


def reject_outliers(data: FitData, original_weights: FloatArray, residual: FloatArray) -> FitData:
    """The data with outliers at weight 0.

    A median filter on raw data would clip the peaks of the vibration; the residual has no such peaks. Many large
    residuals in one stretch are motion that is not (yet) modelled, not outliers, and are kept. `original_weights` are
    those before any rejection: a sample rejected earlier may be used again.
    """
    weights = original_weights.copy()
    bad = beyond_limit(original_weights, residual)
    for channel in range(weights.shape[1]):
        if _are_scattered(bad[original_weights[:, channel] > 0.0, channel]):
            weights[bad[:, channel], channel] = 0.0
    return replace(data, weights=weights)


def _are_scattered(bad: BoolArray) -> bool:
    """Whether the marked samples are few, or no more clustered than random ones.

    A dozen or more that lie almost all in the beginning, where a decay is largest, are motion that the model lacks.
    """
    n, count = bad.size, int(np.count_nonzero(bad))
    if count <= _FEW * n:
        early = int(np.count_nonzero(bad[: int(_BEGINNING * n)]))
        return count < _LEAST_MISFIT or early < _MOSTLY * count
    if count > _MOST * n:
        return False
    fraction = count / n
    neighbours = int(np.count_nonzero(bad[1:] & bad[:-1]))
    expected = n * fraction**2
    tenths = np.array([np.count_nonzero(part) for part in np.array_split(bad, 10)])
    spread = np.sqrt(0.1 * n * fraction * (1.0 - fraction))
    even = np.max(np.abs(tenths - 0.1 * count)) < _EXCESS_SD * spread
    return bool(even and neighbours < expected + _EXCESS_SD * np.sqrt(expected) + _EXCESS_SD)
