"""Profile across a line, learned from the pixels of many frames and stations: noise-free, varying slowly along it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy  # its parts are loaded when they are used
from numba import njit
from numpy.typing import NDArray
from scipy.linalg import solveh_banded

from tracker.arrays import FloatArray, GrayImage
from tracker.line import kernel
from tracker.line.kernel import Profiles
from tracker.template import fill_taps


@dataclass(frozen=True)
class Tuning:
    """Learning of a profile."""

    #: [1] weight of the third differences of the coefficients, relative to that of the pixels of a typical one
    #: convention: it decides only where a line at rest shows no pixel
    smoothing: float = 1e-3


TUNING = Tuning()

STEP_PX = 0.25


@njit(cache=True, nogil=True, error_model="numpy")
def most_pixels(stations: kernel.Stations) -> int:
    """Upper bound of the number of pixels of a window: those of the square around it, in any direction."""
    reach = 0.0
    # Entry by entry: compiling the maximum of an array takes numba a second.
    for k in range(stations.half_along.size):
        reach = max(reach, np.hypot(stations.half_along[k], stations.half_across[k]))
    side = 2 * int(reach) + 3
    return side * side


@njit(cache=True, nogil=True, error_model="numpy")
def window_pixels(
    image: GrayImage,
    stations: kernel.Stations,
    k: int,
    shift: float,
    saturation: float,
    places: NDArray[np.int64],
    across: FloatArray,
) -> int:
    """Pixels of a station displaced by `shift` that are in the image and not saturated; returns their number.

    Filled: row and column of each in `places`, shape (2, n), and its distance from the line in `across`, shape (n,).
    """
    box = np.empty(4, dtype=np.int64)
    height, width = image.shape
    tx, ty = stations.tangents[k, 0], stations.tangents[k, 1]
    px, py = stations.points[k, 0] - shift * ty, stations.points[k, 1] + shift * tx
    half_along, half_across = stations.half_along[k], stations.half_across[k]
    bend = 0.5 * stations.curvature[k]
    kernel.box_around(px, py, tx, ty, half_along, half_across, box)
    count = 0
    for row in range(max(box[2], 0), min(box[3], height - 1) + 1):
        y = row - py
        for column in range(max(box[0], 0), min(box[1], width - 1) + 1):
            x = column - px
            u = x * tx + y * ty
            v = y * tx - x * ty - bend * u * u
            if u < -half_along or u >= half_along or v < -half_across or v > half_across:
                continue
            if float(image[row, column]) >= saturation:
                continue
            places[0, count], places[1, count], across[count] = row, column, v
            count += 1
    return count


@dataclass(frozen=True)
class LearnedProfile:
    """Profiles at nodes along the line, in gray levels; between the nodes they are interpolated linearly.

    ``coefs`` (q, j) are those of uniform cubic B-splines, ``first_px`` the place of the first, `STEP_PX` the step.
    """

    coefs: FloatArray
    first_px: float

    def at_stations(self, weights: FloatArray) -> Profiles:
        """Profile of each station for compiled code; weights of the nodes of shape (q, m)."""
        coefs = np.ascontiguousarray(weights.T @ self.coefs)
        polynomials = np.zeros((*coefs.shape, 4))
        for station, out in zip(coefs, polynomials, strict=True):
            kernel.polynomials_of(station, out)
        return Profiles(coefs, polynomials, self.first_px, STEP_PX)

    def values(self, across_px: FloatArray) -> FloatArray:
        """Mean profile at places across the line, constant beyond its ends."""
        return spline_values(self.coefs.mean(axis=0), self.first_px, across_px)

    def shifted(self, shift_px: float) -> LearnedProfile:
        """The profile with its zero moved to `shift_px`."""
        return LearnedProfile(self.coefs, self.first_px - shift_px)


def spline_values(coefs: FloatArray, first_px: float, across_px: FloatArray) -> FloatArray:
    """Values of a uniform cubic B-spline, constant beyond its ends."""
    j = coefs.size
    knots = first_px + STEP_PX * (np.arange(j + 4) - 2.0)
    inside = np.clip(across_px, knots[3], knots[-4] - 1e-9)
    return np.asarray(scipy.interpolate.BSpline(knots, coefs, 3)(inside))


class ProfileSums:
    """Normal equations of the profiles at q nodes, to which `add_to_profile` adds pixels."""

    def __init__(self, reach_px: float, nodes: int) -> None:
        self.first_px = -(np.ceil(reach_px / STEP_PX) + 1.0) * STEP_PX
        count = 2 * int(np.ceil(reach_px / STEP_PX)) + 3
        self.normal, self.rhs = np.zeros((nodes, count, 4)), np.zeros((nodes, count))

    def solve(self) -> LearnedProfile:
        """The profiles; smooth where no pixel was seen, 0 where none was."""
        count = self.rhs.shape[1]
        third = np.diff(np.eye(count), n=3, axis=0)
        smoothing = third.T @ third
        coefs = []
        for normal, rhs in zip(self.normal, self.rhs, strict=True):
            typical = float(np.mean(normal[:, 0]))
            if typical == 0.0:
                # Smoothing alone is singular: whether it has a factor would depend on the rounding of the processor.
                coefs.append(np.zeros(count))
                continue
            banded = np.zeros((4, count))
            for d in range(4):
                banded[d, : count - d] = normal[: count - d, d]
                banded[d, : count - d] += TUNING.smoothing * typical * np.diagonal(smoothing, d)
            coefs.append(solveh_banded(banded, rhs, lower=True))
        return LearnedProfile(np.array(coefs), self.first_px)


@njit(cache=True, nogil=True, error_model="numpy")
def add_to_profile(
    image: GrayImage,
    stations: kernel.Stations,
    first: float,
    step: float,
    camera: FloatArray,
    background: kernel.Background,
    states: FloatArray,
    weights: FloatArray,
    normal: FloatArray,
    rhs: FloatArray,
) -> None:
    """Add the pixels of the stations to the normal equations of profiles.

    Parameters
    ----------
    states : array, shape (m, 3)
        Displacement, gain and offset; stations with NaN are left out.
    weights : array, shape (q, m)
        Weight of each station in each of q profiles.
    normal : array, shape (q, j, 4)
        Diagonals of the banded normal matrix, the main one first.
    rhs : array, shape (q, j)
    """
    basis = np.empty(4)
    count = rhs.shape[1]
    most = most_pixels(stations)
    places, across = np.empty((2, most), dtype=np.int64), np.empty(most)
    texture, uncovered = background.texture, background.uncovered
    for k in range(stations.points.shape[0]):
        shift, gain, offset = states[k, 0], states[k, 1], states[k, 2]
        if not np.isfinite(shift + gain + offset):
            continue
        for i in range(window_pixels(image, stations, k, shift, camera[2], places, across)):
            at = (across[i] - first) / step
            j = int(np.floor(at))
            if j < 1 or j > count - 3:
                continue
            fill_taps(at - j, basis)
            row, column = places[0, i], places[1, i]
            level = float(image[row, column])
            behind = texture[row, column] if texture.size else 0.0
            lift = 1.0 + uncovered[1] * behind
            weight = (gain * lift) ** 2 / max(camera[0] + camera[1] * level, 1e-6)
            value = ((level - offset) / gain - uncovered[0] * behind) / lift
            for q in range(rhs.shape[0]):
                part = weight * weights[q, k]
                if part == 0.0:
                    continue
                for a in range(4):
                    rhs[q, j - 1 + a] += part * basis[a] * value
                    for b in range(a, 4):
                        normal[q, j - 1 + a, b - a] += part * basis[a] * basis[b]


def node_weights(arc_px: FloatArray, length_px: float, nodes: int) -> FloatArray:
    """Weights of linear interpolation between nodes at equal distances; shape (nodes, m)."""
    if nodes == 1:
        return np.ones((1, arc_px.size))
    at = arc_px / length_px * (nodes - 1)
    return np.asarray(np.maximum(1.0 - np.abs(at - np.arange(nodes)[:, None]), 0.0))


def middle_px(profile: LearnedProfile, reach_px: float, *, is_edge: bool) -> float:
    """Place that is the line: midway between the outer half levels of a strip, or the half level of an edge."""
    across, levels, left, right = _sampled(profile, reach_px)
    if is_edge:
        below = levels - 0.5 * (left + right)
        crossing = np.flatnonzero(np.diff(np.sign(below)))
        if not crossing.size:
            return 0.0
        nearest = crossing[np.argmin(np.abs(across[crossing]))]
        return float(np.interp(0.0, *_ascending(below[nearest : nearest + 2], across[nearest : nearest + 2])))
    low, high = _outer_half_levels(across, levels, 0.5 * (left + right))
    return 0.5 * (low + high)


def width_px(profile: LearnedProfile, reach_px: float) -> float:
    """Width of a strip between its outer half levels."""
    across, levels, left, right = _sampled(profile, reach_px)
    low, high = _outer_half_levels(across, levels, 0.5 * (left + right))
    return high - low


def _sampled(profile: LearnedProfile, reach_px: float) -> tuple[FloatArray, FloatArray, float, float]:
    """Places across the line, the mean profile there, and the levels at both ends."""
    across = np.linspace(-reach_px, reach_px, 801)
    levels = profile.values(across)
    return across, levels, float(levels[:40].mean()), float(levels[-40:].mean())


def _outer_half_levels(across: FloatArray, levels: FloatArray, ground: float) -> tuple[float, float]:
    """First and last place at which a strip's profile crosses half of its contrast."""
    deviation = np.abs(levels - ground)
    # Of several stripes, such as a reflection, the strongest decides the contrast.
    excess = deviation - 0.5 * float(np.quantile(deviation, 0.98))
    beyond = np.flatnonzero(excess > 0.0)
    first, last = max(int(beyond[0]), 1), min(int(beyond[-1]), levels.size - 2)
    return (
        float(np.interp(0.0, *_ascending(excess[first - 1 : first + 1], across[first - 1 : first + 1]))),
        float(np.interp(0.0, *_ascending(excess[last : last + 2], across[last : last + 2]))),
    )


def _ascending(values: FloatArray, places: FloatArray) -> tuple[FloatArray, FloatArray]:
    order = np.argsort(values)
    return values[order], places[order]
