"""Compiled steps of following a line: its windows, the smooth line through the stations, its material points."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit
from numba.extending import register_jitable

from tracker.acceptance import TUNING as ACCEPTANCE
from tracker.arrays import MAD_TO_SD, BoolArray, FloatArray, GrayImage
from tracker.line import kernel
from tracker.line.kernel import solve_in_place
from tracker.line.light import Light, hold_light


@dataclass(frozen=True)
class Tuning:
    """Which stations count, and how the next line is predicted."""

    #: [1] share of the window that must lie in the image
    least_seen: float = 0.6
    #: [px] a station that differs from the smooth line through the others by this follows something else
    off_line_px: float = 0.7
    #: [sd] and by this many standard deviations
    #: statistics: noise alone never does
    off_line_sd: float = 8.0
    #: [rounds] in which such stations are left out
    rejections: int = 3
    #: [1] share of the stations without which the line is lost
    least_accepted: float = 0.6
    #: [1] weight of a station relative to the median, at most
    #: convention: no few stations decide
    largest_weight: float = 4.0
    #: [1] memory of the learned recursion per frame
    #: convention: 33 frames
    memory: float = 0.97
    #: [px] error of a coefficient of a line below which its steps tell nothing
    #: physics: about the sd of a station
    learnable_px: float = 0.01
    #: [px] beyond the half window, a displacement at which a fit fails
    reach_px: float = 2.0


TUNING = Tuning()
# Frozen into compiled code.
LEAST_CORRELATION = ACCEPTANCE.least_correlation
GOOD_CHI2 = ACCEPTANCE.good_chi2
LEAST_SIGNAL = ACCEPTANCE.least_signal
NEWEST_SHARE = ACCEPTANCE.newest_share
LARGEST_ERROR_PX = ACCEPTANCE.largest_error_px
LARGEST_GAIN_RATIO = ACCEPTANCE.largest_gain_ratio
LEAST_SEEN = TUNING.least_seen
OFF_LINE_PX = TUNING.off_line_px
OFF_LINE_SD = TUNING.off_line_sd
REJECTIONS = TUNING.rejections
LEAST_ACCEPTED = TUNING.least_accepted
LARGEST_WEIGHT = TUNING.largest_weight
MEMORY = TUNING.memory
LEARNABLE_PX = TUNING.learnable_px
REACH_PX = TUNING.reach_px

# Predictions: polynomials of degree 0 to 3 through the last four lines, and a recursion that is learned. A sum of three
# vibrations about any rest follows one over the steps between seven lines exactly, also where it decays.
DEGREES, LINES = 4, 7
LEARNED, ORDER = DEGREES, LINES - 1
# The polynomials' weights of the last lines, the latest first: of the change per frame of the next one.
CHANGE = (
    np.array([[0.0, 0.0, 0.0, 0.0], [6.0, -6.0, 0.0, 0.0], [9.0, -12.0, 3.0, 0.0], [11.0, -18.0, 9.0, -2.0]])
    / 6.0
)


class LineArrays(NamedTuple):
    """A line for compiled code.

    `fine` (3, 2 m + 1, splines) are the splines and their derivatives at `fine_px` (2 m + 1,), where every second place
    is a station; `project` (splines, 2 m + 1) leads from points there to coefficients. `stiffness` (splines, splines)
    bends smooth functions least where stations are missing. `clamp` (2,) is the clamped end at rest. `background` is
    what is behind the strip, `light` the gain and offset along it.
    """

    fine: FloatArray
    fine_px: FloatArray
    project: FloatArray
    stiffness: FloatArray
    clamp: FloatArray
    half_across: float
    typical_chi2: FloatArray
    camera: FloatArray
    background: kernel.Background
    light: Light


@njit(cache=True, nogil=True, error_model="numpy")
def _curve(
    basis: FloatArray,
    first: int,
    step: int,
    coefs: FloatArray,
    points: FloatArray,
    tangents: FloatArray,
    curvature: FloatArray,
    speed: FloatArray,
) -> None:
    """A curve at every `step`-th place of the basis."""
    splines = coefs.shape[0]
    for k in range(points.shape[0]):
        place = first + k * step
        x = y = dx = dy = ddx = ddy = 0.0
        for j in range(splines):
            cx, cy = coefs[j, 0], coefs[j, 1]
            x += basis[0, place, j] * cx
            y += basis[0, place, j] * cy
            dx += basis[1, place, j] * cx
            dy += basis[1, place, j] * cy
            ddx += basis[2, place, j] * cx
            ddy += basis[2, place, j] * cy
        norm = max(np.hypot(dx, dy), 1e-9)
        points[k, 0], points[k, 1] = x, y
        tangents[k, 0], tangents[k, 1] = dx / norm, dy / norm
        curvature[k] = (dx * ddy - dy * ddx) / norm**3
        speed[k] = norm


@njit(cache=True, nogil=True, error_model="numpy")
def place_stations(line: LineArrays, coefs: FloatArray, blur: FloatArray, stations: kernel.Stations) -> None:
    """Fill the windows at the stations of a centreline; the blur along the normal widens them."""
    speed = np.empty(blur.size)
    _curve(line.fine, 1, 2, coefs, stations.points, stations.tangents, stations.curvature, speed)
    half = line.fine_px[1]
    for k in range(blur.size):
        stations.blur[k] = abs(blur[k])
        stations.half_along[k] = half
        stations.half_across[k] = line.half_across + 0.5 * abs(blur[k])


@njit(cache=True, nogil=True, error_model="numpy")
def at_stations(line: LineArrays, values: FloatArray, out: FloatArray) -> None:
    """A smooth function at the stations."""
    for k in range(out.size):
        total = 0.0
        for j in range(values.size):
            total += line.fine[0, 2 * k + 1, j] * values[j]
        out[k] = total


@register_jitable(error_model="numpy")
def _smooth(line: LineArrays, values: FloatArray, weights: FloatArray, out: FloatArray) -> None:
    splines = out.size
    normal, rhs = line.stiffness.copy(), np.zeros(splines)
    for k in range(values.size):
        w = weights[k]
        if w <= 0.0:
            continue
        for i in range(splines):
            a = w * line.fine[0, 2 * k + 1, i]
            if a == 0.0:
                continue
            rhs[i] += a * values[k]
            for j in range(i + 1):
                normal[i, j] += a * line.fine[0, 2 * k + 1, j]
    # The stiffness makes the matrix positive definite.
    solve_in_place(normal, rhs, out)


@register_jitable(error_model="numpy")
def _accept(line: LineArrays, results: FloatArray, states: FloatArray, accepted: BoolArray) -> int:
    """Mark the stations whose fit is the line; returns their number."""
    count = 0
    for k in range(accepted.size):
        result = results[k]
        chi2, signal = result[kernel.CHI2], result[kernel.SIGNAL]
        explained = (
            signal >= LEAST_CORRELATION**2 * (signal + chi2) or chi2 < GOOD_CHI2 * line.typical_chi2[k]
        )
        ratio = result[kernel.GAIN] / states[k, kernel.GAIN]
        accepted[k] = (
            result[kernel.CONVERGED] > 0.0
            and result[kernel.SEEN] >= LEAST_SEEN
            and explained
            and signal * result[kernel.PIXELS] >= LEAST_SIGNAL
            and ratio > 1.0 / LARGEST_GAIN_RATIO
            and ratio < LARGEST_GAIN_RATIO
        )
        count += accepted[k]
    return count


@register_jitable(error_model="numpy")
def smooth_line(
    line: LineArrays, results: FloatArray, rest: FloatArray, accepted: BoolArray, smooth: FloatArray
) -> None:
    """Smooth displacement through the accepted stations; those far off it are no longer accepted."""
    m = accepted.size
    weights, shifts, fitted = np.empty(m), np.empty(m), np.empty(m)
    for k in range(m):
        shifts[k] = results[k, kernel.SHIFT] if accepted[k] else 0.0
        weights[k] = 1.0 / max(results[k, kernel.SD], 1e-6) ** 2 if accepted[k] else 0.0
    middle = np.median(weights[accepted])
    for k in range(m):
        weights[k] = min(weights[k] / middle, LARGEST_WEIGHT)
    off = np.empty(m)
    for _ in range(REJECTIONS):
        _smooth(line, shifts, weights, smooth)
        at_stations(line, smooth, fitted)
        for k in range(m):
            off[k] = abs(shifts[k] - fitted[k] - rest[k])
        typical = MAD_TO_SD * np.median(off[accepted])
        dropped = False
        for k in range(m):
            far = max(OFF_LINE_PX, OFF_LINE_SD * max(results[k, kernel.SD], typical))
            if accepted[k] and not off[k] <= far:
                accepted[k], weights[k], dropped = False, 0.0, True
        if not dropped or not np.any(accepted):
            return


@njit(cache=True, nogil=True, error_model="numpy")
def register_about(
    image: GrayImage,
    line: LineArrays,
    profiles: kernel.Profiles,
    coefs: FloatArray,
    blur: FloatArray,
    states: FloatArray,
    rest: FloatArray,
    stations: kernel.Stations,
    results: FloatArray,
    accepted: BoolArray,
    smooth: FloatArray,
) -> float:
    """Register all stations about a centreline.

    Parameters
    ----------
    states : array, shape (m, 3)
        Starts of the fits.
    rest : array, shape (m,)
        Part of the displacement of each station that is known not to be smooth along the line.
    stations, results, accepted, smooth
        Filled: windows, results (m, 14), accepted stations (m,), smooth displacement (splines,).

    Returns
    -------
    float
        Largest smooth displacement at a station in px, NaN where too few stations are accepted.
    """
    place_stations(line, coefs, blur, stations)
    reach = line.half_across + REACH_PX
    kernel.register_line(image, stations, profiles, line.camera, line.background, states, reach, results)
    m = accepted.size
    for j in range(smooth.size):
        smooth[j] = 0.0
    if _accept(line, results, states, accepted) < LEAST_ACCEPTED * m:
        return np.nan
    if line.light.share > 0.0:
        hold_light(line.light, results, accepted)
    smooth_line(line, results, rest, accepted, smooth)
    miss = 0.0
    for k in range(m):
        shift = slope = bend = 0.0
        for j in range(smooth.size):
            shift += line.fine[0, 2 * k + 1, j] * smooth[j]
            slope += line.fine[1, 2 * k + 1, j] * smooth[j]
            bend += line.fine[2, 2 * k + 1, j] * smooth[j]
        miss = max(miss, abs(shift))
        # The mean over the pixels of a line that differs from the one predicted is not its value at the station.
        results[k, kernel.SHIFT] -= (
            slope * results[k, kernel.ALONG] + bend * stations.half_along[k] ** 2 / 6.0
        )
    return miss


@njit(cache=True, nogil=True, error_model="numpy")
def moved(line: LineArrays, coefs: FloatArray, smooth: FloatArray, out: FloatArray) -> None:
    """The curve displaced along its normals, with each material point at its distance from the clamp again.

    The displaced curve is as long as before, so that the points move along it towards the clamp; the clamped end itself
    moves from its place at rest along the normal only.
    """
    n, splines = line.fine_px.size, smooth.size
    points, tangents = np.empty((n, 2)), np.empty((n, 2))
    curvature, speed, ahead = np.empty(n), np.empty(n), np.empty(n)
    _curve(line.fine, 0, 1, coefs, points, tangents, curvature, speed)
    arc = last = 0.0
    for k in range(n):
        shift = slope = 0.0
        for j in range(splines):
            shift += line.fine[0, k, j] * smooth[j]
            slope += line.fine[1, k, j] * smooth[j]
        along = speed[k] * (1.0 - curvature[k] * shift)
        stretch = np.hypot(along, slope)
        if k > 0:
            arc += 0.5 * (line.fine_px[k] - line.fine_px[k - 1]) * (last + stretch)
        last = stretch
        tx, ty = tangents[k, 0], tangents[k, 1]
        points[k, 0] -= shift * ty
        points[k, 1] += shift * tx
        tangents[k, 0] = (along * tx - slope * ty) / stretch
        tangents[k, 1] = (along * ty + slope * tx) / stretch
        if k == 0:
            arc = (points[0, 0] - line.clamp[0]) * tangents[0, 0] + (points[0, 1] - line.clamp[1]) * tangents[
                0, 1
            ]
        ahead[k] = arc - line.fine_px[k]
    for j in range(splines):
        for c in range(2):
            total = 0.0
            for k in range(n):
                total += line.project[j, k] * (points[k, c] - ahead[k] * tangents[k, c])
            out[j, c] = total


@njit(cache=True, nogil=True, error_model="numpy")
def weighted(weights: FloatArray, lines: FloatArray, out: FloatArray) -> None:
    """Sum of the first lines (:, splines, 2) with their weights."""
    for j in range(out.shape[0]):
        for c in range(2):
            total = 0.0
            for i in range(weights.size):
                total += weights[i] * lines[i, j, c]
            out[j, c] = total


@njit(cache=True, nogil=True, error_model="numpy")
def path_along_normals(
    line: LineArrays, coefs: FloatArray, change: FloatArray, share: float, out: FloatArray
) -> None:
    """Component of a change of the line along its normals at the stations, times `share`; shape (m,)."""
    for k in range(out.size):
        dx = dy = cx = cy = 0.0
        for j in range(coefs.shape[0]):
            dx += line.fine[1, 2 * k + 1, j] * coefs[j, 0]
            dy += line.fine[1, 2 * k + 1, j] * coefs[j, 1]
            cx += line.fine[0, 2 * k + 1, j] * change[j, 0]
            cy += line.fine[0, 2 * k + 1, j] * change[j, 1]
        out[k] = share * (cy * dx - cx * dy) / max(np.hypot(dx, dy), 1e-9)


@njit(cache=True, nogil=True, error_model="numpy")
def judge_predictions(
    line: LineArrays, past: FloatArray, ahead: FloatArray, known: int, coefs: FloatArray, error: FloatArray
) -> None:
    """Update the running error (5,) of each of the `known` predictions `ahead` (5, 7) with the line that was found."""
    guess = np.empty(coefs.shape)
    for degree in range(known):
        weighted(ahead[degree], past, guess)
        miss = 0.0
        for k in range(line.typical_chi2.size):
            x = y = 0.0
            for j in range(coefs.shape[0]):
                x += line.fine[0, 2 * k + 1, j] * (guess[j, 0] - coefs[j, 0])
                y += line.fine[0, 2 * k + 1, j] * (guess[j, 1] - coefs[j, 1])
            miss = max(miss, np.hypot(x, y))
        error[degree] += NEWEST_SHARE * (min(miss, LARGEST_ERROR_PX) - error[degree])


@njit(cache=True, nogil=True, error_model="numpy")
def learn_recursion(
    past: FloatArray, coefs: FloatArray, normal: FloatArray, rhs: FloatArray, ahead: FloatArray
) -> None:
    """Learn the weights `ahead` (7,) with which the last lines, the latest first, predict the next one.

    Recursive least squares of the step to the line found on the six steps before; `normal` (6, 6) and `rhs` (6,) are
    its sums, to which `coefs` is added.
    """
    for a in range(ORDER):
        rhs[a] *= MEMORY
        for b in range(a + 1):
            normal[a, b] *= MEMORY
    steps = np.empty(ORDER)
    for j in range(coefs.shape[0]):
        for c in range(2):
            for a in range(ORDER):
                steps[a] = past[a, j, c] - past[a + 1, j, c]
            for a in range(ORDER):
                rhs[a] += steps[a] * (coefs[j, c] - past[0, j, c])
                for b in range(a + 1):
                    normal[a, b] += steps[a] * steps[b]
    system, weights = normal.copy(), np.empty(ORDER)
    for a in range(ORDER):
        system[a, a] += coefs.size * LEARNABLE_PX**2 / (1.0 - MEMORY)
    solve_in_place(system, rhs, weights)
    ahead[0], ahead[ORDER] = 1.0 + weights[0], -weights[ORDER - 1]
    for a in range(1, ORDER):
        ahead[a] = weights[a] - weights[a - 1]
