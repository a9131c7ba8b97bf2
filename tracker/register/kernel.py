"""Registration kernel: forward-additive Gauss-Newton fit of a template to the pixels, and its acceptance."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit
from numba.extending import register_jitable
from numpy.typing import NDArray

from tracker.acceptance import TUNING as ACCEPTANCE
from tracker.arrays import FloatArray
from tracker.register.sampling import (
    BAND_PIXELS,
    CLIPPED,
    EXPECTED,
    SUMS,
    USED,
    Picture,
    PixelBuffers,
    add_up,
    fill_pixels,
    fill_positions,
    fill_template,
    make_pixel_buffers,
)


@dataclass(frozen=True)
class Tuning:
    """Convergence of a fit, and when it is accepted as the marker."""

    #: [steps] a fit that needs more has failed
    max_iterations: int = 20
    #: [px] a step below it is the last
    #: physics: the error after a last step e is of order e^3 over the blur squared, because the term in e^2 integrates
    #: to zero over a whole marker: 2e-4 px and less
    step_tolerance_px: float = 0.05
    #: [px] the same for steps that are halved
    #: physics: these shrink by about a half each, so that the error after the last one is as large as that step
    halved_step_tolerance_px: float = 0.005
    #: [px] largest effect of a change of the gain on the position after the last step
    #: physics: a wrong gain scales the step by its relative error; this is a fifth of the sd of a code of 24 px (0.0028
    #: px)
    gain_tolerance_px: float = 5e-4
    #: [steps] from this step on, one against the previous one is halved, with all that follow
    reversals_from: int = 3
    #: [px] longest step taken at once
    #: convention: the gradients of an edge blurred by lens and pixel are not valid farther from it
    longest_step_px: float = 1.5
    #: [rad] largest change of the angle in one step
    largest_turn_rad: float = 0.2
    #: [px] largest distance from the centre at which a last turn is judged by the tolerance
    turning_reach_px: float = 30.0
    #: [pixels] a fit needs this many pixels more than unknowns
    least_spare_pixels: int = 8
    #: [1] share of the template's support that must lie in the image
    least_seen_share: float = 0.45
    #: [1] smallest gain relative to that of the last good fit
    #: convention: light and blur change the contrast by less from frame to frame
    least_gain_ratio: float = 0.3


TUNING = Tuning()
# Frozen into compiled code.
MAX_ITERATIONS = TUNING.max_iterations
STEP_TOLERANCE_PX = TUNING.step_tolerance_px
HALVED_STEP_TOLERANCE_PX = TUNING.halved_step_tolerance_px
GAIN_TOLERANCE_PX = TUNING.gain_tolerance_px
REVERSALS_FROM = TUNING.reversals_from
FARTHEST_PX = ACCEPTANCE.farthest_px
LONGEST_STEP_PX = TUNING.longest_step_px
LARGEST_TURN_RAD = TUNING.largest_turn_rad
TURNING_REACH_PX = TUNING.turning_reach_px
LEAST_SPARE_PIXELS = TUNING.least_spare_pixels
LEAST_CORRELATION = ACCEPTANCE.least_correlation
GOOD_CHI2 = ACCEPTANCE.good_chi2
LEAST_SIGNAL = ACCEPTANCE.least_signal
LEAST_SEEN_SHARE = TUNING.least_seen_share
LEAST_GAIN_RATIO = TUNING.least_gain_ratio
LARGEST_GAIN_RATIO = ACCEPTANCE.largest_gain_ratio

# State of a marker in a frame: x_px, y_px, angle_rad, gain, offset.
STATE = 5
# Result: state, sd_x, sd_y, chi-square per degree of freedom, pixels used, share of the support in the image, saturated
# pixels, iterations, whether it converged, signal (chi-square of the template itself against a uniform image, per
# degree of freedom), share of uneven light in the position (see `tracker.register.poor_fit`).
RESULT = 15
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
    LIGHT,
) = range(RESULT)


class Grid(NamedTuple):
    """A template for compiled code, and which pixels are fitted: its `grid`, oversampling, reach in px and stride.

    Pixels farther than `reach` from the centre, in x or y, are not used; `stride` is the spacing of the used pixels,
    1 except for large markers.
    """

    coefs: NDArray[np.float32]
    support: NDArray[np.uint8]
    oversampling: float
    reach: float
    stride: int


class Pixels(NamedTuple):
    """Variance a + b I of a pixel of intensity I, shape (2,), and the level from which pixels are excluded."""

    noise: FloatArray
    saturation: float


Workspace = tuple[PixelBuffers, FloatArray, NDArray[np.int64], NDArray[np.int64], FloatArray]


@njit(cache=True, nogil=True)
def make_workspace() -> Workspace:
    """Working memory for `register`: pixels, matrix to the grid, box of pixels, the part of it at work, and sums."""
    return (
        # no literal, for which numba would compile the function again
        make_pixel_buffers(np.int64(BAND_PIXELS)),
        np.empty((2, 2)),
        np.empty(5, dtype=np.int64),
        np.empty(5, dtype=np.int64),
        np.empty(SUMS),
    )


@njit(cache=True, nogil=True, error_model="numpy")
def solve(normal: FloatArray, rhs: FloatArray, size: int, inverse: FloatArray) -> bool:  # noqa: C901, PLR0912 - one loop nest
    """Solution and inverse by Cholesky decomposition; False when the matrix is not positive definite."""
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


@register_jitable(error_model="numpy")
def _grid_matrix(angle: float, warp: FloatArray, oversampling: float, matrix: FloatArray) -> None:
    """From the image to the grid: rotation by -angle after the warp to the marker's frame."""
    cosine, sine = np.cos(angle), np.sin(angle)
    for c in range(2):
        matrix[0, c] = (cosine * warp[0, c] + sine * warp[1, c]) * oversampling
        matrix[1, c] = (-sine * warp[0, c] + cosine * warp[1, c]) * oversampling


