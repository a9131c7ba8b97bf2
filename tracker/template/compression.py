"""The standard deviation of positions in lossily compressed footage, from the series itself."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from tracker.arrays import FloatArray, GrayImage
from tracker.register.marker import MarkerModel, reach_px

# Neighbours on each side that predict a sample.
NEIGHBOURS = 8
# In predictive codecs an error stays for some frames: there the neighbours that predict are at least so far away.
GAP_FRAMES = 8
# A picture that is compressed by itself errs by where its marker lies on the grid of blocks, which slow motion keeps
# for some frames: 3 frames find what was left out with MJPG of quality scale 5, to a tenth (scale 2: 2 %).
GAP_FRAMES_INTRA = 3
FAR_NEIGHBOURS = 6
# Residuals beyond so many sd are blows and jumps of the motion, not errors of the codec.
CLIP = 5.0
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
    The residual of a linear prediction of each sample from its neighbours on both sides: vibration of a few
    frequencies is predictable, errors from frame to frame are not. The same from neighbours at least three frames
    away, as errors stay while the marker lies the same way on the codec's blocks; the larger counts. For codecs that
    predict frames from others the neighbours are at least eight frames away, and with six markers or more the residual
    of the motion common to the markers (as few singular vectors as leave the smallest share) counts too, which sees
    errors that are slower still. All are biased towards too large a value where the true motion is rich. Errors that
    are slow and common to neighbouring markers are seen by none.
    """
    n, m = values.shape
    local = np.array([_near_sd(values[:, k]) for k in range(m)])
    gap = GAP_FRAMES if predictive else GAP_FRAMES_INTRA
    far = np.array([_far_sd(values[:, k], gap) for k in range(m)])
    both = np.asarray(np.fmax(local, far))
    if not predictive or m < LEAST_MARKERS or n < 4 * m:
        return both
    return np.asarray(np.fmax(both, _common_motion_sd(values)))


def _near_sd(series: FloatArray) -> float:
    """From the bulk of the residuals of prediction by the nearest neighbours."""
    residual, inflation = _prediction(series, first=1, count=NEIGHBOURS)
    return float(1.4826 * np.median(np.abs(residual)) / inflation) if residual.size else float("nan")


def _far_sd(series: FloatArray, gap: int) -> float:
    """From all but extreme residuals, as errors of these codecs are not normal: large after each key frame."""
    residual, inflation = _prediction(series, first=gap, count=FAR_NEIGHBOURS)
    if not residual.size:
        return float("nan")
    kept = residual[np.abs(residual) <= CLIP * 1.4826 * np.median(np.abs(residual))]
    freedom = residual.size / (residual.size - FAR_NEIGHBOURS)
    return float(np.sqrt(np.mean(kept**2) * freedom) / inflation) if kept.size else float("nan")


def _prediction(series: FloatArray, *, first: int, count: int) -> tuple[FloatArray, float]:
    """Residuals of predicting samples from `count` neighbours on each side, and what white errors of sd 1 give.

    The nearest of them are `first` samples away. Without residuals where the series is too short.
    """
    reach = first + count - 1
    nothing = np.empty(0), 1.0
    if series.size < 2 * reach + 6 * count:
        return nothing
    windows = np.lib.stride_tricks.sliding_window_view(series, 2 * reach + 1)
    lags = np.arange(first, reach + 1)
    # Symmetric neighbours share a coefficient: half the unknowns, and no phase.
    pairs, target = windows[:, reach - lags] + windows[:, reach + lags], windows[:, reach]
    whole = np.all(np.isfinite(pairs), axis=1) & np.isfinite(target)
    if np.count_nonzero(whole) < 6 * count:
        return nothing
    # The level is that of the neighbours alone: with the sample in it, it would predict itself.
    level = pairs[whole].sum(axis=1) / (2 * count)
    target, design = target[whole] - level, pairs[whole] - 2.0 * level[:, None]
    coefs, *_ = np.linalg.lstsq(design, target, rcond=None)
    # White errors reach the residual through the sample itself and through its neighbours.
    weights = coefs + (1.0 - 2.0 * coefs.sum()) / (2 * count)
    return target - design @ coefs, float(np.sqrt(1.0 + 2.0 * np.sum(weights**2)))


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


