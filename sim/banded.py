"""Band matrices of the beam in compiled code: products, symmetric and general factorisations.

A matrix of n rows and half bandwidth 7 (two nodes of four coordinates meet in an element) is an array of
shape (n, 15) with ``a[i, k] = A[i, i - 7 + k]``; entries outside the matrix are zero. Where a product is taken in every
iteration of every step the array is transposed, shape (15, n), so that the compiler runs along the rows. A symmetric
matrix to be factored is the array of its lower columns, shape (n + 7, 16): ``c[j, m] = A[j + m, j]`` for m = 0 to 7 and
zeros behind, which let every elimination have the same length. Vectors that are multiplied stand in arrays padded with
`PAD` zeros at either end; the zeros in front are also the coordinates of a rigid clamp.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

PAD = 7
BAND = 2 * PAD + 1
COLUMN = 2 * (PAD + 1)
# Sums may be taken in any order and products fused: the same machine still gives the same bytes.
REORDER = {"contract", "reassoc"}


@njit(cache=True)
def band_product(a: FloatArray, x_padded: FloatArray, out: FloatArray) -> None:
    """Write ``A x`` to `out`, shape (n,); `x_padded` has shape (n + 14,)."""
    for i in range(a.shape[0]):
        total = 0.0
        for k in range(BAND):
            total += a[i, k] * x_padded[i + k]
        out[i] = total


@njit(cache=True, fastmath=REORDER)
def add_product(transposed: FloatArray, factor: float, x_padded: FloatArray, out: FloatArray) -> None:
    """Add ``factor A x`` to `out`; `transposed` has shape (15, n)."""
    for k in range(BAND):
        for i in range(out.size):
            out[i] += factor * transposed[k, i] * x_padded[i + k]


@njit(cache=True)
def lower_columns(band: FloatArray, columns: FloatArray) -> None:
    """Write the lower columns of a symmetric band matrix, from shape (n, 15) to (n + 7, 16)."""
    n = band.shape[0]
    columns[:] = 0.0
    for j in range(n):
        for m in range(min(PAD + 1, n - j)):
            columns[j, m] = band[j + m, PAD - m]


@njit(cache=True, fastmath=REORDER)
def factor_symmetric(columns: FloatArray, inverse_pivot: FloatArray) -> bool:
    """L D L^T in place of lower columns, shape (n + 7, 16); they hold L (below its diagonal of ones) after it.

    Returns False when a pivot vanishes. A negative pivot is allowed: it tells of an indefinite matrix.
    """
    for j in range(inverse_pivot.size):
        own = columns[j]
        pivot = own[0]
        if pivot == 0.0 or not abs(pivot) < 1e300:
            return False
        inverse = 1.0 / pivot
        inverse_pivot[j] = inverse
        # written out: the compiler cannot know that rows of one array do not overlap, and would wait for memory
        a, b, c, d, e, f, g = own[1], own[2], own[3], own[4], own[5], own[6], own[7]
        r = columns[j + 1]
        own[1] = x = a * inverse
        r[0] -= x * a
        r[1] -= x * b
        r[2] -= x * c
        r[3] -= x * d
        r[4] -= x * e
        r[5] -= x * f
        r[6] -= x * g
        r = columns[j + 2]
        own[2] = x = b * inverse
        r[0] -= x * b
        r[1] -= x * c
        r[2] -= x * d
        r[3] -= x * e
        r[4] -= x * f
        r[5] -= x * g
        r = columns[j + 3]
        own[3] = x = c * inverse
        r[0] -= x * c
        r[1] -= x * d
        r[2] -= x * e
        r[3] -= x * f
        r[4] -= x * g
        r = columns[j + 4]
        own[4] = x = d * inverse
        r[0] -= x * d
        r[1] -= x * e
        r[2] -= x * f
        r[3] -= x * g
        r = columns[j + 5]
        own[5] = x = e * inverse
        r[0] -= x * e
        r[1] -= x * f
        r[2] -= x * g
        r = columns[j + 6]
        own[6] = x = f * inverse
        r[0] -= x * f
        r[1] -= x * g
        own[7] = x = g * inverse
        columns[j + 7, 0] -= x * g
    return True


@njit(cache=True, fastmath=REORDER)
def solve_symmetric(columns: FloatArray, inverse_pivot: FloatArray, x: FloatArray) -> None:
    """Solve in place with the factors of `factor_symmetric`.

    `x` has shape (n + 7,); the seven at its end are written to and mean nothing. The seven values that a row acts upon
    stay in variables, so that no row waits for memory.
    """
    n = inverse_pivot.size
    a, b, c, d, e, f, g = x[0], x[1], x[2], x[3], x[4], x[5], x[6]
    for j in range(n):
        first = a
        column = columns[j]
        a = b - column[1] * first
        b = c - column[2] * first
        c = d - column[3] * first
        d = e - column[4] * first
        e = f - column[5] * first
        f = g - column[6] * first
        g = x[j + PAD] - column[7] * first
        x[j] = first * inverse_pivot[j]
    a = b = c = d = e = f = g = 0.0
    for j in range(n - 1, -1, -1):
        column = columns[j]
        rest = x[j] - column[7] * g - column[6] * f - column[5] * e
        rest = rest - column[4] * d - column[3] * c - column[2] * b
        value = rest - column[1] * a
        g, f, e, d, c, b, a = f, e, d, c, b, a, value
        x[j] = value


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