@register_jitable(error_model="numpy")
def _box(
    state: FloatArray,
    matrix: FloatArray,
    shape: tuple[int, int],
    reach: float,
    stride: int,
    box: NDArray[np.int64],
) -> bool:
    """Pixels covered by the grid: first column, columns, first row, rows, stride; False without any."""
    u0, v0 = 0.5 * (shape[1] - 1), 0.5 * (shape[0] - 1)
    det = abs(matrix[0, 0] * matrix[1, 1] - matrix[0, 1] * matrix[1, 0])
    half_x = min(reach, (abs(matrix[1, 1]) * u0 + abs(matrix[0, 1]) * v0) / det)
    half_y = min(reach, (abs(matrix[1, 0]) * u0 + abs(matrix[0, 0]) * v0) / det)
    # Written so that NaN is rejected too: it would be read outside the grid.
    if not (abs(state[0]) + half_x < FARTHEST_PX and abs(state[1]) + half_y < FARTHEST_PX):
        return False
    left, top = int(np.floor(state[0] - half_x)), int(np.floor(state[1] - half_y))
    box[0], box[1] = left, (int(np.ceil(state[0] + half_x)) - left) // stride + 1
    box[2], box[3] = top, (int(np.ceil(state[1] + half_y)) - top) // stride + 1
    box[4] = stride
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def place(state: FloatArray, warp: FloatArray, template: Grid, workspace: Workspace) -> bool:
    """Fill the matrix to the grid and the box of pixels in `workspace`; False without any pixel."""
    _, matrix, box, _, _ = workspace
    _grid_matrix(state[2], warp, template.oversampling, matrix)
    return _box(state, matrix, template.support.shape, template.reach, template.stride, box)


