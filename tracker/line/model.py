"""A calibrated line: its centreline, the profile across it, the noise of the pixels and the still background."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tracker.arrays import FloatArray, GrayImage
from tracker.line import kernel
from tracker.line.curve import Centreline
from tracker.line.kernel import Background, Profiles, Stations
from tracker.line.light import UNKNOWN_LIGHT, Light
from tracker.line.pixels import most_pixels, window_pixels
from tracker.line.profile import LearnedProfile, node_weights
from tracker.line.stations import LineArrays, place_stations


@dataclass(frozen=True)
class Tuning:
    """Ends of a line, and the background behind a strip."""

    #: [px] the stations begin and end this far from the ends of the line
    #: convention: there lens and clamp change the profile
    inset_px: float = 2.0
    #: [1] a pixel of which the strip covers less shows the background alone
    clear: float = 0.1
    #: [1] texture below this share of the noise, in variance, is not modelled
    #: physics: it raises the sd of a position by less than 5 %
    least_texture: float = 0.1
    #: [1] deviations of the other sign, relative to the contrast, with which no background is modelled
    #: convention: the profile of a strip with parts brighter and darker than the background does not tell how much it
    #: covers
    largest_opposite: float = 0.15


TUNING = Tuning()
# Frozen into compiled code.
CLEAR = TUNING.clear

NO_BACKGROUND = Background(np.zeros((0, 0), np.float32), np.array([1.0, 0.0]))


@dataclass(frozen=True)
class LineModel:
    """A calibrated line.

    Attributes
    ----------
    start : array, shape (splines, 2)
        Coefficients of the centreline in the first frame.
    feature : str
        "strip", or "edge" for a single edge.
    half_across_px : float
        Half size of the windows across the line, at rest.
    camera : array, shape (3,)
        Variance a + b I of a pixel of intensity I, and the level of saturation.
    typical_chi2 : array, shape (m,)
        Median of chi-square per degree of freedom of each station in the calibration frames, at least 1.
    width_px : float
        Width of a strip between its outer half levels; 0 for an edge.
    largest_step_px : float
        Largest motion of a station from frame to frame in the calibration frames.
    exposure_share : float
        Exposure time over the time between frames; 0 where unknown.
    background : Background
        Texture of what is at rest behind a strip.
    light : Light
        Gain and offset along an edge; unknown for a strip, whose position does not depend on them.
    ends_seen : tuple of bool
        Whether the clamped end and the free end are where the strip is seen to end in the first frame; otherwise they
        are the given ones.
    """

    line: Centreline
    start: FloatArray
    profile: LearnedProfile
    feature: Literal["strip", "edge"]
    half_across_px: float
    camera: FloatArray
    typical_chi2: FloatArray
    width_px: float = 0.0
    largest_step_px: float = 0.0
    exposure_share: float = 0.0
    background: Background = NO_BACKGROUND
    light: Light = UNKNOWN_LIGHT
    ends_seen: tuple[bool, bool] = (False, False)

    @property
    def clamp_px(self) -> FloatArray:
        """Begin of the stations, `TUNING.inset_px` from the clamp, in the first frame; shape (2,)."""
        return np.asarray(self.line.fine(self.start).points[0])

    @property
    def length_px(self) -> float:
        """Length of the whole line."""
        return self.line.length_px + 2.0 * TUNING.inset_px

    @property
    def from_clamp_px(self) -> FloatArray:
        """Distance of the stations from the clamp along the line; shape (m,)."""
        return np.asarray(self.line.arc_px + TUNING.inset_px)

    def profiles(self) -> Profiles:
        """Profile of each station."""
        nodes = node_weights(self.line.arc_px, self.line.length_px, len(self.profile.coefs))
        return self.profile.at_stations(nodes)

    def arrays(self) -> LineArrays:
        """The line for compiled code."""
        return self.line.arrays(
            self.clamp_px, self.half_across_px, self.typical_chi2, self.camera, self.background, self.light
        )

    def stations(self, coefs: FloatArray) -> Stations:
        """Windows at the stations of a centreline at rest."""
        found = empty_stations(self.line.stations)
        place_stations(self.arrays(), coefs, np.zeros(self.line.stations), found)
        return found


def empty_stations(count: int) -> Stations:
    """Windows to be filled."""
    return Stations(np.empty((count, 2)), np.empty((count, 2)), *(np.empty(count) for _ in range(4)))


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
    if not variance > TUNING.least_texture * noise:
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
    return ground, 0.0 if np.min(off / peak) < -TUNING.largest_opposite else peak
