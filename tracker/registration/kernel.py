"""The registration kernel: forward-additive Gauss-Newton of a template against untouched pixels."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tracker.series import FloatArray
from tracker.source import GrayImage

# State of a marker in a frame: x_px, y_px, angle_rad, gain, offset.
STATE = 5
# Result: state, sd_x, sd_y, chi-square per degree of freedom, pixels used, share of the support in the
# picture, saturated pixels, iterations, whether it converged, signal (the template's own chi-square against
# a flat picture, per degree of freedom).
RESULT = 14
(
    X,
    Y,
    ANGLE,
    GAIN,
    OFFSET,
    SD_X,
    SD_Y,
    CHI2,
    PIXELS,
    SEEN,
    SATURATED,
    ITERATIONS,
    CONVERGED,
    SIGNAL,
) = range(RESULT)

MAX_ITERATIONS = 20
# A last step below this leaves an error of its square times the relative curvature: under 1e-3 px.
STEP_TOLERANCE_PX = 0.02


@njit(cache=True, nogil=True)
def _solve(normal: FloatArray, rhs: FloatArray, size: int, inverse: FloatArray) -> bool:  # noqa: C901, PLR0912 - one loop nest
    """Solve by Cholesky and give the inverse; False when the matrix is not positive definite."""
    lower = np.zeros((size, size))
    for i in range(size):
        for j in range(i + 1):
            total = normal[i, j]
            for k in range(j):
                total -= lower[i, k] * lower[j, k]
            if i == j:
                if total <= 1e-12 * normal[i, i] or total <= 0.0:
                    return False
                lower[i, i] = np.sqrt(total)
            else:
                lower[i, j] = total / lower[j, j]
    for column in range(size):
        for i in range(size):
            total = 1.0 if i == column else 0.0
            for k in range(i):
                total -= lower[i, k] * inverse[k, column]
            inverse[i, column] = total / lower[i, i]
        for i in range(size - 1, -1, -1):
            total = inverse[i, column]
            for k in range(i + 1, size):
                total -= lower[k, i] * inverse[k, column]
            inverse[i, column] = total / lower[i, i]
    for i in range(size):
        total = 0.0
        for k in range(size):
            total += inverse[i, k] * rhs[k]
        rhs[size + i] = total
    return True


@njit(cache=True, nogil=True)
def _accumulate(  # noqa: PLR0915 - one pass over the pixels, unrolled for speed
    image: GrayImage,
    state: FloatArray,
    warp: FloatArray,
    coefs: FloatArray,
    support: NDArray[np.uint8],
    oversampling: float,
    reach: float,
    stride: int,
    noise: FloatArray,
    saturation: float,
    order: int,
    normal: FloatArray,
    rhs: FloatArray,
    counts: FloatArray,
) -> float:
    """Normal equations of one Gauss-Newton step; order of unknowns x, y, gain, offset, angle."""
    height, width = image.shape
    rows, cols = coefs.shape
    x, y, gain, offset = state[0], state[1], state[3], state[4]
    cosine, sine = np.cos(state[2]), np.sin(state[2])
    # Rotation by -angle after the warp that leads from the picture to the marker's frame.
    a00 = cosine * warp[0, 0] + sine * warp[1, 0]
    a01 = cosine * warp[0, 1] + sine * warp[1, 1]
    a10 = -sine * warp[0, 0] + cosine * warp[1, 0]
    a11 = -sine * warp[0, 1] + cosine * warp[1, 1]
    u0, v0 = 0.5 * (cols - 1), 0.5 * (rows - 1)
    normal[:] = 0.0
    rhs[:] = 0.0
    chi2 = 0.0
    used = 0
    saturated = 0
    expected = 0
    # Bounding box in the picture of what the grid covers.
    det = a00 * a11 - a01 * a10
    half_x = min(reach, (abs(a11) * u0 + abs(a01) * v0) / (abs(det) * oversampling))
    half_y = min(reach, (abs(a10) * u0 + abs(a00) * v0) / (abs(det) * oversampling))
    top, bottom = int(np.floor(y - half_y)), int(np.ceil(y + half_y))
    left, right = int(np.floor(x - half_x)), int(np.ceil(x + half_x))
    jacobian = np.empty(5)
    wu = np.empty(4)
    du = np.empty(4)
    wv = np.empty(4)
    dv = np.empty(4)
    for j in range(top, bottom + 1, stride):
        for i in range(left, right + 1, stride):
            px = i - x
            py = j - y
            u = a00 * px + a01 * py
            v = a10 * px + a11 * py
            gu = u * oversampling + u0
            gv = v * oversampling + v0
            iu = int(np.floor(gu))
            iv = int(np.floor(gv))
            if iu < 1 or iv < 1 or iu > cols - 3 or iv > rows - 3:
                continue
            if support[int(gv + 0.5), int(gu + 0.5)] == 0:
                continue
            expected += 1
            if i < 0 or j < 0 or i >= width or j >= height:
                continue
            t = gu - iu
            s = 1.0 - t
            wu[0] = s * s * s / 6.0
            wu[1] = (4.0 - 6.0 * t * t + 3.0 * t * t * t) / 6.0
            wu[2] = (4.0 - 6.0 * s * s + 3.0 * s * s * s) / 6.0
            wu[3] = t * t * t / 6.0
            du[0] = -0.5 * s * s
            du[1] = -2.0 * t + 1.5 * t * t
            du[2] = 2.0 * s - 1.5 * s * s
            du[3] = 0.5 * t * t
            t = gv - iv
            s = 1.0 - t
            wv[0] = s * s * s / 6.0
            wv[1] = (4.0 - 6.0 * t * t + 3.0 * t * t * t) / 6.0
            wv[2] = (4.0 - 6.0 * s * s + 3.0 * s * s * s) / 6.0
            wv[3] = t * t * t / 6.0
            dv[0] = -0.5 * s * s
            dv[1] = -2.0 * t + 1.5 * t * t
            dv[2] = 2.0 * s - 1.5 * s * s
            dv[3] = 0.5 * t * t
            value = 0.0
            slope_u = 0.0
            slope_v = 0.0
            for k in range(4):
                r = iv - 1 + k
                c0 = coefs[r, iu - 1]
                c1 = coefs[r, iu]
                c2 = coefs[r, iu + 1]
                c3 = coefs[r, iu + 2]
                along = wu[0] * c0 + wu[1] * c1 + wu[2] * c2 + wu[3] * c3
                value += wv[k] * along
                slope_u += wv[k] * (du[0] * c0 + du[1] * c1 + du[2] * c2 + du[3] * c3)
                slope_v += dv[k] * along
            model = gain * value + offset
            pixel = float(image[j, i])
            if pixel >= saturation or model >= saturation:
                saturated += 1
                continue
            gu_slope = gain * oversampling * slope_u
            gv_slope = gain * oversampling * slope_v
            jacobian[0] = -(gu_slope * a00 + gv_slope * a10)
            jacobian[1] = -(gu_slope * a01 + gv_slope * a11)
            jacobian[2] = value
            jacobian[3] = 1.0
            jacobian[4] = gu_slope * v - gv_slope * u
            residual = pixel - model
            weight = 1.0 / (noise[0] + noise[1] * max(model, 0.0))
            chi2 += weight * residual * residual
            used += 1
            for p in range(order):
                wj = weight * jacobian[p]
                rhs[p] += wj * residual
                for q in range(p + 1):
                    normal[p, q] += wj * jacobian[q]
    counts[0] = used
    counts[1] = expected
    counts[2] = saturated
    return chi2


@njit(cache=True, nogil=True)
def register(
    image: GrayImage,
    start: FloatArray,
    warp: FloatArray,
    coefs: FloatArray,
    support: NDArray[np.uint8],
    oversampling: float,
    reach: float,
    stride: int,
    noise: FloatArray,
    saturation: float,
    with_angle: bool,  # noqa: FBT001 - numba takes no keyword-only arguments cheaply
    max_shift: float,
    result: FloatArray,
) -> None:
    """Fit position, gain, offset and, if asked, angle of a template to the pixels of a frame.

    Parameters
    ----------
    image : uint8 or uint16 array, shape (height, width)
    start : array, shape (5,)
        x_px, y_px, angle_rad, gain, offset.
    warp : array, shape (2, 2)
        From the picture to the marker's frame at angle 0.
    coefs, support, oversampling :
        Of `tracker.registration.template.Template`.
    reach : float
        Pixels farther than this from the centre, in x or y, are not looked at.
    stride : int
        Every so many-th pixel in x and y is looked at: 1 but for large markers.
    noise : array, shape (2,)
        Variance a + b I of a pixel of intensity I: gray levels squared, gray levels.
    saturation : float
        Pixels at or above it are left out.
    with_angle : bool
    max_shift : float
        The fit gives up when it moves farther than this from the start, in px.
    result : array, shape (14,)
        Filled; see the names of the columns in this module. NaN positions where the fit failed.

    Notes
    -----
    The frame is never interpolated: doing so correlates its noise and draws positions to pixel centres.
    The standard deviations are those of the inverse information matrix, with the other unknowns free.
    """
    order = 5 if with_angle else 4
    state = start.copy()
    normal = np.zeros((5, 5))
    inverse = np.zeros((5, 5))
    rhs = np.zeros(10)
    counts = np.zeros(3)
    result[:] = np.nan
    result[CONVERGED] = 0.0
    for iteration in range(MAX_ITERATIONS):
        chi2 = _accumulate(
            image,
            state,
            warp,
            coefs,
            support,
            oversampling,
            reach,
            stride,
            noise,
            saturation,
            order,
            normal,
            rhs,
            counts,
        )
        result[PIXELS] = counts[0]
        result[SEEN] = counts[0] / max(counts[1] - counts[2], 1.0)
        result[SATURATED] = counts[2]
        result[ITERATIONS] = iteration + 1
        if counts[0] < order + 8:
            return
        if not _solve(normal, rhs, order, inverse):
            return
        gained = 0.0
        for p in range(order):
            gained += rhs[p] * rhs[order + p]
        # A step of more than 1.5 px leaves the region where the slope at the start says anything.
        longest = max(abs(rhs[order]), abs(rhs[order + 1]))
        damping = min(1.0, 1.5 / longest) if longest > 0.0 else 1.0
        state[0] += damping * rhs[order]
        state[1] += damping * rhs[order + 1]
        state[3] += rhs[order + 2]
        state[4] += rhs[order + 3]
        turn = 0.0
        if with_angle:
            turn = min(max(rhs[order + 4], -0.2), 0.2)
            state[2] += turn
        if abs(state[0] - start[0]) > max_shift or abs(state[1] - start[1]) > max_shift:
            return
        if longest < STEP_TOLERANCE_PX and abs(turn) * min(reach, 30.0) < 2.0 * STEP_TOLERANCE_PX:
            result[CHI2] = max(chi2 - gained, 0.0) / (counts[0] - order)
            spread = normal[2, 2] - normal[3, 2] ** 2 / normal[3, 3]
            result[SIGNAL] = state[3] ** 2 * spread / (counts[0] - order)
            result[SD_X] = np.sqrt(inverse[0, 0])
            result[SD_Y] = np.sqrt(inverse[1, 1])
            for p in range(5):
                result[p] = state[p]
            result[CONVERGED] = 1.0
            return
