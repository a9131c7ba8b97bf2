"""Camera noise, estimated from the recording: variance a + b I of a pixel of intensity I."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from tracker.arrays import FloatArray, GrayImage
from tracker.spread import robust_sd


@dataclass(frozen=True)
class Tuning:
    """Which pixels tell the noise of the camera."""

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
        down, across = np.gradient(ndimage.convolve(mean, np.ones((3, 3)), mode="nearest") / 9.0)
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
