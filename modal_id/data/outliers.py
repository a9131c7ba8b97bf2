"""Outliers, detected in the residual of the fitted model and never by filtering the raw data."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from modal_id.data.samples import FitData
from tracker import BoolArray, FloatArray


@dataclass(frozen=True)
class Tuning:
    """Rejection of outliers."""

    #: [sd] deviation from which a sample is rejected
    #: statistics: One good sample in two million.
    limit: float = 5.0
    #: [1] share of a channel's samples that may be rejected wherever they lie
    few: float = 0.03
    #: [1] share that may be rejected where the samples are spread at random
    #: physics: The median absolute deviation itself is then a third too large.
    most: float = 0.25
    #: [samples] marked samples at the beginning from which they are misfit of the model
    least_misfit: int = 12
    #: [1] share of the marked samples that lie there
    mostly: float = 0.8
    #: [1] share of the record that counts as its beginning
    beginning: float = 0.1
    #: [sd] excess of marked samples there over chance
    #: statistics: Chance exceeds it in 3e-7 of records.
    excess_sd: float = 5.0


TUNING = Tuning()

_MAD_TO_SD = 1.4826


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
    limit = np.divide(TUNING.limit * _MAD_TO_SD * spread, root, out=root, where=known)
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
    if count <= TUNING.few * n:
        early = int(np.count_nonzero(bad[: int(TUNING.beginning * n)]))
        return count < TUNING.least_misfit or early < TUNING.mostly * count
    if count > TUNING.most * n:
        return False
    fraction = count / n
    neighbours = int(np.count_nonzero(bad[1:] & bad[:-1]))
    expected = n * fraction**2
    tenths = np.array([np.count_nonzero(part) for part in np.array_split(bad, 10)])
    spread = np.sqrt(0.1 * n * fraction * (1.0 - fraction))
    even = np.max(np.abs(tenths - 0.1 * count)) < TUNING.excess_sd * spread
    return bool(even and neighbours < expected + TUNING.excess_sd * np.sqrt(expected) + TUNING.excess_sd)
