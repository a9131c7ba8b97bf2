"""Registration kernel of a line: Gauss-Newton fit of the profile across it to the pixels of each station."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit
from numba.extending import register_jitable
from numpy.typing import NDArray

from tracker.acceptance import TUNING as ACCEPTANCE
from tracker.arrays import FloatArray, GrayImage


@dataclass(frozen=True)
class Tuning:
    """Convergence of the fit of a station."""

    #: [steps] a fit that needs more has failed
    max_iterations: int = 12
    #: [px] a step below it is the last
    #: physics: the error after a step e is of order e^3 over the blur squared: the term in e^2 vanishes over a whole
    #: profile
    step_tolerance_px: float = 0.03
    #: [px] largest effect of a change of the gain on the displacement after the last step
    #: physics: a wrong gain scales the step by its relative error; this is an eighth of a usual sd (0.008 px)
    gain_tolerance_px: float = 1e-3
    #: [px] longest step taken at once
    #: convention: the gradients of a blurred edge are not valid farther from it
    largest_step_px: float = 1.0
    #: [pixels] without which a station is not fitted
    least_pixels: int = 8
    #: [px] beyond the window, up to which pixels are collected
    #: physics: saves collecting them again for each step; a displacement beyond it needs others, so that it changes no
    #: result
    margin_px: float = 1.5
    #: [px] path during the exposure below which blur is not modelled
    #: physics: the sd grows by less than 1 %
    least_blur_px: float = 0.2


TUNING = Tuning()
# Frozen into compiled code.
MAX_ITERATIONS = TUNING.max_iterations
STEP_TOLERANCE_PX = TUNING.step_tolerance_px
GAIN_TOLERANCE_PX = TUNING.gain_tolerance_px
LARGEST_STEP_PX = TUNING.largest_step_px
LEAST_PIXELS = TUNING.least_pixels
MARGIN_PX = TUNING.margin_px
LEAST_BLUR_PX = TUNING.least_blur_px
FARTHEST_PX = ACCEPTANCE.farthest_px

# State of a station: displacement along the normal in px, gain, offset.
STATE = 3
# Result: state, sd of the displacement, chi-square per degree of freedom, pixels used, share of the window in the
# image, share of saturated pixels, signal (chi-square of the profile itself against a uniform image, per degree of
# freedom), whether the fit converged, mean distance of the pixels along the line from the station, in px, weighted by
# what they tell of the displacement, change of the displacement with an error of gain and of offset, its sd with both
# known.
RESULT = 14
SHIFT, GAIN, OFFSET, SD, CHI2, PIXELS, SEEN, SATURATED, SIGNAL, CONVERGED, ALONG = range(RESULT - 3)
BY_GAIN, BY_OFFSET, SD_KNOWN = range(RESULT - 3, RESULT)

# Compiler options under which sums may be evaluated in any order.
REORDER = {"contract", "reassoc"}


class Profiles(NamedTuple):
    """Profile across the line at m stations: uniform cubic B-splines in gray levels.

    `coefs` (m, j); the first coefficient is centred at `first_px` across the line, the next ones `step_px` apart.
    `polynomials` (m, j, 4) are those of the profiles without motion blur.
    """

    coefs: FloatArray
    polynomials: FloatArray
    first_px: float
    step_px: float


class Background(NamedTuple):
    """Still background behind a strip: what it adds to the profile where the strip does not cover it.

    `texture` (height, width) in gray levels about the profile's background, of shape (0, 0) where there is none. The
    share of it that is seen is `uncovered[0] + uncovered[1] * P` where the profile is P: 1 beside the strip.
    """

    texture: NDArray[np.float32]
    uncovered: FloatArray


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


@register_jitable(error_model="numpy")
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
def box_around(
    px: float, py: float, tx: float, ty: float, along: float, across: float, box: NDArray[np.int64]
) -> None:
    """First and last column and row of the pixels of a window."""
    half_x = abs(tx) * along + abs(ty) * across
    half_y = abs(ty) * along + abs(tx) * across
    box[0], box[1] = int(np.ceil(px - half_x)), int(np.floor(px + half_x))
    box[2], box[3] = int(np.ceil(py - half_y)), int(np.floor(py + half_y))


@register_jitable(error_model="numpy")
def _collect(
    image: GrayImage,
    texture: NDArray[np.float32],
    stations: Stations,
    k: int,
    shift: float,
    pixels: FloatArray,
) -> int:
    """Pixels along a station within `MARGIN_PX` of its window; returns their number.

    Rows of `pixels`: offset across from the undisplaced line, gray level (-1 outside the image), texture behind the
    strip, distance along the line. A displacement along the normal leaves the place along the line unchanged: they
    serve several steps of a fit.
    """
    box = np.empty(4, dtype=np.int64)
    tx, ty = stations.tangents[k, 0], stations.tangents[k, 1]
    px, py = stations.points[k, 0] - shift * ty, stations.points[k, 1] + shift * tx
    along, across = stations.half_along[k], stations.half_across[k] + MARGIN_PX
    bend = 0.5 * stations.curvature[k]
    box_around(px, py, tx, ty, along, across, box)
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
            inside = row >= 0 and column >= 0 and row < height and column < width
            pixels[0, count] = v + shift
            pixels[1, count] = float(image[row, column]) if inside else -1.0
            pixels[2, count] = texture[row, column] if inside and texture.size else 0.0
            pixels[3, count] = u
            count += 1
    return count


@njit(cache=True, nogil=True, error_model="numpy")
def polynomials_of(coefs: FloatArray, out: FloatArray) -> None:
    """Polynomials of a cubic B-spline, (j, 4), each in the distance from its coefficient in steps, 0 to 1."""
    for j in range(1, coefs.size - 2):
        c0, c1, c2, c3 = coefs[j - 1], coefs[j], coefs[j + 1], coefs[j + 2]
        out[j, 0] = (c0 + 4.0 * c1 + c2) / 6.0
        out[j, 1] = 0.5 * (c2 - c0)
        out[j, 2] = 0.5 * (c0 - 2.0 * c1 + c2)
        out[j, 3] = (c3 - 3.0 * c2 + 3.0 * c1 - c0) / 6.0


@register_jitable(error_model="numpy")
def station_polynomials(
    profiles: Profiles, k: int, blur_px: float, blurred: FloatArray, scratch: FloatArray
) -> FloatArray:
    """Polynomials of a station's profile with motion blur; `blurred` (j,) and `scratch` (j, 4) may be overwritten."""
    polynomials: FloatArray = profiles.polynomials[k]
    if blur_px >= LEAST_BLUR_PX:
        _blurred(profiles.coefs[k], blur_px / profiles.step_px, blurred)
        polynomials_of(blurred, scratch)
        polynomials = scratch
    return polynomials


