"""Small positive definite systems of the smooth functions along a line."""

import numpy as np
from numba import njit

from tracker.arrays import FloatArray

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
