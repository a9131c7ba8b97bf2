"""Small positive definite systems of the smooth functions along a line."""

import numpy as np
from numba import njit

from tracker.arrays import FloatArray


@njit(cache=True, nogil=True, error_model="numpy")
def solve_in_place(normal: FloatArray, rhs: FloatArray, out: FloatArray) -> None:
    """Solution of a positive definite system by Cholesky decomposition in place, of its lower triangle.

    `numpy.linalg.solve` would take numba 6 s to compile.
    """
    size = out.size
    for i in range(size):
        for j in range(i + 1):
            total = normal[i, j]
            for k in range(j):
                total -= normal[i, k] * normal[j, k]
            normal[i, j] = np.sqrt(max(total, 1e-12)) if i == j else total / normal[j, j]
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