@njit(cache=True, nogil=True, error_model="numpy")
def profile_value(polynomials: FloatArray, at: float) -> float:
    """Value of a profile at a distance from its first coefficient in steps."""
    last = polynomials.shape[0] - 3
    inside = min(max(at, 1.0), last + 1.0)
    j = min(int(inside), last)
    f = inside - j
    a, b, c, d = polynomials[j, 0], polynomials[j, 1], polynomials[j, 2], polynomials[j, 3]
    return float(a + f * (b + f * (c + f * d)))


# Sums in any order, so that the loop is vectorised.
@register_jitable(error_model="numpy", fastmath=REORDER)
def _sums(
    pixels: FloatArray,
    count: int,
    across: float,
    state: FloatArray,
    polynomials: FloatArray,
    first: float,
    step: float,
    camera: FloatArray,
    uncovered: FloatArray,
    out: FloatArray,
) -> None:
    """Sums over the pixels of a station.

    9 of the normal equations, chi-square, pixels used, expected, saturated, and distances along the line with the
    weights of the displacement.
    """
    shift, gain, offset = state[0], state[1], state[2]
    scale = 1.0 / step
    last = polynomials.shape[0] - 3
    read, noise_gain, white = camera[0], camera[1], camera[2]
    dd = dp = d1 = pp = p1 = ww = dr = pr = wr = rr = 0.0
    used = expected = saturated = du = 0.0
    for i in range(count):
        v, level = pixels[0, i] - shift, pixels[1, i]
        seen, lift = uncovered[0] * pixels[2, i], 1.0 + uncovered[1] * pixels[2, i]
        inside = 1.0 if abs(v) <= across else 0.0
        bright = inside if level >= white else 0.0
        good = inside - bright if level >= 0.0 else 0.0
        at = min(max((v - first) * scale, 1.0), last + 1.0)
        j = min(int(at), last)
        f = at - j
        a, b, c, d = polynomials[j, 0], polynomials[j, 1], polynomials[j, 2], polynomials[j, 3]
        value = seen + lift * (a + f * (b + f * (c + f * d)))
        model = gain * value + offset
        weight = good / max(read + noise_gain * max(model, 0.0), 1e-6)
        rest = level - model
        slope = -gain * scale * lift * (b + f * (2.0 * c + 3.0 * f * d))
        expected += inside
        saturated += bright
        used += good
        dd += weight * slope * slope
        du += weight * slope * slope * pixels[3, i]
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
    out[10], out[11], out[12], out[13] = used, expected, saturated, du


