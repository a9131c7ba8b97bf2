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
# What a last step e leaves is of order e^3 over the blur squared, as the curvature's part in e^2 integrates to
# nothing over a whole marker: 2e-4 px and less.
STEP_TOLERANCE_PX = 0.05
GAIN_TOLERANCE_PX = 5e-4


@njit(cache=True, nogil=True, error_model="numpy")
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


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _accumulate(  # noqa: PLR0915 - one pass over the pixels, unrolled for speed
    image: GrayImage,
    state: FloatArray,
    warp: FloatArray,
    cells: NDArray[np.float32],
    support: NDArray[np.uint8],
    oversampling: float,
    reach: float,
    stride: int,
    noise: FloatArray,
    saturation: float,
    normal: FloatArray,
    rhs: FloatArray,
    counts: FloatArray,
) -> float:
    """Normal equations of one Gauss-Newton step; order of unknowns x, y, gain, offset, angle."""
    height, width = image.shape
    rows, cols = support.shape
    x, y, gain, offset = state[0], state[1], state[3], state[4]
    cosine, sine = np.cos(state[2]), np.sin(state[2])
    # Rotation by -angle after the warp that leads from the picture to the marker's frame.
    a00 = (cosine * warp[0, 0] + sine * warp[1, 0]) * oversampling
    a01 = (cosine * warp[0, 1] + sine * warp[1, 1]) * oversampling
    a10 = (-sine * warp[0, 0] + cosine * warp[1, 0]) * oversampling
    a11 = (-sine * warp[0, 1] + cosine * warp[1, 1]) * oversampling
    u0, v0 = 0.5 * (cols - 1), 0.5 * (rows - 1)
    chi2 = 0.0
    used = 0
    saturated = 0
    expected = 0
    # Bounding box in the picture of what the grid covers.
    det = abs(a00 * a11 - a01 * a10)
    half_x = min(reach, (abs(a11) * u0 + abs(a01) * v0) / det)
    half_y = min(reach, (abs(a10) * u0 + abs(a00) * v0) / det)
    top, bottom = int(np.floor(y - half_y)), int(np.ceil(y + half_y))
    left, right = int(np.floor(x - half_x)), int(np.ceil(x + half_x))
    last_u, last_v = cols - 3.0, rows - 3.0
    n0, n1 = noise[0], noise[1]
    # Sums in registers: slopes along grid rows (p) and columns (q), turned to the picture's axes at the end.
    pp = pq = qq = pv = qv = pt = qt = po = qo = 0.0
    vv = vo = vt = oo = ot = tt = 0.0
    rp = rq = rv = ro = rt = 0.0
    for j in range(top, bottom + 1, stride):
        py = j - y
        row_u = a01 * py + u0
        row_v = a11 * py + v0
        outside_row = j < 0 or j >= height
        for i in range(left, right + 1, stride):
            px = i - x
            gu = a00 * px + row_u
            gv = a10 * px + row_v
            # As it stands NaN is left out too: it would be read from outside the grid.
            if not (gu >= 1.0 and gv >= 1.0 and gu < last_u and gv < last_v):
                continue
            if support[np.uint32(np.int32(gv + 0.5)), np.uint32(np.int32(gu + 0.5))] == 0:
                continue
            expected += 1
            if outside_row or i < 0 or i >= width:
                continue
            iu = np.uint32(np.int32(gu))
            iv = np.uint32(np.int32(gv))
            c = cells[iv, iu]
            t = np.float32(gu - iu)
            s = np.float32(gv - iv)
            # Horner along the row for each power of s, with the derivative.
            f0 = ((c[12] * t + c[8]) * t + c[4]) * t + c[0]
            f1 = ((c[13] * t + c[9]) * t + c[5]) * t + c[1]
            f2 = ((c[14] * t + c[10]) * t + c[6]) * t + c[2]
            f3 = ((c[15] * t + c[11]) * t + c[7]) * t + c[3]
            t2 = np.float32(2.0) * t
            t3 = np.float32(3.0) * t * t
            d0 = c[12] * t3 + c[8] * t2 + c[4]
            d1 = c[13] * t3 + c[9] * t2 + c[5]
            d2 = c[14] * t3 + c[10] * t2 + c[6]
            d3 = c[15] * t3 + c[11] * t2 + c[7]
            value = float(((f3 * s + f2) * s + f1) * s + f0)
            model = gain * value + offset
            pixel = float(image[j, i])
            if pixel >= saturation or model >= saturation:
                saturated += 1
                continue
            slope_u = float(((d3 * s + d2) * s + d1) * s + d0)
            slope_v = float((np.float32(3.0) * f3 * s + np.float32(2.0) * f2) * s + f1)
            turn = slope_u * (gv - v0) - slope_v * (gu - u0)
            residual = pixel - model
            weight = 1.0 / (n0 + n1 * max(model, 0.0))
            used += 1
            wp = weight * slope_u
            wq = weight * slope_v
            wv = weight * value
            wt = weight * turn
            wr = weight * residual
            chi2 += wr * residual
            pp += wp * slope_u
            pq += wp * slope_v
            qq += wq * slope_v
            pv += wp * value
            qv += wq * value
            vv += wv * value
            po += wp
            qo += wq
            vo += wv
            oo += weight
            pt += wp * turn
            qt += wq * turn
            vt += wv * turn
            ot += wt
            tt += wt * turn
            rp += wr * slope_u
            rq += wr * slope_v
            rv += wr * value
            ro += wr
            rt += wr * turn
    # Derivatives by x and y: -gain (a00 p + a10 q) and -gain (a01 p + a11 q).
    g0, h0, g1, h1 = -gain * a00, -gain * a10, -gain * a01, -gain * a11
    normal[0, 0] = g0 * g0 * pp + 2.0 * g0 * h0 * pq + h0 * h0 * qq
    normal[1, 0] = g0 * g1 * pp + (g0 * h1 + h0 * g1) * pq + h0 * h1 * qq
    normal[1, 1] = g1 * g1 * pp + 2.0 * g1 * h1 * pq + h1 * h1 * qq
    normal[2, 0] = g0 * pv + h0 * qv
    normal[2, 1] = g1 * pv + h1 * qv
    normal[2, 2] = vv
    normal[3, 0] = g0 * po + h0 * qo
    normal[3, 1] = g1 * po + h1 * qo
    normal[3, 2] = vo
    normal[3, 3] = oo
    normal[4, 0] = gain * (g0 * pt + h0 * qt)
    normal[4, 1] = gain * (g1 * pt + h1 * qt)
    normal[4, 2] = gain * vt
    normal[4, 3] = gain * ot
    normal[4, 4] = gain * gain * tt
    rhs[0] = g0 * rp + h0 * rq
    rhs[1] = g1 * rp + h1 * rq
    rhs[2] = rv
    rhs[3] = ro
    rhs[4] = gain * rt
    counts[0] = used
    counts[1] = expected
    counts[2] = saturated
    return chi2


