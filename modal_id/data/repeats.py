"""Rows that repeat the row before them: frozen or duplicated frames, exact or as a video codec reproduces them."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import maximum_filter1d

from modal_id.data.samples import runs
from tracker import BoolArray, FloatArray

# A repetition differs from the row before by less than these shares of a typical step and of a typical second
# difference, which is that of the noise where the motion is slow.
_SMALL = 0.2
_SMALL_BEND = 0.15
# Nor is it a repetition where steps exceed this share of the noise of a sample: at rest, all steps are noise.
_SMALL_NOISE = 0.3
_ORDER = 8
# Samples predicted, evenly spread, which determine the noise to within 1 %.
_MOST_WINDOWS = 50_000
# Rows on either side with which a repetition is compared: motion and noise change during a decay.
_AROUND = 100
# Probability that a Gaussian step is smaller than a share of the median step, relative to that share.
_BELOW_MEDIAN = 0.6
# Probability, over all places of the record, that motion and noise look like the repetition by chance.
_FALSE_ALARM = 1e-3
# Resolution as a share of a typical step above which samples are often equal, and below which no two ever are.
_COARSE = 0.01
_FINE = 1e-4
# A motion stalls where its steps are below this share of the largest among the rows on either side, and goes on in the
# same direction. White noise does so in a quarter of this share of its rows.
_STALLED = 0.05
_NEARBY = 9
_STALLED_SHARE = 0.2


def repeated_rows(values: FloatArray) -> BoolArray:
    """Mask of the rows that repeat the one before them in every channel; shape (n,).

    Steps and second differences within a run of such rows are compared with those around it. At a turning point of slow
    motion the second differences are as large as anywhere, so that it is no repetition. Where the motion stalls in many
    rows, these are repetitions, too. Samples of a coarse converter are often equal: where its resolution is not much
    finer than the steps, nothing is a repetition. Nor is anything where no three successive rows of a channel have a
    value.

    Parameters
    ----------
    values : array, shape (n, k)
        NaN where missing: a row with a missing value neither repeats nor is repeated.
    """
    n = values.shape[0]
    repeated = np.zeros(n, dtype=bool)
    steps, bends = np.abs(np.diff(values, axis=0)), np.abs(np.diff(values, 2, axis=0))
    finite = np.all(np.isfinite(steps), axis=1)
    if np.count_nonzero(finite) < 8 or not np.all(np.any(np.isfinite(bends), axis=0)):
        return repeated
    typical = _typical(steps[finite])
    small = np.minimum(_SMALL_BEND * np.nanmedian(bends, axis=0), _SMALL_NOISE * _noise(values))
    least = np.minimum(_SMALL, small / np.maximum(typical, 1e-300))
    resolution = _resolution(values)
    if np.any(typical <= 0.0) or np.any(resolution > _COARSE * typical):
        return repeated
    # A row without a value is no repetition.
    step = np.max(np.where(finite[:, None], steps, np.inf) / typical, axis=1)
    bend = np.max(np.where(np.isfinite(bends), bends, np.inf) / typical, axis=1)
    if np.all(resolution < _FINE * typical):
        repeated[1:] = step == 0.0
    for start, end in runs(step < np.min(least)):
        # Rows start + 1 to end repeat row start.
        places = 1.0 if end == step.size else float(n)
        if (end - start) * np.log(2.0 * _AROUND + 1.0) < np.log(places / _FALSE_ALARM):
            # Too few to be significant whatever their size.
            continue
        around = np.r_[max(start - _AROUND, 0) : start, end : min(end + _AROUND, step.size)]
        log_p = _log_chance(step[start:end], step[around])
        if end - start > 1:
            around = around[around < bend.size]
            log_p = max(log_p, _log_chance(bend[start : end - 1], bend[around]))
        if log_p < np.log(_FALSE_ALARM / places):
            repeated[start + 1 : end + 1] = True
    stalls = _stalls(np.diff(values, axis=0) / typical)
    return repeated | stalls if np.mean(stalls) > _STALLED_SHARE else repeated


def _typical(steps: FloatArray) -> FloatArray:
    """Median step of each channel, without repetitions, which may be most rows; shape (k,)."""
    moving = np.where(steps > _STALLED * np.sqrt(np.mean(steps**2, axis=0)), steps, np.nan)
    if not np.all(np.any(steps > 0.0, axis=0)):
        return np.zeros(steps.shape[1])
    return np.asarray(np.nanmedian(moving, axis=0))


def _stalls(steps: FloatArray) -> BoolArray:
    """Mask of the rows at which the motion stalls, shape (n,): a display or a camera holds each image for several rows.

    No smooth motion stops for a few rows and goes on in the same direction; at a turning point it reverses.
    """
    stalled = np.zeros(steps.shape[0] + 1, dtype=bool)
    size = np.max(np.where(np.isfinite(steps), np.abs(steps), np.inf), axis=1)
    largest = maximum_filter1d(np.where(np.isfinite(size), size, 0.0), 2 * _NEARBY + 1)
    for start, end in runs(size < _STALLED * largest):
        if start > 0 and end < size.size and float(steps[start - 1] @ steps[end]) > 0.0:
            stalled[start + 1 : end + 1] = True
    return stalled


def _noise(values: FloatArray) -> FloatArray:
    """Standard deviation of the noise of each channel, by linear prediction; at least that of the samples at rest.

    Without a known frequency, prediction from the preceding samples separates noise from motion at any number of
    samples a cycle.
    """
    result = np.full(values.shape[1], np.inf)
    for channel, column in enumerate(values.T):
        windows = np.lib.stride_tricks.sliding_window_view(column, _ORDER + 1)
        windows = windows[:: 1 + windows.shape[0] // _MOST_WINDOWS]
        windows = windows[np.all(np.isfinite(windows), axis=1)]
        for _ in range(8):
            if windows.shape[0] <= 4 * _ORDER:
                break
            gram = windows.T @ windows
            past = gram[:-1, :-1]
            ridge = 1e-12 * np.trace(past) + 1e-300
            weights = np.linalg.solve(past + ridge * np.eye(_ORDER), gram[:-1, -1])
            error = windows[:, -1] - windows[:, :-1] @ weights
            spread = 1.4826 * float(np.median(np.abs(error)))
            result[channel] = spread / np.sqrt(1.0 + weights @ weights)
            near = np.abs(error) <= 4.0 * spread
            if np.all(near):
                break
            windows = windows[near]
    return result


def _log_chance(values: FloatArray, around: FloatArray) -> float:
    """Logarithm of the probability that values as small as these occur, judged by those around them."""
    around = around[np.isfinite(around)]
    if around.size < 8:
        return 0.0
    rank = (1.0 + np.searchsorted(np.sort(around), values, side="right")) / (around.size + 1.0)
    share = _BELOW_MEDIAN * values / max(float(np.median(around)), 1e-300)
    return float(np.sum(np.log(np.minimum(np.maximum(rank, share), 1.0))))


def _resolution(values: FloatArray) -> FloatArray:
    """Smallest difference between two different values of each channel, relative differences below 1e-9 ignored."""
    smallest = np.full(values.shape[1], np.inf)
    for channel, column in enumerate(values.T):
        apart = np.diff(np.unique(column[np.isfinite(column)]))
        apart = apart[apart > 1e-9 * np.nanmax(np.abs(column))]
        # The median of the smallest hundredth: two independent values may be close by chance.
        smallest[channel] = np.median(np.sort(apart)[: max(apart.size // 100, 1)]) if apart.size else np.inf
    return smallest
