"""Position of pixels on a template's grid and its cubic B-spline there, for compiled code of the calibration."""

from __future__ import annotations

import numpy as np
from numba import njit

from tracker.arrays import FloatArray, GrayImage, IntArray


@njit(cache=True, nogil=True)
def placed(state: FloatArray, warp: FloatArray, oversampling: float, rows: int, cols: int) -> FloatArray:
    """Placement of a template's grid in the image; shape (8,).

    The matrix from pixels to grid points (four, row by row), the grid's centre (u, v), and half the size of the grid's
    bounding box in the image (x, y), px.
    """
    cosine, sine = np.cos(state[2]), np.sin(state[2])
    a00 = (cosine * warp[0, 0] + sine * warp[1, 0]) * oversampling
    a01 = (cosine * warp[0, 1] + sine * warp[1, 1]) * oversampling
    a10 = (-sine * warp[0, 0] + cosine * warp[1, 0]) * oversampling
    a11 = (-sine * warp[0, 1] + cosine * warp[1, 1]) * oversampling
    u0, v0 = 0.5 * (cols - 1), 0.5 * (rows - 1)
    det = abs(a00 * a11 - a01 * a10)
    half_x = (abs(a11) * u0 + abs(a01) * v0) / det
    half_y = (abs(a10) * u0 + abs(a00) * v0) / det
    return np.array([a00, a01, a10, a11, u0, v0, half_x, half_y])


@njit(cache=True, nogil=True)
def fill_taps(t: float, taps: FloatArray) -> None:
    """Weights of the four coefficients around a point at the fraction `t` between the second and the third."""
    s = 1.0 - t
    taps[0] = s * s * s / 6.0
    taps[1] = (4.0 - 6.0 * t * t + 3.0 * t * t * t) / 6.0
    taps[2] = (4.0 - 6.0 * s * s + 3.0 * s * s * s) / 6.0
    taps[3] = t * t * t / 6.0


@njit(cache=True, nogil=True)
def _fill_modelled(
    image: GrayImage,
    state: FloatArray,
    warp: FloatArray,
    coefs: FloatArray,
    oversampling: float,
    where: IntArray,
    values: FloatArray,
) -> int:
    """Fill nearest grid point, pixel and model of each pixel inside the grid, shapes (2, n); their number."""
    rows, cols = coefs.shape
    a00, a01, a10, a11, u0, v0, half_x, half_y = placed(state, warp, oversampling, rows, cols)
    wu = np.empty(4)
    wv = np.empty(4)
    n = 0
    for j in range(max(int(state[1] - half_y), 0), min(int(state[1] + half_y) + 2, image.shape[0])):
        for i in range(max(int(state[0] - half_x), 0), min(int(state[0] + half_x) + 2, image.shape[1])):
            px, py = i - state[0], j - state[1]
            gu = a00 * px + a01 * py + u0
            gv = a10 * px + a11 * py + v0
            iu, iv = int(np.floor(gu)), int(np.floor(gv))
            if iu < 1 or iv < 1 or iu > cols - 3 or iv > rows - 3:
                continue
            fill_taps(gu - iu, wu)
            fill_taps(gv - iv, wv)
            value = 0.0
            for r in range(4):
                for c in range(4):
                    value += wv[r] * wu[c] * coefs[iv - 1 + r, iu - 1 + c]
            where[0, n], where[1, n] = int(gv + 0.5), int(gu + 0.5)
            values[0, n], values[1, n] = image[j, i], state[3] * value + state[4]
            n += 1
    return n


def modelled_pixels(
    image: GrayImage, state: FloatArray, warp: FloatArray, coefs: FloatArray, oversampling: float
) -> tuple[tuple[IntArray, IntArray], FloatArray, FloatArray]:
    """Pixels of a marker inside its template's grid: row and column of the nearest grid point, pixel and model."""
    rows, cols = coefs.shape
    *_, half_x, half_y = placed(state, warp, oversampling, rows, cols)
    most = (int(2.0 * half_x) + 4) * (int(2.0 * half_y) + 4)
    where, values = np.empty((2, most), dtype=np.int64), np.empty((2, most))
    n = _fill_modelled(image, state, warp, coefs, oversampling, where, values)
    return (where[0, :n], where[1, :n]), values[0, :n], values[1, :n]
