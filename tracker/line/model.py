"""A calibrated line: its centreline, the profile across it, the noise of the pixels and the still background."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import scipy  # its parts are loaded when they are used
from numba import njit
from numpy.typing import NDArray

from tracker.arrays import BoolArray, FloatArray, GrayImage
from tracker.line import kernel
from tracker.line.kernel import Background, Profiles, Stations
from tracker.line.light import UNKNOWN_LIGHT, Light
from tracker.line.profile import LearnedProfile, most_pixels, node_weights, window_pixels
from tracker.line.stations import LineArrays, place_stations


@dataclass(frozen=True)
class Tuning:
    """Ends of a line, splines of its centreline, and the background behind a strip."""

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
    #: [splines] of the centreline, at least
    #: convention: one more than a single cubic has
    least_splines: int = 5
    #: [splines] of the centreline, at most
    #: convention: enough for the fifth mode of a cantilever, few enough to average the noise
    most_splines: int = 16
    #: [stations] for each spline of the centreline
    stations_per_spline: float = 2.5
    #: [splines] with which a profile is learned, at least
    #: convention: over several px of the line, errors that depend on the position within the pixel average out
    least_wide_splines: int = 7
    #: [splines] the same, at first
    #: convention: as above; where the line moves in shapes that they do not follow, there are more
    most_wide_splines: int = 10
    #: [stations] for each of them
    #: convention: as above
    stations_per_wide_spline: float = 7.0
    #: [1] factor to the next larger number of them
    #: convention: with too few for modes 3 to 5 profiles were too wide, and the fifth mode was lost; the number is
    #: chosen
    more_splines: float = 1.4
    #: [stations] for each of the narrowest ones
    stations_per_narrowest: float = 1.5
    #: [1] weight of the bending of the smooth line where stations are missing, relative to that of a typical station
    #: convention: far below that of any station
    stiffness: float = 1e-4


TUNING = Tuning()
# Frozen into compiled code.
CLEAR = TUNING.clear

NO_BACKGROUND = Background(np.zeros((0, 0), np.float32), np.array([1.0, 0.0]))


@dataclass(frozen=True)
class CurveAt:
    """A curve at n places: points and unit tangents (n, 2), curvature (n,), and the norm of the derivative (n,)."""

    points: FloatArray
    tangents: FloatArray
    curvature: FloatArray
    speed: FloatArray

    @property
    def normals(self) -> FloatArray:
        """Unit normals (-t_y, t_x); shape (n, 2)."""
        return np.stack([-self.tangents[:, 1], self.tangents[:, 0]], axis=1)


class Centreline:
    """Splines over the arc length of a line, evaluated at its stations and between them.

    Parameters
    ----------
    length_px : float
        Length of the line.
    stations : int
        Equal parts of the line; a station is the middle of each.
    """

    def __init__(self, length_px: float, stations: int) -> None:
        self.length_px, self.stations = length_px, stations
        self.spacing_px = length_px / stations
        self._fine_px = np.linspace(0.0, length_px, 2 * stations + 1)
        self.arc_px = np.ascontiguousarray(self._fine_px[1::2])
        count = int(np.clip(stations / TUNING.stations_per_spline, TUNING.least_splines, TUNING.most_splines))
        splines = _splines(length_px, count)
        self._fine = np.stack([splines(self._fine_px, nu) for nu in range(3)])
        self._at_stations = np.ascontiguousarray(self._fine[:, 1::2])
        bending = self._fine[2].T @ self._fine[2]
        self._stiffness = TUNING.stiffness * stations / np.trace(bending) * bending
        self._project = np.linalg.pinv(self._fine[0])
        # Numbers of splines with which a profile may be learned, increasing.
        self.wide_counts = _wide_counts(stations)
        self._wide = {n: _splines(length_px, n)(self.arc_px) for n in self.wide_counts}
        # Where no station is missing, which is the rule, all frames have one and the same smoothing.
        self._smooth_all = {n: wide @ np.linalg.pinv(wide) for n, wide in self._wide.items()}

    def arrays(
        self,
        clamp_px: FloatArray,
        half_across_px: float,
        typical_chi2: FloatArray,
        camera: FloatArray,
        background: Background,
        light: Light,
    ) -> LineArrays:
        """The line for compiled code."""
        return LineArrays(
            self._fine,
            self._fine_px,
            self._project,
            self._stiffness,
            clamp_px,
            half_across_px,
            typical_chi2,
            camera,
            background,
            light,
        )

    def from_points(self, points_px: FloatArray) -> FloatArray:
        """Coefficients, shape (splines, 2), of the curve through points at the places of `fine_px`."""
        return np.asarray(self._project @ points_px)

    @property
    def fine_px(self) -> FloatArray:
        """Distances from the clamp of the stations, the middles between them, and both ends."""
        return self._fine_px

    def at_stations(self, coefs: FloatArray) -> CurveAt:
        """The curve at its stations."""
        return _curve(self._at_stations, coefs)

    def fine(self, coefs: FloatArray) -> CurveAt:
        """The curve at `fine_px`."""
        return _curve(self._fine, coefs)

    def smoothed(self, values: FloatArray, used: BoolArray) -> FloatArray:
        """Coefficients, shape (splines,), of the smooth function through the used values (m,) at the stations."""
        basis = self._fine[0, 1::2][used]
        return np.asarray(np.linalg.solve(basis.T @ basis + self._stiffness, basis.T @ values[used]))

    def off_smooth(self, values: FloatArray, used: BoolArray) -> FloatArray:
        """Difference of values (m,) at the stations from the smooth function through those used."""
        return np.asarray(values - self._at_stations[0] @ self.smoothed(values, used))

    def widely_smooth(self, points_px: FloatArray, count: int) -> FloatArray:
        """Points at the stations, (m, 2), replaced by those of a curve of `count` splines; NaN are filled."""
        known, wide = np.all(np.isfinite(points_px), axis=1), self._wide[count]
        if np.all(known):
            return np.asarray(self._smooth_all[count] @ points_px)
        if np.count_nonzero(known) < count:
            return np.full_like(points_px, np.nan)
        coefs, *_ = np.linalg.lstsq(wide[known], points_px[known], rcond=None)
        return np.asarray(wide @ coefs)


def _wide_counts(stations: int) -> tuple[int, ...]:
    few = int(
        np.clip(
            stations / TUNING.stations_per_wide_spline, TUNING.least_wide_splines, TUNING.most_wide_splines
        )
    )
    counts = [min(few, stations - 1)]
    while TUNING.more_splines * counts[-1] <= min(
        stations / TUNING.stations_per_narrowest, TUNING.most_splines + TUNING.least_wide_splines
    ):
        counts.append(int(np.ceil(TUNING.more_splines * counts[-1])))
    return tuple(counts)


def _splines(length_px: float, count: int) -> scipy.interpolate.BSpline:
    knots = np.concatenate([np.zeros(3), np.linspace(0.0, length_px, count - 2), np.full(3, length_px)])
    return scipy.interpolate.BSpline(knots, np.eye(count), 3)


def _curve(basis: FloatArray, coefs: FloatArray) -> CurveAt:
    first, second = basis[1] @ coefs, basis[2] @ coefs
    speed = np.maximum(np.hypot(first[:, 0], first[:, 1]), 1e-9)
    turn = (first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]) / speed**3
    return CurveAt(basis[0] @ coefs, first / speed[:, None], turn, speed)


def smoothed(points_px: FloatArray, weights: FloatArray, splines: int) -> FloatArray:
    """Points at equal distances along a line, replaced by those of a smooth curve.

    Steps between points that are known to a px would add to the length of the line.
    """
    share = (np.arange(len(points_px)) + 0.5) / len(points_px)
    basis = _splines(1.0, max(min(splines, len(points_px) // 2), 4))(share)
    root = np.sqrt(weights)[:, None]
    return np.asarray(basis @ np.linalg.lstsq(root * basis, root * points_px)[0])


def resampled(points_px: FloatArray, count: int) -> tuple[FloatArray, float]:
    """Points at equal distances along a polyline, shape (count, 2), and its length."""
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points_px, axis=0), axis=1))])
    at = np.linspace(0.0, arc[-1], count)
    return np.stack([np.interp(at, arc, c) for c in points_px.T], axis=1), float(arc[-1])


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
