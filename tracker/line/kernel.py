"""Registration kernel of a line: Gauss-Newton fit of the profile across it to the pixels of each station."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tracker.arrays import FloatArray, GrayImage

# State of a station: displacement along the normal in px, gain, offset.
STATE = 3
# Result: state, sd of the displacement, chi-square per degree of freedom, pixels used, share of the window in the
# image, share of saturated pixels, signal (chi-square of the profile itself against a uniform image, per degree of
# freedom), whether the fit converged.
RESULT = 10
SHIFT, GAIN, OFFSET, SD, CHI2, PIXELS, SEEN, SATURATED, SIGNAL, CONVERGED = range(RESULT)

# Compiler options under which sums may be evaluated in any order.
REORDER = {"contract", "reassoc"}
MAX_ITERATIONS = 12
# The error after a step e is of order e^3 over the blur squared: the term in e^2 vanishes over a whole profile.
STEP_TOLERANCE_PX = 0.03
LARGEST_STEP_PX = 1.0
LEAST_PIXELS = 8
# Pixels are collected up to this far beyond the window; a displacement beyond it needs others.
MARGIN_PX = 1.5
# Path during the exposure below which blur is not modelled: the sd grows by less than 1 %.
LEAST_BLUR_PX = 0.2


class Profiles(NamedTuple):
    """Profile across the line at m stations: uniform cubic B-splines in gray levels.

    `coefs` (m, j); the first coefficient is centred at `first_px` across the line, the next ones `step_px` apart.
    """

    coefs: FloatArray
    first_px: float
    step_px: float


class Stations(NamedTuple):
    """m stations of a line in the image.

    `points` (m, 2) px; `tangents` (m, 2) unit vectors, the normal being (-t_y, t_x); `curvature` (m,) 1/px, positive
    where the line turns towards the normal; `half_along` (m,) and `half_across` (m,) half sizes of the windows in px;
    `blur` (m,) path along the normal during the exposure in px.
    """

    points: FloatArray
    tangents: FloatArray
    curvature: FloatArray
    half_along: FloatArray
    half_across: FloatArray
    blur: FloatArray


@njit(cache=True, nogil=True, error_model="numpy")
def _blurred(coefs: FloatArray, width: float, out: FloatArray) -> None:
    """Mean of a spline over a path of `width` steps, from the linear interpolation of its coefficients.

    That widens the profile symmetrically by a fraction of a step: it adds no shift.
    """
    n = coefs.size
    total = np.empty(n)
    total[0] = 0.0
    for j in range(1, n):
        total[j] = total[j - 1] + 0.5 * (coefs[j - 1] + coefs[j])
    for j in range(n):
        value = 0.0
        for side in range(2):
            x = j + (side - 0.5) * width
            sign = 2.0 * side - 1.0
            if x <= 0.0:
                value += sign * coefs[0] * x
            elif x >= n - 1:
                value += sign * (total[n - 1] + coefs[n - 1] * (x - (n - 1)))
            else:
                i = int(x)
                f = x - i
                value += sign * (total[i] + f * coefs[i] + 0.5 * f * f * (coefs[i + 1] - coefs[i]))
        out[j] = value / width


@njit(cache=True, nogil=True, error_model="numpy")
def _box(
    px: float, py: float, tx: float, ty: float, along: float, across: float, box: NDArray[np.int64]
) -> None:
    """First and last column and row of the pixels of a window."""
    half_x = abs(tx) * along + abs(ty) * across
    half_y = abs(ty) * along + abs(tx) * across
    box[0], box[1] = int(np.ceil(px - half_x)), int(np.floor(px + half_x))
    box[2], box[3] = int(np.ceil(py - half_y)), int(np.floor(py + half_y))


@njit(cache=True, nogil=True, error_model="numpy")
def _collect(
    image: GrayImage, stations: Stations, k: int, shift: float, v_px: FloatArray, levels: FloatArray
) -> int:
    """Pixels along a station within `MARGIN_PX` of its window: offset across from the undisplaced line, gray level.

    A displacement along the normal leaves the place along the line unchanged: they serve several steps of a fit. The
    level of a pixel outside the image is -1. Returns their number.
    """
    box = np.empty(4, dtype=np.int64)
    tx, ty = stations.tangents[k, 0], stations.tangents[k, 1]
    px, py = stations.points[k, 0] - shift * ty, stations.points[k, 1] + shift * tx
    along, across = stations.half_along[k], stations.half_across[k] + MARGIN_PX
    bend = 0.5 * stations.curvature[k]
    _box(px, py, tx, ty, along, across, box)
    height, width = image.shape
    count = 0
    for row in range(box[2], box[3] + 1):
        y = row - py
        for column in range(box[0], box[1] + 1):
            x = column - px
            u = x * tx + y * ty
            v = y * tx - x * ty - bend * u * u
            # Half open: each pixel belongs to one station.
            if u < -along or u >= along or v < -across or v > across:
                continue
            v_px[count] = v + shift
            inside = row >= 0 and column >= 0 and row < height and column < width
            levels[count] = float(image[row, column]) if inside else -1.0
            count += 1
    return count


@njit(cache=True, nogil=True, error_model="numpy")
def _polynomials(coefs: FloatArray, out: FloatArray) -> None:
    """Polynomials of a cubic B-spline, (j, 4), each in the distance from its coefficient in steps, 0 to 1."""
    for j in range(1, coefs.size - 2):
        c0, c1, c2, c3 = coefs[j - 1], coefs[j], coefs[j + 1], coefs[j + 2]
        out[j, 0] = (c0 + 4.0 * c1 + c2) / 6.0
        out[j, 1] = 0.5 * (c2 - c0)
        out[j, 2] = 0.5 * (c0 - 2.0 * c1 + c2)
        out[j, 3] = (c3 - 3.0 * c2 + 3.0 * c1 - c0) / 6.0


# Sums in any order, so that the loop is vectorised.
@njit(cache=True, nogil=True, error_model="numpy", fastmath=REORDER)
def _sums(
    v_px: FloatArray,
    levels: FloatArray,
    count: int,
    across: float,
    state: FloatArray,
    polynomials: FloatArray,
    first: float,
    step: float,
    camera: FloatArray,
    out: FloatArray,
) -> None:
    """Sums over the pixels of a station: 9 of the normal equations, chi-square, pixels used, expected, saturated."""
    shift, gain, offset = state[0], state[1], state[2]
    scale = 1.0 / step
    last = polynomials.shape[0] - 3
    read, noise_gain, white = camera[0], camera[1], camera[2]
    dd = dp = d1 = pp = p1 = ww = dr = pr = wr = rr = 0.0
    used = expected = saturated = 0.0
    for i in range(count):
        v, level = v_px[i] - shift, levels[i]
        inside = 1.0 if abs(v) <= across else 0.0
        bright = inside if level >= white else 0.0
        good = inside - bright if level >= 0.0 else 0.0
        at = min(max((v - first) * scale, 1.0), last + 1.0)
        j = min(int(at), last)
        f = at - j
        a, b, c, d = polynomials[j, 0], polynomials[j, 1], polynomials[j, 2], polynomials[j, 3]
        value = a + f * (b + f * (c + f * d))
        model = gain * value + offset
        weight = good / max(read + noise_gain * max(model, 0.0), 1e-6)
        rest = level - model
        slope = -gain * scale * (b + f * (2.0 * c + 3.0 * f * d))
        expected += inside
        saturated += bright
        used += good
        dd += weight * slope * slope
        dp += weight * slope * value
        d1 += weight * slope
        pp += weight * value * value
        p1 += weight * value
        ww += weight
        dr += weight * slope * rest
        pr += weight * value * rest
        wr += weight * rest
        rr += weight * rest * rest
    out[0], out[1], out[2], out[3], out[4], out[5] = dd, dp, d1, pp, p1, ww
    out[6], out[7], out[8], out[9] = dr, pr, wr, rr
    out[10], out[11], out[12] = used, expected, saturated


@njit(cache=True, nogil=True, error_model="numpy")
def _register_station(
    image: GrayImage,
    stations: Stations,
    k: int,
    polynomials: FloatArray,
    first: float,
    step: float,
    camera: FloatArray,
    start: FloatArray,
    max_shift: float,
    v_px: FloatArray,
    levels: FloatArray,
    result: FloatArray,
) -> None:
    sums = np.empty(13)
    state = start.copy()
    collected, count = state[SHIFT], _collect(image, stations, k, state[SHIFT], v_px, levels)
    for _ in range(MAX_ITERATIONS):
        if abs(state[SHIFT] - collected) > MARGIN_PX:
            collected, count = state[SHIFT], _collect(image, stations, k, state[SHIFT], v_px, levels)
        _sums(v_px, levels, count, stations.half_across[k], state, polynomials, first, step, camera, sums)
        used = sums[10]
        result[PIXELS] = used
        result[SEEN] = (used + sums[12]) / max(sums[11], 1.0)
        result[SATURATED] = sums[12] / max(used + sums[12], 1.0)
        if used < LEAST_PIXELS:
            return
        # Offset eliminated, then gain: the normal equations of the three unknowns by hand.
        ww = sums[5]
        pp = sums[3] - sums[4] * sums[4] / ww
        dp = sums[1] - sums[2] * sums[4] / ww
        pr = sums[7] - sums[8] * sums[4] / ww
        if not pp > 1e-9 * sums[3]:
            return
        dd = sums[0] - sums[2] * sums[2] / ww - dp * dp / pp
        dr = sums[6] - sums[8] * sums[2] / ww - dp * pr / pp
        if not dd > 1e-9 * sums[0]:
            return
        shift = dr / dd
        gain = (pr - dp * shift) / pp
        offset = (sums[8] - sums[2] * shift - sums[4] * gain) / ww
        dof = used - STATE
        result[CHI2] = max(sums[9] - sums[6] * shift - sums[7] * gain - sums[8] * offset, 0.0) / dof
        result[SIGNAL] = (state[1] + gain) ** 2 * pp / dof
        result[SD] = 1.0 / np.sqrt(dd)
        taken = min(max(shift, -LARGEST_STEP_PX), LARGEST_STEP_PX)
        state[0] += taken
        state[1] += gain
        state[2] += offset
        # Also rejects NaN.
        if not abs(state[0] - start[0]) <= max_shift:
            return
        # A wrong gain scales the step by its relative error.
        if abs(shift) < STEP_TOLERANCE_PX and abs(shift * gain) < 1e-3 * abs(state[1]):
            for i in range(STATE):
                result[i] = state[i]
            result[CONVERGED] = 1.0
            return


@njit(cache=True, nogil=True, error_model="numpy")
def register_line(
    image: GrayImage,
    stations: Stations,
    profiles: Profiles,
    camera: FloatArray,
    states: FloatArray,
    max_shift: float,
    results: FloatArray,
) -> None:
    """Fit displacement along the normal, gain and offset of each station of a line.

    Parameters
    ----------
    image : uint8 or uint16 array, shape (height, width)
    camera : array, shape (3,)
        Variance a + b I of a pixel of intensity I, and the level from which pixels are excluded.
    states : array, shape (m, 3)
        Displacement, gain and offset from which the fits start.
    max_shift : float
        A fit fails that moves farther than this from its start, in px.
    results : array, shape (m, 10)
        Filled; see the names of the columns in this module. NaN where the fit failed.

    Notes
    -----
    The image is never interpolated: that would correlate its noise and bias positions towards pixel centres. No pixel
    belongs to two stations, so that their errors are independent for white noise.
    """
    blurred = np.empty(profiles.coefs.shape[1])
    polynomials = np.empty((blurred.size, 4))
    # A window in any direction has at most the pixels of the square around it.
    side = 2 * int(np.max(np.hypot(stations.half_along, stations.half_across + MARGIN_PX))) + 3
    v_px, levels = np.empty(side * side), np.empty(side * side)
    for k in range(stations.points.shape[0]):
        for i in range(RESULT):
            results[k, i] = np.nan
        results[k, CONVERGED] = 0.0
        finite = np.isfinite(states[k, 0] + states[k, 1] + states[k, 2])
        if not (finite and np.isfinite(stations.points[k, 0] + stations.points[k, 1])):
            continue
        if not abs(stations.points[k, 0]) + abs(stations.points[k, 1]) < 1e7:
            continue
        if stations.blur[k] >= LEAST_BLUR_PX:
            _blurred(profiles.coefs[k], stations.blur[k] / profiles.step_px, blurred)
            _polynomials(blurred, polynomials)
        else:
            _polynomials(profiles.coefs[k], polynomials)
        _register_station(
            image,
            stations,
            k,
            polynomials,
            profiles.first_px,
            profiles.step_px,
            camera,
            states[k],
            max_shift,
            v_px,
            levels,
            results[k],
        )


@njit(cache=True, nogil=True, error_model="numpy")
def add_to_profile(
    image: GrayImage,
    stations: Stations,
    first: float,
    step: float,
    camera: FloatArray,
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
    box = np.empty(4, dtype=np.int64)
    basis = np.empty(4)
    height, width = image.shape
    count = rhs.shape[1]
    for k in range(stations.points.shape[0]):
        shift, gain, offset = states[k, 0], states[k, 1], states[k, 2]
        if not np.isfinite(shift + gain + offset):
            continue
        tx, ty = stations.tangents[k, 0], stations.tangents[k, 1]
        px, py = stations.points[k, 0] - shift * ty, stations.points[k, 1] + shift * tx
        along, across = stations.half_along[k], stations.half_across[k]
        bend = 0.5 * stations.curvature[k]
        _box(px, py, tx, ty, along, across, box)
        for row in range(max(box[2], 0), min(box[3], height - 1) + 1):
            y = row - py
            for column in range(max(box[0], 0), min(box[1], width - 1) + 1):
                x = column - px
                u = x * tx + y * ty
                v = y * tx - x * ty - bend * u * u
                level = float(image[row, column])
                if u < -along or u >= along or v < -across or v > across or level >= camera[2]:
                    continue
                at = (v - first) / step
                j = int(np.floor(at))
                if j < 1 or j > count - 3:
                    continue
                f = at - j
                g = 1.0 - f
                basis[0] = g * g * g / 6.0
                basis[1] = (4.0 - 6.0 * f * f + 3.0 * f * f * f) / 6.0
                basis[2] = (4.0 - 6.0 * g * g + 3.0 * g * g * g) / 6.0
                basis[3] = f * f * f / 6.0
                weight = gain * gain / max(camera[0] + camera[1] * level, 1e-6)
                value = (level - offset) / gain
                for q in range(rhs.shape[0]):
                    part = weight * weights[q, k]
                    if part == 0.0:
                        continue
                    for a in range(4):
                        rhs[q, j - 1 + a] += part * basis[a] * value
                        for b in range(a, 4):
                            normal[q, j - 1 + a, b - a] += part * basis[a] * basis[b]
