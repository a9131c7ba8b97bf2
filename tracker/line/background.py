"""Texture of the still background behind a strip, learned from the frames in which the strip is beside it."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tracker.arrays import FloatArray, GrayImage
from tracker.line import kernel
from tracker.line.model import NO_BACKGROUND, LineModel
from tracker.line.pixels import most_pixels, window_pixels

# A pixel of which the strip covers less than this share shows the background alone.
CLEAR = 0.1
# Texture below this share of the noise, in variance, does not change the positions: it is not modelled.
LEAST_TEXTURE = 0.1
# A strip with parts brighter and darker than the background: its profile does not tell how much it covers.
LARGEST_OPPOSITE = 0.15
SUMS = 7


@njit(cache=True, nogil=True, error_model="numpy")
def _add(
    image: GrayImage,
    stations: kernel.Stations,
    profiles: kernel.Profiles,
    camera: FloatArray,
    states: FloatArray,
    ground: float,
    peak: float,
    sums: NDArray[np.float32],
) -> None:
    """Add the residuals r of an image to the sums of each pixel, with weight w and the share c that is covered.

    Sums, (7, height, width): w, w r, w c, w c^2 and w c r, then w and w r of pixels that are clear.
    """
    blurred = np.empty(profiles.coefs.shape[1])
    scratch = np.zeros((blurred.size, 4))
    most = most_pixels(stations)
    places, across = np.empty((2, most), dtype=np.int64), np.empty(most)
    for k in range(stations.points.shape[0]):
        shift, gain, offset = states[k, 0], states[k, 1], states[k, 2]
        if not np.isfinite(shift + gain + offset):
            continue
        polynomials = kernel.station_polynomials(profiles, k, stations.blur[k], blurred, scratch)
        for i in range(window_pixels(image, stations, k, shift, camera[2], places, across)):
            row, column = places[0, i], places[1, i]
            level = float(image[row, column])
            value = kernel.profile_value(polynomials, (across[i] - profiles.first_px) / profiles.step_px)
            w = gain * gain / max(camera[0] + camera[1] * level, 1e-6)
            r = (level - offset) / gain - value
            c = min(max((value - ground) / peak, 0.0), 1.0)
            sums[0, row, column] += w
            sums[1, row, column] += w * r
            sums[2, row, column] += w * c
            sums[3, row, column] += w * c * c
            sums[4, row, column] += w * c * r
            if c < CLEAR:
                sums[5, row, column] += w
                sums[6, row, column] += w * r


def learned_background(
    images: list[GrayImage], views: list[kernel.Stations], states: list[FloatArray], model: LineModel
) -> kernel.Background:
    """Background of a strip's model, from images in which its stations are known.

    Parameters
    ----------
    views, states : list of Stations, list of array, shape (m, 3)
        Windows, and displacement, gain and offset of each station in each image; NaN where unknown.

    Notes
    -----
    Texture t behind a strip adds t (1 - s c) to a pixel, where c is the profile relative to its largest contrast and s
    the share that a strip narrower than the blur covers in its middle. s follows from the texture beside the strip,
    in the pixels that it covers in other frames. The texture of a pixel is shrunk towards zero by its uncertainty.
    """
    ground, peak = _contrast(model)
    if model.feature == "edge" or peak == 0.0:
        return NO_BACKGROUND
    sums = np.zeros((SUMS, *images[0].shape), np.float32)
    profiles = model.profiles()
    for image, view, state in zip(images, views, states, strict=True):
        _add(image, view, profiles, model.camera, state, ground, peak, sums)
    whole, rest, cover, cover2, cover_rest, clear, clear_rest = sums.astype(np.float64)
    if not np.any(clear > 0.0):
        return NO_BACKGROUND
    known = clear >= np.median(clear[clear > 0.0])
    variance = float(np.mean((clear_rest[known] / clear[known]) ** 2) - np.mean(1.0 / clear[known]))
    noise = float(model.camera[0] + model.camera[1] * max(ground, 0.0))
    if not variance > LEAST_TEXTURE * noise:
        return NO_BACKGROUND
    seen = clear_rest / (clear + 1.0 / variance)
    share = np.sum(seen * (seen * cover - cover_rest)) / max(float(np.sum(seen**2 * cover2)), 1e-9)
    share = float(np.clip(share, 0.0, 1.0))
    texture = (rest - share * cover_rest) / (whole - 2.0 * share * cover + share**2 * cover2 + 1.0 / variance)
    uncovered = np.array([1.0 + share * ground / peak, -share / peak])
    return kernel.Background(texture.astype(np.float32), uncovered)


def _contrast(model: LineModel) -> tuple[float, float]:
    """Level of the profile beside a strip, and the largest deviation from it; 0 where it has both signs."""
    across = np.linspace(-model.half_across_px, model.half_across_px, 201)
    levels = model.profile.values(across)
    ground = 0.5 * float(levels[:10].mean() + levels[-10:].mean())
    off = levels - ground
    peak = float(off[np.argmax(np.abs(off))])
    return ground, 0.0 if np.min(off / peak) < -LARGEST_OPPOSITE else peak
