"""Templates: parametric ones of ArUco cells or a disc, and those learned from many registered frames."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import ndimage
from scipy.special import ndtr

from tracker.arrays import FloatArray, GrayImage
from tracker.template.noise import NoiseModel
from tracker.template.spline import (
    Template,
    fill_taps,
    from_values,
    grid_px,
    modelled_pixels,
    placed,
    quadrature,
)


@dataclass(frozen=True)
class Tuning:
    """Templates: grids, blur, and how they are learned."""

    #: [1/px] grid points per px of an ideal template
    printed_oversampling: float = 4.0
    #: [1/px] the same of a learned one
    #: convention: each pixel has to determine several coefficients
    learned_oversampling: float = 2.0
    #: [px] least lens blur in the closed form
    #: convention: below it the pixel determines the edge
    smallest_blur_px: float = 0.05
    #: [px] white rim of a marker in its template, at least
    #: convention: beyond it the blur of its edge is over
    rim_px: float = 2.5
    #: [cells] the same of a code, in cells
    #: convention: a wider quiet zone may not exist
    rim_cells: float = 0.75
    #: [1] weight of the squared second differences relative to the data per grid point
    #: physics: enough to determine what no frame shows, while an edge blurred by 0.8 px loses a thousandth of its
    #: height
    smoothness: float = 0.004
    #: [steps] of the conjugate gradients
    #: convention: coefficients that no pixel constrains converge slowly, without effect on any pixel
    max_solver_iterations: int = 100
    #: [1] squared relative residual that ends them
    #: physics: a relative residual of 3e-5
    residual_goal: float = 1e-9
    #: [pixels] from which a template is learned
    #: convention: a sufficient number averages out the noise
    pixels_wanted: int = 400_000
    #: [frames] from which it is learned, at least
    least_frames: int = 16
    #: [1] residuals this many times those of the marker's core are of something else
    misfit: float = 4.0
    #: [px] lens blur of a first template
    #: convention: of a lens in focus; it is fitted later
    first_blur_px: float = 0.7


TUNING = Tuning()
# Frozen into compiled code.
MAX_SOLVER_ITERATIONS = TUNING.max_solver_iterations
RESIDUAL_GOAL = TUNING.residual_goal


def step_response(t_px: FloatArray, blur_px: float) -> FloatArray:
    """A unit step at 0 after a Gaussian lens blur and integration over a pixel of side 1.

    The integral of the normal distribution function over the pixel, in closed form.
    """
    sigma = max(blur_px, TUNING.smallest_blur_px)

    def antiderivative(t: FloatArray) -> FloatArray:
        z = t / sigma
        return np.asarray(t * ndtr(z) + sigma * np.exp(-0.5 * z * z) / np.sqrt(2.0 * np.pi))

    return np.asarray(antiderivative(t_px + 0.5) - antiderivative(t_px - 0.5))


def aruco_values(
    u_px: FloatArray, v_px: FloatArray, bits: NDArray[np.uint8], side_px: float, blur_px: float
) -> FloatArray:
    """Brightness of an ArUco marker at points of its own frame: 1 white, also outside, 0 black; shape of the points.

    Parameters
    ----------
    bits : uint8 array, shape (cells, cells)
        1 white, 0 black, black border included.
    side_px, blur_px : float
        Outer side of the black border; standard deviation of the lens blur. The pixel area is integrated along the
        marker's axes.
    """
    across = _cells(u_px, bits.shape[1], side_px, blur_px)
    down = _cells(v_px, bits.shape[0], side_px, blur_px)
    black = 1.0 - bits.astype(np.float64)
    return np.asarray(1.0 - np.einsum("i...,ij,j...->...", down, black, across, optimize=True))


def _cells(t_px: FloatArray, cells: int, side_px: float, blur_px: float) -> FloatArray:
    """Share of each cell in a pixel at `t_px`; shape (cells, ...)."""
    edges = side_px * (np.arange(cells + 1) / cells - 0.5)
    steps = np.stack([step_response(t_px - edge, blur_px) for edge in edges])
    return steps[:-1] - steps[1:]


def aruco_template(bits: NDArray[np.uint8], side_px: float, blur_px: float) -> Template:
    """Template of an ArUco marker; its support ends in the quiet zone.

    It includes a white rim of three quarters of a cell, at least 2.5 px, around the black border: a wider quiet zone
    may not exist.
    """
    rim = max(TUNING.rim_px, TUNING.rim_cells * side_px / bits.shape[0])
    u, v = grid_px(0.5 * side_px + rim, 0.5 * side_px + rim, TUNING.printed_oversampling)
    across = _cells(u, bits.shape[1], side_px, blur_px)
    down = _cells(v, bits.shape[0], side_px, blur_px)
    values = 1.0 - down.T @ (1.0 - bits.astype(np.float64)) @ across
    support = np.maximum(np.abs(v)[:, None], np.abs(u)[None, :]) <= 0.5 * side_px + rim
    return from_values(values, support.astype(np.uint8), TUNING.printed_oversampling)


def disc_values(u_px: FloatArray, v_px: FloatArray, radius_px: float, blur_px: float) -> FloatArray:
    """Brightness of a disc on a grid: 1 inside, 0 outside; shape (v, u).

    Chords are integrated in closed form across, and by Gauss-Legendre quadrature down with the row at
    radius * sin(angle).
    """
    # Ten nodes per px of the radius: their spacing is below the narrowest pulse of a pixel and its blur.
    points, weights = quadrature(64 + 10 * int(np.ceil(abs(radius_px))))
    angle = 0.5 * np.pi * points
    row, half = radius_px * np.sin(angle), radius_px * np.cos(angle)
    # The nodes are symmetric about 0, and so are the chords.
    lower = half[: (half.size + 1) // 2, None]
    left, right = (step_response(u_px[None, :] + end, blur_px) for end in (lower, -lower))
    chords = np.concatenate([left - right, (left - right)[: half.size // 2][::-1]])
    # d row = radius cos(angle) d angle; the vertical response is the derivative of the step response.
    sigma = max(blur_px, TUNING.smallest_blur_px)
    offset = v_px[:, None] - row[None, :]
    pulse = ndtr((offset + 0.5) / sigma) - ndtr((offset - 0.5) / sigma)
    return np.asarray(pulse @ (chords * (0.5 * np.pi * weights * half)[:, None]))


def disc_template(radius_px: float, blur_px: float) -> Template:
    """Template of a dot; its support ends 2.5 px outside the rim."""
    reach = radius_px + max(TUNING.rim_px, 2.5 * blur_px + 0.7)
    u, v = grid_px(reach, reach, TUNING.printed_oversampling)
    support = np.hypot(v[:, None], u[None, :]) <= reach
    return from_values(
        disc_values(u, v, radius_px, blur_px), support.astype(np.uint8), TUNING.printed_oversampling
    )


# Along a row, down a column, and diagonally: offsets in rows and columns, and weights.
SECOND_DIFFERENCES: tuple[dict[tuple[int, int], float], ...] = (
    {(0, 0): 1.0, (0, 1): -2.0, (0, 2): 1.0},
    {(0, 0): 1.0, (1, 0): -2.0, (2, 0): 1.0},
    {(0, 0): 2.0**0.5, (0, 1): -(2.0**0.5), (1, 0): -(2.0**0.5), (1, 1): 2.0**0.5},
)


@njit(cache=True, nogil=True)
def _add_frame(
    image: GrayImage,
    state: FloatArray,
    warp: FloatArray,
    support: NDArray[np.uint8],
    oversampling: float,
    noise: FloatArray,
    saturation: float,
    stencil: FloatArray,
    rhs: FloatArray,
) -> None:
    """Add a frame's pixels to the normal equations: each coefficient with those up to 3 rows and columns away.

    Row `point` of `stencil` holds the products with the coefficients up to 3 columns before and after it, in its row of
    the grid (only those after it are filled) and in the next three.
    """
    height, width = image.shape
    rows, cols = support.shape
    a00, a01, a10, a11, u0, v0, half_x, half_y = placed(state, warp, oversampling, rows, cols)
    wu = np.empty(4)
    wv = np.empty(4)
    flat = stencil.reshape(stencil.size)
    gain, offset = state[3], state[4]
    for j in range(max(int(state[1] - half_y), 0), min(int(state[1] + half_y) + 2, height)):
        for i in range(max(int(state[0] - half_x), 0), min(int(state[0] + half_x) + 2, width)):
            px, py = i - state[0], j - state[1]
            gu = a00 * px + a01 * py + u0
            gv = a10 * px + a11 * py + v0
            iu, iv = int(np.floor(gu)), int(np.floor(gv))
            if iu < 1 or iv < 1 or iu > cols - 3 or iv > rows - 3:
                continue
            if support[int(gv + 0.5), int(gu + 0.5)] == 0 or image[j, i] >= saturation:
                continue
            fill_taps(gu - iu, wu)
            fill_taps(gv - iv, wv)
            weight = 1.0 / (noise[0] + noise[1] * image[j, i])
            target = image[j, i] - offset
            for r in range(4):
                for c in range(4):
                    point = (iv - 1 + r) * cols + iu - 1 + c
                    first = weight * gain * wv[r] * wu[c]
                    rhs[point] += first * target
                    first *= gain
                    # Unsigned, so that no index is checked for being negative: this is the inner loop of learning.
                    at = np.uint64(28 * point + 3 - c)
                    for c2 in range(c, 4):
                        flat[at + np.uint64(c2)] += first * wv[r] * wu[c2]
                    for below in range(1, 4 - r):
                        both, row = first * wv[r + below], at + np.uint64(7 * below)
                        for c2 in range(4):
                            flat[row + np.uint64(c2)] += both * wu[c2]


def _add_smoothness(stencil: FloatArray, amount: float) -> None:
    """Add squared second differences along rows, columns and diagonally (thin plate); shape (rows, cols, 28)."""
    rows, cols, _ = stencil.shape
    for r2, c2 in sorted({at for taps in SECOND_DIFFERENCES for at in taps}, reverse=True):
        for taps in SECOND_DIFFERENCES:
            height, width = rows - max(r for r, _ in taps), cols - max(c for _, c in taps)
            for (r1, c1), weight in taps.items():
                if (r2, c2) in taps and (r1, c1) >= (r2, c2):
                    product = amount * weight * taps[r2, c2]
                    stencil[r2 : r2 + height, c2 : c2 + width, 7 * (r1 - r2) + c1 - c2 + 3] += product


@njit(cache=True, nogil=True)
def _times(bands: FloatArray, cols: int, vector: FloatArray, product: FloatArray) -> None:
    """Product of the symmetric matrix with a vector; `bands`, shape (28, n), is the transposed stencil."""
    n = vector.size
    for i in range(n):
        product[i] = bands[3, i] * vector[i]
    for d in range(4, 28):
        band, ahead = bands[d], (d // 7) * cols + d % 7 - 3
        later, sums = vector[ahead:], product[ahead:]
        # Two passes: each is one vector operation for the compiler.
        for i in range(n - ahead):
            product[i] += band[i] * later[i]
        for i in range(n - ahead):
            sums[i] += band[i] * vector[i]


@njit(cache=True, nogil=True)
def _solve(bands: FloatArray, cols: int, rhs: FloatArray, solution: FloatArray) -> None:
    """Conjugate gradients starting at `solution`, preconditioned by the diagonal, to a relative residual of 3e-5.

    Coefficients that no pixel constrains converge slowly, without effect on any pixel; the steps are limited.
    """
    n = rhs.size
    product = np.empty(n)
    _times(bands, cols, solution, product)
    residual = rhs - product
    scaled = residual / bands[3]
    direction = scaled.copy()
    rho = np.dot(residual, scaled)
    goal = RESIDUAL_GOAL * np.dot(rhs, rhs / bands[3])
    for _ in range(MAX_SOLVER_ITERATIONS):
        if rho <= goal:
            return
        _times(bands, cols, direction, product)
        step = rho / np.dot(direction, product)
        solution += step * direction
        residual -= step * product
        scaled = residual / bands[3]
        updated = np.dot(residual, scaled)
        direction = scaled + (updated / rho) * direction
        rho = updated


def learn_template(
    frames: list[GrayImage],
    states: FloatArray,
    warp: FloatArray,
    support: NDArray[np.uint8],
    noise: NoiseModel,
    saturation: float,
    start: FloatArray | None = None,
    chi2: float = 1.0,
    oversampling: float | None = None,
) -> Template | None:
    """Maximum-likelihood template of a marker from registered frames; None where it is not determined.

    Parameters
    ----------
    states : array, shape (n, 5)
        As in `tracker.register.marker.MarkerModel`; frames with NaN are excluded.
    support : uint8 array, shape (rows, cols)
        On a grid of `oversampling` points per px, that of learned templates unless given.
    start : array, shape (rows, cols), or None
        Coefficients of an approximate solution.
    chi2 : float
        Mean squared residual over the variance of the noise. Above 1 the pixels have errors beyond the noise, as of
        compression, and count less against the penalty: the template would otherwise reproduce these errors at each
        sub-pixel phase, and the fits would follow them.

    Notes
    -----
    Linear least squares for the B-spline coefficients c of sum_k w_k (I_k - offset - gain * B c)^2 plus a small
    thin-plate penalty, solved by conjugate gradients. Sub-pixel phases that never occur are determined by the penalty
    alone.
    """
    oversampling = oversampling or TUNING.learned_oversampling
    good = np.flatnonzero(np.all(np.isfinite(states), axis=1))
    if good.size == 0:
        return None
    rows, cols = support.shape
    if good.size > TUNING.least_frames:
        # A sufficient number of pixels averages out the noise: large markers need fewer frames.
        count = int(
            np.clip(
                TUNING.pixels_wanted * oversampling**2 / max(int(support.sum()), 1),
                TUNING.least_frames,
                good.size,
            )
        )
        good = good[np.linspace(0, good.size - 1, count).astype(np.int64)]
    stencil = np.zeros((rows * cols, 28))
    rhs = np.zeros(rows * cols)
    values = noise.as_array()
    for k in good:
        _add_frame(frames[k], states[k], warp, support, oversampling, values, saturation, stencil, rhs)
    seen = stencil[:, 3][stencil[:, 3] > 0]
    if seen.size == 0:
        return None
    # The diagonal is the weight of the data times the mean square of a tap, (151/315)^2.
    share = float(np.median(seen)) / 0.2298
    _add_smoothness(stencil.reshape(rows, cols, 28), TUNING.smoothness * max(1.0, chi2) * share)
    stencil[:, 3] += 1e-6 * share
    if start is None:
        # A uniform image of the mean brightness: all products of a row add up to the row's own tap.
        start = np.full((rows, cols), 0.25 * float(np.sum(rhs)) / float(np.sum(stencil[:, 3])))
    coefs = start.ravel().copy()
    _solve(np.ascontiguousarray(stencil.T), cols, rhs, coefs)
    if not np.all(np.isfinite(coefs)):
        return None
    return Template(np.ascontiguousarray(coefs.reshape(rows, cols)), support, oversampling)


def residual_map(
    frames: list[GrayImage], states: FloatArray, warp: FloatArray, template: Template, noise: NoiseModel
) -> FloatArray:
    """Mean squared normalised residual around each grid point, averaged over 3 px; shape of the grid.

    About 1 where the template explains the pixels, large where something else moves; NaN without pixels.
    """
    total, count = np.zeros(template.coefs.shape), np.zeros(template.coefs.shape)
    values = noise.as_array()
    for k in np.flatnonzero(np.all(np.isfinite(states), axis=1)):
        at, pixel, model = modelled_pixels(frames[k], states[k], warp, template.coefs, template.oversampling)
        np.add.at(total, at, (pixel - model) ** 2 / (values[0] + values[1] * np.maximum(model, 0.0)))
        np.add.at(count, at, 1.0)
    size = 2 * int(1.5 * template.oversampling) + 1
    total, count = (ndimage.uniform_filter(a, size, mode="constant") for a in (total, count))
    return np.where(count > 1e-9, total / np.maximum(count, 1e-9), np.nan)


def trimmed_support(template: Template, chi2: FloatArray, core: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Support without the points where the residual is far above its level in the core.

    Grid points of the `core` belong to the marker itself: kept, so that a poor print cannot empty its own template.
    """
    inside = (template.support > 0) & np.isfinite(chi2)
    reference = float(np.median(chi2[inside & core])) if np.any(inside & core) else 1.0
    bad = (chi2 > TUNING.misfit * max(1.0, reference)) & ~core
    return np.ascontiguousarray((template.support > 0) & ~bad, dtype=np.uint8)
