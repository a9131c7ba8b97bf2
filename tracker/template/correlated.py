"""How much compression's errors, which neighbouring pixels share, enlarge the sd of positions."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from tracker.arrays import FloatArray, GrayImage
from tracker.register.marker import MarkerModel, reach_px

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