FRAMES = 24
# Blocks of the usual codecs are 8 px wide.
LARGEST_LAG_PX = 8
LARGEST_FACTOR = 6.0


def sd_factors(frames: list[GrayImage], model: MarkerModel) -> tuple[float, float]:
    """Factors on the sd of x and y that are due to the residuals' correlation in space.

    Notes
    -----
    The information matrix takes the pixels' errors as independent. With the autocorrelation rho(l) of the
    residuals and the autocorrelation c(l) of the picture's slope, the variance of a position is larger by
    sum_l rho(l) c(l) / c(0) (the sandwich estimator for stationary errors). A factor is at least 1 and at most 6.
    Errors that last over frames, as where H.264 lets a slow motion lag, are not in it.
    """
    seen = np.flatnonzero(np.all(np.isfinite(model.states), axis=1))
    if seen.size == 0:
        return 1.0, 1.0
    half = int(np.ceil(reach_px(model.template, model.warp)))
    totals = np.zeros((3, 2 * LARGEST_LAG_PX + 1, 2 * LARGEST_LAG_PX + 1))
    for k in seen[:: max(1, seen.size // FRAMES)]:
        pair = _residual_and_model(frames[k], model, model.states[k], half)
        if pair is None:
            continue
        residual, picture, inside = pair
        down, across = np.gradient(picture)
        residual = (residual - residual[inside].mean()) * inside
        totals += np.stack([_autocovariance(f) for f in (residual, across * inside, down * inside)])
    centre = LARGEST_LAG_PX
    if np.any(totals[:, centre, centre] <= 0.0):
        return 1.0, 1.0
    rho, across, down = (total / total[centre, centre] for total in totals)
    factors = [float(np.sqrt(max(np.sum(rho * slope), 1.0))) for slope in (across, down)]
    return min(factors[0], LARGEST_FACTOR), min(factors[1], LARGEST_FACTOR)


def _residual_and_model(
    image: GrayImage, model: MarkerModel, state: FloatArray, half: int
) -> tuple[FloatArray, FloatArray, FloatArray] | None:
    """Residual, modelled picture and support around a marker; None where the window leaves the picture."""
    column, row = round(float(state[0])), round(float(state[1]))
    height, width = image.shape
    if row - half < 0 or column - half < 0 or row + half >= height or column + half >= width:
        return None
    part = image[row - half : row + half + 1, column - half : column + half + 1].astype(np.float64)
    v, u = np.mgrid[-half : half + 1, -half : half + 1].astype(np.float64)
    offset = np.stack([u + column - state[0], v + row - state[1]])
    cosine, sine = np.cos(state[2]), np.sin(state[2])
    warp = np.array([[cosine, sine], [-sine, cosine]]) @ model.warp
    at = np.einsum("ij,jrc->irc", warp, offset) * model.template.oversampling
    rows, cols = model.template.coefs.shape
    where = [at[1] + 0.5 * (rows - 1), at[0] + 0.5 * (cols - 1)]
    picture = ndimage.map_coordinates(model.template.coefs, where, order=3, mode="nearest", prefilter=False)
    support = ndimage.map_coordinates(model.template.support, where, order=0, mode="constant") > 0
    if not support.any():
        return None
    modelled = state[3] * picture + state[4]
    return part - modelled, modelled, support


def _autocovariance(field: FloatArray) -> FloatArray:
    """Sum of products of a field with itself at all lags up to the largest."""
    lag = LARGEST_LAG_PX
    padded = np.pad(field, lag)
    spectrum = np.abs(np.fft.rfft2(padded)) ** 2
    full = np.fft.fftshift(np.fft.irfft2(spectrum, s=padded.shape))
    row, column = padded.shape[0] // 2, padded.shape[1] // 2
    return np.asarray(full[row - lag : row + lag + 1, column - lag : column + lag + 1])
