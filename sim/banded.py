"""Band matrices of the beam in compiled code: products, symmetric and general factorisations.

A matrix of n rows and half bandwidth 7 (two nodes of four coordinates meet in an element) is an array of
shape (n, 15) with ``a[i, k] = A[i, i - 7 + k]``; entries outside the matrix are zero. Vectors that are multiplied
stand in arrays padded with `PAD` zeros at either end, so that no row needs a test of its bounds; the zeros in front
are also the coordinates of the clamp.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

PAD = 7
BAND = 2 * PAD + 1


@njit(cache=True)
def band_product(a: FloatArray, x_padded: FloatArray, out: FloatArray) -> None:
    """Write ``A x`` to `out`, shape (n,); `x_padded` has shape (n + 14,)."""
    for i in range(a.shape[0]):
        total = 0.0
        for k in range(BAND):
            total += a[i, k] * x_padded[i + k]
        out[i] = total


@njit(cache=True)
def factor_symmetric(a: FloatArray, lower: FloatArray, pivot: FloatArray) -> bool:
    """L D L^T of a symmetric band matrix, of which only the lower half is read.

    Returns False when a pivot vanishes. A negative pivot is allowed: it tells of an indefinite matrix.
    """
    n = a.shape[0]
    for i in range(n):
        first = max(0, i - PAD)
        diagonal = a[i, PAD]
        for j in range(first, i):
            total = a[i, j - i + PAD]
            for m in range(max(first, j - PAD), j):
                # lower[i, .] still holds L D of the columns before j; lower[j, .] is finished
                total -= lower[i, m - i + PAD] * lower[j, m - j + PAD]
            lower[i, j - i + PAD] = total
        for j in range(first, i):
            scaled = lower[i, j - i + PAD] / pivot[j]
            diagonal -= scaled * lower[i, j - i + PAD]
            lower[i, j - i + PAD] = scaled
        if diagonal == 0.0 or not np.isfinite(diagonal):
            return False
        pivot[i] = diagonal
    return True


@njit(cache=True)
def solve_symmetric(lower: FloatArray, pivot: FloatArray, x: FloatArray) -> None:
    """Solve in place with the factors of `factor_symmetric`; `x` has shape (n,)."""
    n = x.size
    for i in range(n):
        total = x[i]
        for j in range(max(0, i - PAD), i):
            total -= lower[i, j - i + PAD] * x[j]
        x[i] = total
    for i in range(n - 1, -1, -1):
        x[i] /= pivot[i]
    for i in range(n - 1, -1, -1):
        value = x[i]
        for j in range(max(0, i - PAD), i):
            x[j] -= lower[i, j - i + PAD] * value


@njit(cache=True)
def solve_general(  # noqa: C901 - one elimination, as every book prints it
    a: FloatArray, work: FloatArray, x: FloatArray
) -> bool:
    """Solve ``A x = b`` in place by band elimination with partial pivoting; False when A is singular.

    `work` has shape (n, 15): a row exchanged by the pivoting reaches 14 columns to the right of its pivot.
    """
    n = x.size
    width = work.shape[1]
    for i in range(n):
        # work[i, k] = A[i, first_i + k] with first_i = max(0, i - 7), shifted left as columns are eliminated
        shift = max(0, PAD - i)
        for k in range(width):
            source = k + shift
            work[i, k] = a[i, source] if source < BAND else 0.0
    for column in range(n):
        last = min(n, column + PAD + 1)
        best = column
        for i in range(column + 1, last):
            if abs(work[i, 0]) > abs(work[best, 0]):
                best = i
        if work[best, 0] == 0.0 or not np.isfinite(work[best, 0]):
            return False
        if best != column:
            for k in range(width):
                work[column, k], work[best, k] = work[best, k], work[column, k]
            x[column], x[best] = x[best], x[column]
        for i in range(column + 1, last):
            factor = work[i, 0] / work[column, 0]
            for k in range(1, width):
                work[i, k - 1] = work[i, k] - factor * work[column, k]
            work[i, width - 1] = 0.0
            x[i] -= factor * x[column]
    for i in range(n - 1, -1, -1):
        total = x[i]
        for k in range(1, min(width, n - i)):
            total -= work[i, k] * x[i + k]
        x[i] = total / work[i, 0]
    return True