@register_jitable(error_model="numpy")
def _normal_equations(
    sums: FloatArray, gain: float, matrix: FloatArray, normal: FloatArray, rhs: FloatArray
) -> None:
    """Normal equations of x, y, gain, offset and angle from sums along the grid's axes."""
    # Derivatives by x and y: -gain (a00 p + a10 q) and -gain (a01 p + a11 q).
    g0, h0, g1, h1 = -gain * matrix[0, 0], -gain * matrix[1, 0], -gain * matrix[0, 1], -gain * matrix[1, 1]
    pp, pq, qq, pv, qv = sums[1], sums[2], sums[3], sums[4], sums[5]
    vv, po, qo, vo, oo = sums[6], sums[7], sums[8], sums[9], sums[10]
    pt, qt, vt, ot, tt = sums[11], sums[12], sums[13], sums[14], sums[15]
    rp, rq, rv, ro, rt = sums[16], sums[17], sums[18], sums[19], sums[20]
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


@njit(cache=True, nogil=True, error_model="numpy")
def _accumulate(
    image: Picture,
    state: FloatArray,
    warp: FloatArray,
    template: Grid,
    camera: Pixels,
    workspace: Workspace,
    normal: FloatArray,
    rhs: FloatArray,
) -> FloatArray:
    """Normal equations of one Gauss-Newton step, and the sums they are built from."""
    buffers, matrix, box, part, sums = workspace
    sums.fill(0.0)
    if not place(state, warp, template, workspace):
        return sums
    shape, stride = template.support.shape, template.stride
    for i in range(5):
        part[i] = box[i]
    # Bands of whole rows that fit the buffers, at least one row.
    at_once = max(BAND_PIXELS // box[1], 1)
    if box[1] > buffers[1].size:
        buffers = make_pixel_buffers(box[1])
    done = 0
    while done < box[3]:
        part[2] = box[2] + done * stride
        part[3] = min(at_once, box[3] - done)
        pixels = part[1] * part[3]
        table, cell, nearest, columns, marks = buffers
        fill_positions(state, matrix, part, shape, table, cell, nearest)
        fill_pixels(image, part, table)
        fill_template(template.coefs, template.support, cell, nearest, pixels, columns, marks, table)
        add_up(table, pixels, state[3], state[4], camera.noise, camera.saturation, sums)
        done += part[3]
    _normal_equations(sums, state[3], matrix, normal, rhs)
    return sums


@register_jitable(error_model="numpy")
def _step(state: FloatArray, rhs: FloatArray, order: int, reach: float, share: float) -> bool:
    """Take a share of the step within the validity of the gradients; whether it is short enough to be the last."""
    longest = max(abs(rhs[order]), abs(rhs[order + 1]))
    damping = min(share, LONGEST_STEP_PX / longest) if longest > 0.0 else share
    state[0] += damping * rhs[order]
    state[1] += damping * rhs[order + 1]
    state[3] += rhs[order + 2]
    state[4] += rhs[order + 3]
    rotation = 0.0
    if order == STATE:
        rotation = min(max(rhs[order + 4], -LARGEST_TURN_RAD), LARGEST_TURN_RAD)
        state[2] += rotation
    # A wrong gain scales the step by its relative error.
    stretched = longest * abs(rhs[order + 2]) < GAIN_TOLERANCE_PX * abs(state[3])
    short = longest < (STEP_TOLERANCE_PX if share == 1.0 else HALVED_STEP_TOLERANCE_PX) and stretched
    return bool(short and abs(rotation) * min(reach, TURNING_REACH_PX) < 2.0 * STEP_TOLERANCE_PX)


@register_jitable(error_model="numpy")
def _conclude(
    state: FloatArray,
    sums: FloatArray,
    normal: FloatArray,
    inverse: FloatArray,
    rhs: FloatArray,
    order: int,
    result: FloatArray,
) -> None:
    """Fill the result of a converged fit; chi-square is that after the last step."""
    gained = 0.0
    for p in range(order):
        gained += rhs[p] * rhs[order + p]
    dof = sums[USED] - order
    result[CHI2] = max(sums[0] - gained, 0.0) / dof
    spread = normal[2, 2] - normal[3, 2] ** 2 / normal[3, 3]
    result[SIGNAL] = state[3] ** 2 * spread / dof
    result[SD_X] = np.sqrt(inverse[0, 0])
    result[SD_Y] = np.sqrt(inverse[1, 1])
    for p in range(STATE):
        result[p] = state[p]
    result[CONVERGED] = 1.0


@njit(cache=True, nogil=True, error_model="numpy")
def register(
    image: Picture,
    start: FloatArray,
    warp: FloatArray,
    template: Grid,
    camera: Pixels,
    workspace: Workspace,
    with_angle: bool,  # noqa: FBT001 - numba takes no keyword-only arguments cheaply
    max_shift: float,
    result: FloatArray,
) -> None:
    """Fit position, gain, offset and optionally angle of a template to the pixels of a frame.

    Parameters
    ----------
    image : tuple of arrays, shape (height, width)
        From `tracker.register.sampling.picture`.
    start : array, shape (5,)
        x_px, y_px, angle_rad, gain, offset. With a NaN among them the fit fails.
    warp : array, shape (2, 2)
        From the image to the marker's frame at angle 0.
    workspace : tuple
        From `make_workspace`; no content is kept between calls.
    max_shift : float
        The fit fails when it moves farther than this from the start, in px.
    result : array, shape (15,)
        Filled; see the names of the columns in this module. NaN positions where the fit failed.

    Notes
    -----
    The frame is never interpolated: that would correlate its noise and bias positions towards pixel centres.
    The standard deviations are those of the inverse information matrix, with the other unknowns free.
    """
    order = 5 if with_angle else 4
    state = start.copy()
    normal = np.zeros((5, 5))
    inverse = np.zeros((5, 5))
    rhs = np.zeros(10)
    result.fill(np.nan)
    result[CONVERGED] = 0.0
    if not np.all(np.isfinite(state)):
        return
    share, before_x, before_y = 1.0, 0.0, 0.0
    for iteration in range(MAX_ITERATIONS):
        sums = _accumulate(image, state, warp, template, camera, workspace, normal, rhs)
        result[PIXELS] = sums[USED]
        result[SEEN] = sums[USED] / max(sums[EXPECTED] - sums[CLIPPED], 1.0)
        result[SATURATED] = sums[CLIPPED]
        result[ITERATIONS] = iteration + 1
        if sums[USED] < order + LEAST_SPARE_PIXELS or not solve(normal, rhs, order, inverse):
            return
        # Steps back and forth across the minimum, where large residuals curve chi-square more than the gradients say.
        if iteration >= REVERSALS_FROM and rhs[order] * before_x + rhs[order + 1] * before_y < 0.0:
            share *= 0.5
        before_x, before_y = rhs[order], rhs[order + 1]
        converged = _step(state, rhs, order, template.reach, share)
        # Also rejects NaN, as from a step without information.
        if not (abs(state[0] - start[0]) <= max_shift and abs(state[1] - start[1]) <= max_shift):
            return
        if converged:
            _conclude(state, sums, normal, inverse, rhs, order, result)
            return


@njit(cache=True, nogil=True, error_model="numpy")
def correlation(result: FloatArray) -> float:
    """Correlation of pixels and template after a fit, 0 where it failed."""
    if result[CONVERGED] == 0.0:
        return 0.0
    signal, rest = result[SIGNAL], result[CHI2]
    return float(np.sqrt(signal / (signal + rest))) if signal + rest > 0.0 else 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def acceptable(result: FloatArray, gain: float, typical_chi2: float, least: float) -> bool:
    """Whether a fit is the marker; `gain` is that of the last good fit or NaN, `least` the smallest correlation."""
    if result[CONVERGED] == 0.0 or result[SEEN] < LEAST_SEEN_SHARE:
        return False
    # A template without contrast explains a uniform surface perfectly: that is no marker.
    if result[SIGNAL] * result[PIXELS] < LEAST_SIGNAL:
        return False
    if np.isfinite(gain) and not LEAST_GAIN_RATIO < result[GAIN] / gain < LARGEST_GAIN_RATIO:
        return False
    # With low contrast the correlation is low even for a good fit: then the noise decides.
    noise_explains = result[CHI2] < GOOD_CHI2 * typical_chi2 and least <= LEAST_CORRELATION
    return correlation(result) >= least or noise_explains