@register_jitable(error_model="numpy")
def _register_station(
    image: GrayImage,
    stations: Stations,
    k: int,
    polynomials: FloatArray,
    first: float,
    step: float,
    camera: FloatArray,
    background: Background,
    start: FloatArray,
    max_shift: float,
    pixels: FloatArray,
    result: FloatArray,
) -> None:
    sums = np.empty(14)
    state = start.copy()
    texture, uncovered, across = background.texture, background.uncovered, stations.half_across[k]
    collected, count = state[SHIFT], _collect(image, texture, stations, k, state[SHIFT], pixels)
    for _ in range(MAX_ITERATIONS):
        if abs(state[SHIFT] - collected) > MARGIN_PX:
            collected, count = state[SHIFT], _collect(image, texture, stations, k, state[SHIFT], pixels)
        _sums(pixels, count, across, state, polynomials, first, step, camera, uncovered, sums)
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
        result[ALONG] = sums[13] / sums[0]
        result[BY_GAIN], result[BY_OFFSET] = sums[1] / sums[0], sums[2] / sums[0]
        result[SD_KNOWN] = 1.0 / np.sqrt(sums[0])
        taken = min(max(shift, -LARGEST_STEP_PX), LARGEST_STEP_PX)
        state[0] += taken
        state[1] += gain
        state[2] += offset
        # Also rejects NaN.
        if not abs(state[0] - start[0]) <= max_shift:
            return
        # A wrong gain scales the step by its relative error.
        if abs(shift) < STEP_TOLERANCE_PX and abs(shift * gain) < GAIN_TOLERANCE_PX * abs(state[1]):
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
    background: Background,
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
    results : array, shape (m, 14)
        Filled; see the names of the columns in this module. NaN where the fit failed.

    Notes
    -----
    The image is never interpolated: that would correlate its noise and bias positions towards pixel centres. No pixel
    belongs to two stations, so that their errors are independent for white noise.
    """
    blurred = np.empty(profiles.coefs.shape[1])
    scratch = np.zeros((blurred.size, 4))
    # A window in any direction has at most the pixels of the square around it.
    side = 2 * int(np.max(np.hypot(stations.half_along, stations.half_across + MARGIN_PX))) + 3
    pixels = np.empty((4, side * side))
    for k in range(stations.points.shape[0]):
        for i in range(RESULT):
            results[k, i] = np.nan
        results[k, CONVERGED] = 0.0
        finite = np.isfinite(states[k, 0] + states[k, 1] + states[k, 2])
        if not (finite and np.isfinite(stations.points[k, 0] + stations.points[k, 1])):
            continue
        if not abs(stations.points[k, 0]) + abs(stations.points[k, 1]) < FARTHEST_PX:
            continue
        polynomials = station_polynomials(profiles, k, stations.blur[k], blurred, scratch)
        _register_station(
            image,
            stations,
            k,
            polynomials,
            profiles.first_px,
            profiles.step_px,
            camera,
            background,
            states[k],
            max_shift,
            pixels,
            results[k],
        )


EPS = float(np.finfo(np.float64).eps)


@njit(cache=True, nogil=True, error_model="numpy")
def solve_in_place(normal: FloatArray, rhs: FloatArray, out: FloatArray) -> bool:
    """Solution of a positive definite system by Cholesky decomposition in place, of its lower triangle.

    Parameters
    ----------
    normal : array, shape (n, n)
        The matrix, whose lower triangle is replaced by its factor.
    rhs : array, shape (n,)
    out : array, shape (n,)
        Filled.

    Returns
    -------
    bool
        False where the matrix is singular to machine precision. `out` is then finite, from pivots of at least 1e-12,
        and of use only where any solution will do. NaN in `normal` or `rhs` gives NaN and True.

    Notes
    -----
    A pivot is the difference of n products of its size: one below 4 n eps times its diagonal entry is rounding (Higham
    2002, Accuracy and Stability of Numerical Algorithms, theorem 10.3). `numpy.linalg.solve` would take numba 6 s to
    compile.
    """
    size = out.size
    regular = True
    for i in range(size):
        for j in range(i + 1):
            total = normal[i, j]
            for k in range(j):
                total -= normal[i, k] * normal[j, k]
            if i == j:
                regular = regular and not total <= 4.0 * size * EPS * normal[i, i]
                normal[i, i] = np.sqrt(max(total, 1e-12))
            else:
                normal[i, j] = total / normal[j, j]
    for i in range(size):
        total = rhs[i]
        for k in range(i):
            total -= normal[i, k] * out[k]
        out[i] = total / normal[i, i]
    for i in range(size - 1, -1, -1):
        total = out[i]
        for k in range(i + 1, size):
            total -= normal[k, i] * out[k]
        out[i] = total / normal[i, i]
    return regular
