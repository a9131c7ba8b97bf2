"""Fits whose residual is no noise: uneven light is fitted, and standard deviations follow from blocks of pixels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numba.extending import register_jitable
from numpy.typing import NDArray

from tracker.arrays import FloatArray
from tracker.register import kernel
from tracker.register.sampling import (
    FROM_U,
    FROM_V,
    PIXEL,
    SEEN,
    SLOPE_U,
    SLOPE_V,
    VALUE,
    WANTED,
    Picture,
    fill_pixels,
    fill_positions,
    fill_template,
    make_pixel_buffers,
)


@dataclass(frozen=True)
class Tuning:
    """When uneven light is fitted with a position, and how far it is believed."""

    #: [1] above this share of chi-square that is left with uneven light, the cause is something else, such as
    #: compression
    #: convention: light must explain about half of the residual: where it always counted, it changed the damping of a
    #: fork by three standard deviations
    least_reduction: float = 0.55
    #: [1] down to this share of chi-square, uneven light is taken for the whole cause
    #: convention: between both shares the weight is linear, since a decision would be a step of the position
    full_reduction: float = 0.47
    #: [1] share of chi-square that a first step must promise
    #: convention: later steps reduce it further; saves time only, effect not measured
    worthwhile: float = 0.75
    #: [frames] memory with which the share of uneven light in the position follows
    #: convention: decisions from frame to frame would be steps of the position; effect of the number not measured
    memory: float = 20.0
    #: [1] smaller shares of uneven light are none
    least_share: float = 0.01
    #: [px^2] smaller windows do not determine the light beside the position
    #: convention: between dots and the smallest patch (31 px)
    least_area_px: float = 600.0
    #: [1] ratio of the sd along and across an edge from which it is one without texture
    #: convention: only along such an edge light misleads; across it the position needs no light to be right
    weak: float = 3.0
    #: [1] blocks along each side of the window whose residuals are taken for independent
    #: convention: 36 blocks determine the 9 terms of light and the unknowns of the fit
    blocks: int = 6
    #: [steps] a fit with light that needs more has failed
    max_iterations: int = 15
    #: [sd] a step below this share of the standard deviation is the last
    #: statistics: it raises the standard deviation by at most half a percent
    step_tolerance: float = 0.1
    #: [px] longest step of the position
    longest_step_px: float = 1.0


TUNING = Tuning()
# Frozen into compiled code.
LEAST_REDUCTION = TUNING.least_reduction
FULL_REDUCTION = TUNING.full_reduction
WORTHWHILE = TUNING.worthwhile
MEMORY = TUNING.memory
LEAST_SHARE = TUNING.least_share
LEAST_AREA_PX = TUNING.least_area_px
WEAK = TUNING.weak
BLOCKS = TUNING.blocks
MAX_ITERATIONS = TUNING.max_iterations
STEP_TOLERANCE = TUNING.step_tolerance
LONGEST_STEP_PX = TUNING.longest_step_px

# Variances along the direction in which the position is least determined: by noise alone, and for residuals that are
# alike within a block, without and with uneven light.
ALONE, WITHOUT, WITH = 0, 1, 2
# Light is added as a polynomial of this degree over the window, without its constant: 9 terms.
DEGREE = 3
TERMS = (DEGREE + 1) * (DEGREE + 2) // 2 - 1
MOST = kernel.STATE + TERMS


@register_jitable(error_model="numpy")
def _table(
    image: Picture, state: FloatArray, template: kernel.Grid, workspace: kernel.Workspace
) -> NDArray[np.float32]:
    """Table of all pixels of the window, whose matrix and box `workspace` holds; see `tracker.register.sampling`."""
    _, matrix, box, _, _ = workspace
    pixels = box[1] * box[3]
    table, cell, nearest, columns, marks = make_pixel_buffers(pixels)
    fill_positions(state, matrix, box, template.support.shape, table, cell, nearest)
    fill_pixels(image, box, table)
    fill_template(template.coefs, template.support, cell, nearest, pixels, columns, marks, table)
    return table


@register_jitable(error_model="numpy")
def _fill_gradient(
    table: NDArray[np.float32],
    n: int,
    state: FloatArray,
    matrix: FloatArray,
    half: FloatArray,
    order: int,
    row: FloatArray,
) -> None:
    """Derivatives of the model of pixel n by x, y, gain, offset, the angle if `order` is 5, and the terms of light."""
    p, q, gain = table[SLOPE_U, n], table[SLOPE_V, n], state[3]
    row[0] = -gain * (matrix[0, 0] * p + matrix[1, 0] * q)
    row[1] = -gain * (matrix[0, 1] * p + matrix[1, 1] * q)
    row[2] = table[VALUE, n]
    row[3] = 1.0
    if order == kernel.STATE:
        row[4] = gain * (p * table[FROM_V, n] - q * table[FROM_U, n])
    u, v = table[FROM_U, n] / half[0], table[FROM_V, n] / half[1]
    # Degree by degree: the terms of the last one times u, and its last one times v.
    row[order], row[order + 1] = u, v
    first = order
    for degree in range(2, DEGREE + 1):
        for power in range(degree):
            row[first + degree + power] = row[first + power] * u
        row[first + 2 * degree] = row[first + degree - 1] * v
        first += degree


@register_jitable(error_model="numpy")
def _add_up(
    table: NDArray[np.float32],
    state: FloatArray,
    light: FloatArray,
    camera: kernel.Pixels,
    geometry: tuple[FloatArray, FloatArray, int, int],
    order: int,
    normal: FloatArray,
    scores: FloatArray,
) -> tuple[float, float]:
    """Fill the normal equations, lower half, and the right side from each block; chi-square and pixels used.

    `geometry` is the matrix to the grid, half the grid's width and height, and columns and rows of pixels.
    """
    matrix, half, across, down = geometry
    normal[:] = 0.0
    scores[:] = 0.0
    row, size = np.zeros(MOST), order + TERMS
    chi2, used = 0.0, 0.0
    for n in range(across * down):
        pixel = float(table[PIXEL, n])
        if table[WANTED, n] * table[SEEN, n] == 0.0 or pixel >= camera.saturation:
            continue
        _fill_gradient(table, n, state, matrix, half, order, row)
        model = state[3] * table[VALUE, n] + state[4]
        for k in range(order, size):
            model += light[k - order] * row[k]
        if model >= camera.saturation:
            continue
        w = 1.0 / (camera.noise[0] + camera.noise[1] * max(model, 0.0))
        residual = pixel - model
        chi2 += w * residual * residual
        used += 1.0
        score = scores[(n // across) * BLOCKS // down * BLOCKS + (n % across) * BLOCKS // across]
        for i in range(size):
            weighted = w * row[i]
            score[i] += weighted * residual
            for j in range(i + 1):
                normal[i, j] += weighted * row[j]
    return chi2, used


@register_jitable(error_model="numpy")
def _find_weak(
    normal: FloatArray, scores: FloatArray, order: int, chi2: float, weak: FloatArray, variances: FloatArray
) -> bool:
    """Unit vector along which a position without uneven light is least determined; whether it is much less than across.

    Its `variances` along it are filled: alone by the noise of pixels, and for residuals that are alike within a block.
    """
    inverse, rhs = np.zeros((order, order)), np.zeros(2 * order)
    if not kernel.solve(normal, rhs, order, inverse):
        return False
    mean, half = 0.5 * (inverse[0, 0] + inverse[1, 1]), 0.5 * (inverse[0, 0] - inverse[1, 1])
    radius = np.hypot(half, inverse[1, 0])
    angle = 0.5 * np.arctan2(inverse[1, 0], half)
    weak[0], weak[1] = np.cos(angle), np.sin(angle)
    if mean + radius <= WEAK**2 * (mean - radius):
        return False
    variances[ALONE] = mean + radius
    variances[WITHOUT] = _variance(scores, inverse, order, chi2, weak)
    return True


@register_jitable(error_model="numpy")
def _variance(scores: FloatArray, inverse: FloatArray, size: int, chi2: float, weak: FloatArray) -> float:
    """Variance along `weak` for residuals that are alike within a block, at least that for independent ones.

    They are inverse information times the sum of squares of the blocks' gradients times inverse information (White
    1982, doi:10.2307/1912526).
    """
    used = 0
    for b in range(scores.shape[0]):
        used += scores[b, 3] != 0.0
    total, independent = 0.0, 0.0
    for b in range(scores.shape[0]):
        step = 0.0
        for k in range(size):
            step += (weak[0] * inverse[0, k] + weak[1] * inverse[1, k]) * scores[b, k]
        total += step * step
    for i in range(2):
        for j in range(2):
            independent += weak[i] * weak[j] * inverse[i, j]
    # The gradients of all blocks add up to zero in each of the unknowns.
    return float(max(total * used / max(used - size, 1), chi2 * independent))


@register_jitable(error_model="numpy")
def _step(state: FloatArray, light: FloatArray, rhs: FloatArray, order: int, share: float) -> None:
    """Take a share of the step in the position, of 1 px at most, and the whole step in the other unknowns."""
    size = order + TERMS
    length = min(share, LONGEST_STEP_PX / max(abs(rhs[size]), abs(rhs[size + 1])))
    state[0] += length * rhs[size]
    state[1] += length * rhs[size + 1]
    state[3] += rhs[size + 2]
    state[4] += rhs[size + 3]
    if order == kernel.STATE:
        state[2] += min(max(rhs[size + 4], -kernel.LARGEST_TURN_RAD), kernel.LARGEST_TURN_RAD)
    for k in range(TERMS):
        light[k] += rhs[size + order + k]


@register_jitable(error_model="numpy")
def _fit(
    image: Picture,
    state: FloatArray,
    warp: FloatArray,
    template: kernel.Grid,
    camera: kernel.Pixels,
    workspace: kernel.Workspace,
    order: int,
    least: float,
    weak: FloatArray,
    variances: FloatArray,
) -> float:
    """Fit with uneven light from a converged `state`, which is updated; its chi-square, NaN without convergence.

    The direction in which the fit without is `weak` is filled, with the `variances` along it; see `_variance`. They
    remain 0 where there is no such direction. It ends where the first step promises no reduction to the share `least`.
    """
    _, matrix, box, _, _ = workspace
    normal, inverse = np.zeros((MOST, MOST)), np.zeros((MOST, MOST))
    scores, rhs, light = np.zeros((BLOCKS * BLOCKS, MOST)), np.zeros(2 * MOST), np.zeros(TERMS)
    rows, cols = template.support.shape
    half, size = np.array([0.5 * cols, 0.5 * rows]), order + TERMS
    share, before_x, before_y = 1.0, 0.0, 0.0
    for iteration in range(MAX_ITERATIONS):
        if not kernel.place(state, warp, template, workspace):
            return np.nan
        table = _table(image, state, template, workspace)
        geometry = (matrix, half, box[1], box[3])
        chi2, used = _add_up(table, state, light, camera, geometry, order, normal, scores)
        for i in range(size):
            rhs[i] = 0.0
            for b in range(scores.shape[0]):
                rhs[i] += scores[b, i]
        if used < 2 * size or not kernel.solve(normal, rhs, size, inverse):
            return np.nan
        if iteration == 0:
            gained = 0.0
            for i in range(size):
                gained += rhs[i] * rhs[size + i]
            found = _find_weak(normal, scores, order, chi2 / (used - order), weak, variances)
            if not found or chi2 - gained > least * chi2:
                return np.nan
        chi2 /= used - size
        variance = chi2 * (inverse[0, 0] + inverse[1, 1])
        if rhs[size] ** 2 + rhs[size + 1] ** 2 < STEP_TOLERANCE**2 * variance:
            variances[WITH] = _variance(scores, inverse, size, chi2, weak)
            return float(chi2)
        # As in `kernel.register`: steps back and forth across the minimum are halved.
        if iteration >= kernel.REVERSALS_FROM and rhs[size] * before_x + rhs[size + 1] * before_y < 0.0:
            share *= 0.5
        before_x, before_y = rhs[size], rhs[size + 1]
        _step(state, light, rhs, order, share)
    return np.nan


@njit(cache=True, nogil=True, error_model="numpy")
def reconsider(
    image: Picture,
    warp: FloatArray,
    template: kernel.Grid,
    camera: kernel.Pixels,
    workspace: kernel.Workspace,
    with_angle: bool,  # noqa: FBT001 - as in `kernel.register`
    max_shift: float,
    result: FloatArray,
) -> None:
    """Position and standard deviations of a fit with a poor residual, where the light on the marker has changed.

    Parameters are those of `kernel.register`, after it; the share of uneven light in the last position is in `result`.
    Fits of markers whose position is determined alike in all directions stay as they are. So do angle, gain, offset and
    chi-square of all others: they tell whether this is the marker.

    Notes
    -----
    Gain and offset follow a change of light only where it is the same over the marker. What is left is smooth: along
    an edge with little texture it moves the minimum of chi-square by pixels. A cubic polynomial over the window takes
    it up. Other residuals, as of compression, stay: they are independent from frame to frame, and their effect is in
    the scatter of the positions.
    """
    before, result[kernel.LIGHT] = result[kernel.LIGHT], 0.0
    chi2, area = result[kernel.CHI2], template.support.size / template.oversampling**2
    if not (
        result[kernel.CONVERGED] == 1.0
        and area >= LEAST_AREA_PX
        and (chi2 > kernel.GOOD_CHI2 or before > 0.0)
    ):
        return
    state, weak, variances = result[: kernel.STATE].copy(), np.empty(2), np.zeros(3)
    least, order = 1.0 if before > 0.0 else WORTHWHILE, 5 if with_angle else 4
    reduced = _fit(image, state, warp, template, camera, workspace, order, least, weak, variances)
    if variances[WITHOUT] == 0.0:
        return
    wanted = (LEAST_REDUCTION - reduced / chi2) / (LEAST_REDUCTION - FULL_REDUCTION)
    # Written so that NaN is none, too.
    wanted = min(wanted, 1.0) if wanted > 0.0 and chi2 > kernel.GOOD_CHI2 else 0.0
    share = before + (wanted - before) / MEMORY
    change = weak[0] * (state[0] - result[0]) + weak[1] * (state[1] - result[1])
    if share > LEAST_SHARE:
        result[kernel.LIGHT] = share
    # The share is kept where the fit of this frame fails.
    if not (share > LEAST_SHARE and variances[WITH] > 0.0 and abs(change) <= max_shift):
        share, change = 0.0, 0.0
    # That of a mixture of both; standard deviations in a result are those for a chi-square of 1.
    variance = share * (variances[WITH] + (1.0 - share) * change**2) + (1.0 - share) * variances[WITHOUT]
    more = variance / max(chi2, 1.0) - variances[ALONE]
    for i in range(2):
        result[i] += share * change * weak[i]
        result[kernel.SD_X + i] = np.sqrt(max(result[kernel.SD_X + i] ** 2 + more * weak[i] ** 2, 0.0))
