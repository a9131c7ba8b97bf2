"""Noise of the pixels, variance a + b I at the intensity I, and errors of positions in lossily compressed footage.

Both are estimated from the recording: the latter by the correlation of the residuals in space, and of the errors over
time.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
import scipy  # its parts are loaded when they are used
from numpy.typing import NDArray

from tracker.arrays import MAD_TO_SD, BoolArray, FloatArray, GrayImage, robust_sd
from tracker.template.spline import Template


@dataclass(frozen=True)
class Tuning:
    """Which pixels tell the noise of the camera; how far errors of compression reach in the image and in time."""

    #: [1] intervals of brightness in which the variance is estimated
    bins: int = 16
    #: [pixels] without which an interval is not used
    #: statistics: they determine a standard deviation to 6 %
    least_in_bin: int = 150
    #: [frames] pairs of neighbouring frames whose differences are used
    #: convention: limits time
    most_pairs: int = 16
    #: [pixels] of all pairs together, approximately
    #: convention: limits time
    most_pixels: int = 400_000
    #: [1] share of the pixels with the smallest gradients, which are used
    #: convention: motion adds to the differences where the image has gradients
    smooth_share: float = 0.7
    #: [sd] beyond which differences are motion
    #: statistics: for normal errors one pixel of 370 is lost, and the variance is corrected for it
    clip: float = 3.0
    #: [pixels] without which the noise is unknown: one gray level
    least_pixels: int = 64
    #: [1] variances above this multiple of the line are excluded
    #: convention: there, motion or a wrong model has added to the noise
    outlier: float = 1.4
    #: [gray levels^2] with which clipping begins, at least
    #: convention: differences of rounded pixels can all be 0
    least_variance: float = 0.25
    #: [frames] of a marker, or of a line in compressed footage, whose residuals are used
    #: convention: limits time
    residual_frames: int = 24
    #: [px] up to which the residuals' correlation is summed
    #: physics: blocks of common codecs are 8 px wide
    largest_lag_px: int = 8
    #: [1] limit of the factor on the sd
    largest_factor: float = 6.0
    #: [frames] on each side from which a sample is predicted
    #: convention: they predict a sum of eight vibrations
    neighbours: int = 8
    #: [frames] distance of the predicting neighbours in predictive codecs
    #: convention: there an error persists for some frames
    gap_frames: int = 8
    #: [frames] the same where each frame is compressed alone
    #: measurement: the error depends on the place on the grid of blocks, which changes slowly in slow motion: 3 frames
    #: recover what is missing for MJPG of quality scale 5 to a tenth (scale 2: 2 %)
    gap_frames_intra: int = 3
    #: [frames] on each side at that distance
    far_neighbours: int = 6
    #: [sd] residuals beyond it are impacts and jumps of the motion, not errors of the codec
    #: statistics: normal errors do so once in two million samples
    impact: float = 5.0
    #: [markers] from which the motion that is common to them is left out
    #: physics: a beam that vibrates in one mode and is disturbed by another moves in two shapes, or one with a phase;
    #: what fewer markers show beyond that carries little information
    least_markers: int = 6
    #: [frames] of a part of a series, at least
    #: measurement: the length of the films by which the errors of predicted frames were determined
    #: (docs/studies/films.md)
    part_frames: int = 1500
    #: [1] least share of a marker's variance that is not common motion
    least_kept: float = 0.2


TUNING = Tuning()

# Variance of a normal distribution cut off at three standard deviations.
CLIPPED_SHARE = 0.9733
# Variance of rounding to whole gray levels.
ROUNDING_VARIANCE = 1.0 / 12.0


@dataclass(frozen=True)
class NoiseModel:
    """Variance of a pixel: ``read_variance`` + ``gain`` * intensity, in gray levels squared."""

    read_variance: float
    gain: float

    def as_array(self) -> FloatArray:
        """Both parameters for compiled code."""
        return np.array([self.read_variance, self.gain])


def estimate_noise(frames: list[GrayImage], *, white_level: float) -> NoiseModel:
    """Noise from differences of neighbouring frames, where the image is smooth.

    Motion adds to the differences where the image has gradients, so the steepest 30 % of the pixels are excluded and
    the rest is clipped at 3 standard deviations (corrected for the clipping). A single frame is differenced twice in
    space, which treats fine texture as noise: the estimate is then biased high. Pixels at the white level are excluded:
    their noise is clipped.
    """
    if len(frames) < 2:
        return _from_one(frames[0].astype(np.float64), white_level)
    pairs = list(zip(frames[:-1:2], frames[1::2], strict=False))[: TUNING.most_pairs]
    stride = max(1, int(np.sqrt(frames[0].size * len(pairs) / TUNING.most_pixels)))
    levels, squares = [], []
    for before, after in pairs:
        one, two = before.astype(np.float64), after.astype(np.float64)
        mean = 0.5 * (one + two)
        down, across = np.gradient(scipy.ndimage.convolve(mean, np.ones((3, 3)), mode="nearest") / 9.0)
        slope = np.hypot(down, across)
        keep = np.zeros(mean.shape, dtype=bool)
        keep[::stride, ::stride] = True
        keep &= (np.maximum(one, two) < white_level) & (
            slope <= np.quantile(slope[keep], TUNING.smooth_share)
        )
        levels.append(mean[keep])
        squares.append(two[keep] - one[keep])
    return _fit(np.concatenate(levels), np.concatenate(squares) / np.sqrt(2.0))


def _from_one(image: FloatArray, white_level: float) -> NoiseModel:
    if min(image.shape) < 3:
        return NoiseModel(1.0, 0.0)
    across = image[:, 1:-1] - 0.5 * (image[:, :-2] + image[:, 2:])
    second = across[1:-1] - 0.5 * (across[:-2] + across[2:])
    # The mask (-1/2, 1, -1/2) in both directions has the squared norm 9/4.
    level = image[1:-1, 1:-1]
    keep = level < white_level
    return _fit(level[keep], second[keep] / 1.5)


def _clipped_variance(values: FloatArray) -> float:
    """Variance about zero of the bulk of `values`, clipped at 3 sd and corrected for it."""
    variance = max(robust_sd(values) ** 2, TUNING.least_variance)
    for _ in range(8):
        inside = values[np.abs(values) < TUNING.clip * np.sqrt(variance)]
        if inside.size < 16:
            break
        updated = max(float(np.mean(inside**2)) / CLIPPED_SHARE, 1e-6)
        if abs(updated - variance) < 1e-3 * variance:
            return updated
        variance = updated
    return variance


def _fit(level: FloatArray, deviation: FloatArray) -> NoiseModel:
    """Noise model from the variances of bins of intensity."""
    if level.size < TUNING.least_pixels:
        return NoiseModel(1.0, 0.0)
    # Bins of equal width: with bins of equal count the background would fill all of them.
    index = np.minimum(
        (level - level.min()) / max(np.ptp(level), 1e-9) * TUNING.bins, TUNING.bins - 1
    ).astype(np.int64)
    kept = [k for k in range(TUNING.bins) if np.count_nonzero(index == k) >= TUNING.least_in_bin]
    if not kept:
        return NoiseModel(max(_clipped_variance(deviation), ROUNDING_VARIANCE), 0.0)
    return fit_line(
        np.array([float(level[index == k].mean()) for k in kept]),
        np.array([_clipped_variance(deviation[index == k]) for k in kept]),
        np.array([np.count_nonzero(index == k) for k in kept]),
    )


def fit_line(level: FloatArray, variance: FloatArray, count: FloatArray | NDArray[np.int64]) -> NoiseModel:
    """Noise model from variances at given intensities and the number of pixels of each.

    Variances far above the line are excluded: there, motion or a wrong model has added to the noise.
    """
    x, y = level, np.maximum(variance, ROUNDING_VARIANCE)
    weight = np.sqrt(count) / y
    a, b = _line(x, y, weight)
    for _ in range(3):
        weight = np.where(y > TUNING.outlier * (a + b * x), 0.0, weight)
        if np.count_nonzero(weight) == 0:
            break
        a, b = _line(x, y, weight)
    return NoiseModel(a, b)


def _line(x: FloatArray, y: FloatArray, weight: FloatArray) -> tuple[float, float]:
    """Weighted line with physical coefficients: a at least the variance of rounding, b not negative."""
    used = weight > 0
    x, y, weight = x[used], y[used], weight[used]
    if x.size < 2 or np.ptp(x) < 1e-6:
        return float(np.average(y, weights=weight**2)), 0.0
    design = np.stack([np.ones_like(x), x], axis=1) * weight[:, None]
    (a, b), *_ = np.linalg.lstsq(design, y * weight, rcond=None)
    if b < 0.0:
        return float(np.average(y, weights=weight**2)), 0.0
    if a < ROUNDING_VARIANCE:
        share = float(np.sum(weight**2 * x * (y - ROUNDING_VARIANCE)) / np.sum(weight**2 * x * x))
        return ROUNDING_VARIANCE, max(share, 0.0)
    return float(a), float(b)


# Samples at a time.
_BLOCK = 65_536


def sd_factors(
    frames: list[GrayImage], states: FloatArray, template: Template, warp: FloatArray
) -> tuple[float, float]:
    """Factors on the sd of x and y due to the spatial correlation of the residuals of one marker, 1 to 6.

    They do not include errors that persist over frames, such as the lag of slow motion in H.264.
    """
    seen = np.flatnonzero(np.all(np.isfinite(states), axis=1))
    half = int(np.ceil(template.image_reach_px(warp)))

    def windows() -> Iterator[tuple[FloatArray, ...]]:
        for k in seen[:: max(1, seen.size // TUNING.residual_frames)]:
            parts = _residual_and_model(frames[k], states[k], template, warp, half)
            if parts is not None:
                residual, image, inside = parts
                down, across = np.gradient(image)
                yield (residual - residual[inside].mean()) * inside, across * inside, down * inside

    along_x, along_y = correlation_factors(windows(), 2)
    return along_x, along_y


def correlation_factors(windows: Iterable[tuple[FloatArray, ...]], gradients: int) -> tuple[float, ...]:
    """Factors on standard deviations that assume independent errors of pixels; 1 where nothing is known.

    Parameters
    ----------
    windows : iterable of tuple of array
        The residual of each window and the `gradients` of its image, one for each factor; 0 where nothing belongs to
        the marker.

    Notes
    -----
    With the autocorrelation rho(l) of the residuals and the autocorrelation c(l) of an image gradient, the variance of
    a position is larger by sum_l rho(l) c(l) / c(0) (the sandwich estimator for stationary errors).
    """
    lag = TUNING.largest_lag_px
    totals = np.zeros((1 + gradients, 2 * lag + 1, 2 * lag + 1))
    for window in windows:
        totals += np.stack([_autocovariance(field) for field in window])
    if np.any(totals[:, lag, lag] <= 0.0):
        return (1.0,) * gradients
    rho, *slopes = (total / total[lag, lag] for total in totals)
    return tuple(
        min(float(np.sqrt(max(np.sum(rho * slope), 1.0))), TUNING.largest_factor) for slope in slopes
    )


def _residual_and_model(
    image: GrayImage, state: FloatArray, template: Template, warp: FloatArray, half: int
) -> tuple[FloatArray, FloatArray, BoolArray] | None:
    """Residual, modelled image and support around a marker; None where the window exceeds the frame."""
    column, row = round(float(state[0])), round(float(state[1]))
    height, width = image.shape
    if row - half < 0 or column - half < 0 or row + half >= height or column + half >= width:
        return None
    part = image[row - half : row + half + 1, column - half : column + half + 1].astype(np.float64)
    v, u = np.mgrid[-half : half + 1, -half : half + 1].astype(np.float64)
    offset = np.stack([u + column - state[0], v + row - state[1]])
    cosine, sine = np.cos(state[2]), np.sin(state[2])
    turned = np.array([[cosine, sine], [-sine, cosine]]) @ warp
    values, support = template.sampled(np.einsum("ij,jrc->irc", turned, offset))
    if not support.any():
        return None
    modelled = state[3] * values + state[4]
    return part - modelled, modelled, support


def _autocovariance(field: FloatArray) -> FloatArray:
    """Sum of products of a field with itself at all lags up to the largest."""
    lag = TUNING.largest_lag_px
    padded = np.pad(field, lag)
    spectrum = np.abs(np.fft.rfft2(padded)) ** 2
    full = np.fft.fftshift(np.fft.irfft2(spectrum, s=padded.shape))
    row, column = padded.shape[0] // 2, padded.shape[1] // 2
    return np.asarray(full[row - lag : row + lag + 1, column - lag : column + lag + 1])


def series_sd(values: FloatArray, *, predictive: bool) -> FloatArray:
    """Standard deviation of the errors of m markers, shape (m,), estimated from the series; NaN where too short.

    Parameters
    ----------
    values : array, shape (n, m)
        One coordinate; NaN where missing.
    predictive : bool
        Whether the codec predicts frames from others, which makes its errors slow.

    Notes
    -----
    The residual of a linear prediction of each sample from its neighbours on both sides: vibration of a few
    frequencies is predictable, errors from frame to frame are not. A second prediction uses neighbours at least three
    frames away, since errors persist while the marker keeps its place on the codec's blocks; the larger residual
    counts. For predictive codecs these neighbours are at least eight frames away, and with six or more markers the
    residual of the motion common to the markers (a third of the singular vectors, at least two) also counts, which
    includes still slower errors. All are biased high where the true motion is rich. Errors that are slow and common to
    neighbouring markers are not detected.
    """
    n, m = values.shape
    gap = TUNING.gap_frames if predictive else TUNING.gap_frames_intra
    both = np.array([np.fmax(_near_sd(series), _far_sd(series, gap)) for series in values.T])
    if not predictive or m < TUNING.least_markers or n < 4 * m:
        return both
    return np.asarray(np.fmax(both, _common_motion_sd(values)))


def largest_sd(values: FloatArray) -> FloatArray:
    """Largest of the standard deviations of `series_sd` over parts of a series from a predictive codec, shape (m,).

    At rest, encoders repeat pixels: errors over a record that is mostly at rest are half as large as where it moves.
    """
    parts = np.array_split(values, max(1, len(values) // TUNING.part_frames))
    return np.asarray(np.fmax.reduce([series_sd(part, predictive=True) for part in parts], axis=0))


def _near_sd(series: FloatArray) -> float:
    """From the bulk of the residuals of prediction by the nearest neighbours."""
    residual, inflation = prediction(series, first=1, count=TUNING.neighbours)
    residual = residual[np.isfinite(residual)]
    return robust_sd(residual) / inflation if residual.size else float("nan")


def _far_sd(series: FloatArray, gap: int) -> float:
    """From all but extreme residuals: codec errors are not normal, and large after each key frame."""
    residual, inflation = prediction(series, first=gap, count=TUNING.far_neighbours)
    residual = residual[np.isfinite(residual)]
    if not residual.size:
        return float("nan")
    kept = residual[np.abs(residual) <= TUNING.impact * MAD_TO_SD * np.median(np.abs(residual))]
    dof_ratio = residual.size / (residual.size - TUNING.far_neighbours)
    return float(np.sqrt(np.mean(kept**2) * dof_ratio) / inflation) if kept.size else float("nan")


def prediction(series: FloatArray, *, first: int, count: int) -> tuple[FloatArray, float]:
    """Residuals of predicting samples from `count` neighbours on each side, and their sd for white errors of sd 1.

    The nearest neighbours are `first` samples away. The residuals, shape (n,), are NaN where a neighbour is missing, as
    at both ends, and everywhere in a series that is too short.
    """
    reach = first + count - 1
    residual = np.full(series.size, np.nan)
    if series.size < 2 * reach + 6 * count:
        return residual, 1.0
    windows = np.lib.stride_tricks.sliding_window_view(series, 2 * reach + 1)
    lags = np.arange(first, reach + 1)
    blocks = [slice(begin, begin + _BLOCK) for begin in range(0, len(windows), _BLOCK)]
    # The triangular factor of all rows has their least squares: together they would be the largest array of a film.
    triangle, used = np.empty((0, count + 1)), 0
    for rows in blocks:
        part = np.column_stack(_from_level(windows[rows], reach, lags)[:2])
        triangle = np.asarray(np.linalg.qr(np.vstack([triangle, part]), mode="r"))
        used += len(part)
    if used < 6 * count:
        return residual, 1.0
    accuracy = used * np.finfo(float).eps
    coefs = np.linalg.lstsq(triangle[:, :count], triangle[:, count], rcond=accuracy)[0]
    # White errors enter the residual through the sample itself and through its neighbours.
    weights = coefs + (1.0 - 2.0 * coefs.sum()) / (2 * count)
    inner = residual[reach : series.size - reach]
    for rows in blocks:
        pairs, target, complete = _from_level(windows[rows], reach, lags)
        inner[rows][complete] = target - pairs @ coefs
    return residual, float(np.sqrt(1.0 + 2.0 * np.sum(weights**2)))


def _from_level(
    windows: FloatArray, reach: int, lags: NDArray[np.intp]
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Sums of the pairs of neighbours, and the samples between them, from the neighbours' level; of complete windows.

    With the mask of these windows.
    """
    # Symmetric neighbours share a coefficient: half the unknowns, and no phase.
    pairs, target = windows[:, reach - lags] + windows[:, reach + lags], windows[:, reach]
    complete = np.all(np.isfinite(pairs), axis=1) & np.isfinite(target)
    pairs = pairs[complete]
    # The level is that of the neighbours alone: including the sample, it would predict itself.
    level = pairs.sum(axis=1) / (2 * lags.size)
    return pairs - 2.0 * level[:, None], target[complete] - level, complete


def _common_motion_sd(values: FloatArray) -> FloatArray:
    m = values.shape[1]
    complete = values[np.all(np.isfinite(values), axis=1)]
    if complete.shape[0] < 4 * m:
        return np.full(m, np.nan)
    centred = complete - np.median(complete, axis=0)
    left, singular, right = np.linalg.svd(centred, full_matrices=False)
    rank = max(2, m // 3)
    rest = centred - (left[:, :rank] * singular[:rank]) @ right[:rank]
    # Each marker lost its share of the rank to the common motion.
    kept = np.maximum(1.0 - np.sum(right[:rank] ** 2, axis=0), TUNING.least_kept)
    return np.asarray(np.sqrt(np.mean(rest**2, axis=0) / kept))
