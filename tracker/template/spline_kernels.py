"""Position of pixels on a template's grid and its cubic B-spline there, for compiled code of the calibration."""

from __future__ import annotations

import numpy as np
from numba import njit

from tracker.arrays import FloatArray


@njit(cache=True, nogil=True)
def placed(state: FloatArray, warp: FloatArray, oversampling: float, rows: int, cols: int) -> FloatArray:
    """Placement of a template's grid in the image.

    Returns
    -------
    array, shape (8,)
        The matrix from pixels to grid points (four, row by row), the grid's centre (u, v), and half the size of the
        grid's bounding box in the image (x, y), px.
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
def spline_value(coefs: FloatArray, iu: int, iv: int, wu: FloatArray, wv: FloatArray) -> float:
    """Value of the spline from the taps along u and v; `iu` and `iv` are the preceding grid point."""
    value = 0.0
    for r in range(4):
        for c in range(4):
            value += wv[r] * wu[c] * coefs[iv - 1 + r, iu - 1 + c]
    return value
