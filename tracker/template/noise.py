"""Noise of the camera, estimated from the recording: variance a + b I of a pixel of intensity I."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tracker.arrays import FloatArray, GrayImage

# Rounding to whole gray levels alone has this variance.
ROUNDING_VARIANCE = 1.0 / 12.0
BINS = 16
LEAST_IN_BIN = 150


@dataclass(frozen=True)
class NoiseModel:
    """Variance of a pixel: ``read_variance`` + ``gain`` * intensity, in gray levels squared."""

    read_variance: float
    gain: float

    def as_array(self) -> FloatArray:
        """The two numbers as the kernel takes them."""
        return np.array([self.read_variance, self.gain])

    def scaled(self, factor: float) -> NoiseModel:
        """The model with all variances multiplied."""
        return NoiseModel(self.read_variance * factor, self.gain * factor)


def estimate_noise(frames: list[GrayImage], *, white_level: float) -> NoiseModel:
    """Noise from differences of neighbouring frames, where the picture is smooth.

    Motion adds to the differences where the picture has slopes, so the steeper half of the pixels of each
    intensity is left out and what remains is clipped at 3 standard deviations (corrected for the clipping).
    With one frame alone a second difference across the picture is used, which takes fine texture for noise:
    the estimate is then biased upwards.

    Parameters
    ----------
    frames : list of arrays, shape (height, width)
        At least one; neighbours in the list are neighbours in time.
    white_level : float
        Pixels at it are left out: their noise is cut off.
    """
    if len(frames) < 2:
        return _from_one(frames[0].astype(np.float64), white_level)
    pairs = list(zip(frames[:-1:2], frames[1::2], strict=False))[:16]
    stride = max(1, int(np.sqrt(frames[0].size * len(pairs) / 400_000)))
    levels, squares = [], []
    for before, after in pairs:
        one, two = before.astype(np.float64), after.astype(np.float64)
        mean = 0.5 * (one + two)
        down, across = np.gradient(_box3(mean))
        slope = np.hypot(down, across)
        keep = np.zeros(mean.shape, dtype=bool)
        keep[::stride, ::stride] = True
        keep &= (np.maximum(one, two) < white_level) & (slope <= np.quantile(slope[keep], 0.7))
        levels.append(mean[keep])
        squares.append(two[keep] - one[keep])
    return _fit(np.concatenate(levels), np.concatenate(squares) / np.sqrt(2.0))


def _box3(image: FloatArray) -> FloatArray:
    padded = np.pad(image, 1, mode="edge")
    height, width = image.shape
    total = np.zeros_like(image)
    for j in range(3):
        for i in range(3):
            total += padded[j : j + height, i : i + width]
    return total / 9.0


def _from_one(image: FloatArray, white_level: float) -> NoiseModel:
    if min(image.shape) < 3:
        return NoiseModel(1.0, 0.0)
    second = image[1:-1, 1:-1] - 0.5 * (image[1:-1, :-2] + image[1:-1, 2:])
    second -= 0.5 * (
        image[:-2, 1:-1]
        + image[2:, 1:-1]
        - 0.5 * (image[:-2, :-2] + image[:-2, 2:] + image[2:, :-2] + image[2:, 2:])
    )
    # The mask (-1/2, 1, -1/2) in both directions has the squared norm 9/4.
    level = image[1:-1, 1:-1]
    keep = level < white_level
    return _fit(level[keep], second[keep] / 1.5)


def _clipped_variance(values: FloatArray) -> float:
    """Variance about zero of the bulk of `values`, clipped at 3 sd and corrected for it."""
    variance = max(float(np.median(np.abs(values)) * 1.4826) ** 2, 0.25)
    for _ in range(8):
        inside = values[np.abs(values) < 3.0 * np.sqrt(variance)]
        if inside.size < 16:
            break
        updated = max(float(np.mean(inside**2)) / 0.9733, 1e-6)
        if abs(updated - variance) < 1e-3 * variance:
            return updated
        variance = updated
    return variance


def _fit(level: FloatArray, deviation: FloatArray) -> NoiseModel:
    """Line through the variances of bins of intensity, both coefficients kept physical."""
    if level.size < 64:
        return NoiseModel(1.0, 0.0)
    # Bins of equal width: the background would fill all bins of equal count.
    index = np.minimum((level - level.min()) / max(np.ptp(level), 1e-9) * BINS, BINS - 1).astype(np.int64)
    kept = [k for k in range(BINS) if np.count_nonzero(index == k) >= LEAST_IN_BIN]
    if not kept:
        return NoiseModel(max(_clipped_variance(deviation), ROUNDING_VARIANCE), 0.0)
    return fit_line(
        np.array([float(level[index == k].mean()) for k in kept]),
        np.array([_clipped_variance(deviation[index == k]) for k in kept]),
        np.array([np.count_nonzero(index == k) for k in kept]),
    )


def fit_line(level: FloatArray, variance: FloatArray, count: FloatArray | NDArray[np.int64]) -> NoiseModel:
    """Noise model through variances of pixels of given intensities, each from so many pixels.

    Variances far above the line are left out: there, motion or a wrong model has added to the noise.
    """
    x, y = level, np.maximum(variance, ROUNDING_VARIANCE)
    weight = np.sqrt(count) / y
    a, b = _line(x, y, weight)
    for _ in range(3):
        # Where motion has added to the differences, the bin lies far above the others.
        weight = np.where(y > 1.4 * (a + b * x), 0.0, weight)
        if np.count_nonzero(weight) == 0:
            break
        a, b = _line(x, y, weight)
    return NoiseModel(a, b)


def _line(x: FloatArray, y: FloatArray, weight: FloatArray) -> tuple[float, float]:
    """Weighted line with both coefficients kept physical: a at least the rounding's variance, b not negative."""
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