@njit(cache=True, nogil=True, error_model="numpy")
def register(
    image: GrayImage,
    start: FloatArray,
    warp: FloatArray,
    cells: NDArray[np.float32],
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
        x_px, y_px, angle_rad, gain, offset. With a NaN among them nothing is fitted.
    warp : array, shape (2, 2)
        From the picture to the marker's frame at angle 0.
    cells, support, oversampling :
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
    if not np.all(np.isfinite(state)):
        return
    for iteration in range(MAX_ITERATIONS):
        chi2 = _accumulate(
            image,
            state,
            warp,
            cells,
            support,
            oversampling,
            reach,
            stride,
            noise,
            saturation,
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
        # NaN, as from a step without information, is no place to stay at either.
        if not (abs(state[0] - start[0]) <= max_shift and abs(state[1] - start[1]) <= max_shift):
            return
        # A wrong gain stretches the step by its relative error.
        stretched = longest * abs(rhs[order + 2]) < GAIN_TOLERANCE_PX * abs(state[3])
        settled = longest < STEP_TOLERANCE_PX and stretched
        if settled and abs(turn) * min(reach, 30.0) < 2.0 * STEP_TOLERANCE_PX:
            result[CHI2] = max(chi2 - gained, 0.0) / (counts[0] - order)
            spread = normal[2, 2] - normal[3, 2] ** 2 / normal[3, 3]
            result[SIGNAL] = state[3] ** 2 * spread / (counts[0] - order)
            result[SD_X] = np.sqrt(inverse[0, 0])
            result[SD_Y] = np.sqrt(inverse[1, 1])
            for p in range(5):
                result[p] = state[p]
            result[CONVERGED] = 1.0
            return
