"""Band matrices of the beam in compiled code: products and the symmetric factorisation.

A matrix of n rows and half bandwidth 7 (an element has two nodes of four coordinates) is stored as an array of shape
(n, 15) with ``a[i, k] = A[i, i - 7 + k]``; entries outside the matrix are zero. For products within the iteration it is
stored by diagonals, shape (15, n), so that the compiler vectorises along the rows. A symmetric matrix to be factored is
stored by lower columns, shape (n + 7, 16): ``c[j, m] = A[j + m, j]`` for m = 0 to 7, then zeros, so that all
eliminations have the same length. Vectors to be multiplied are padded with `PAD` zeros at either end; the leading zeros
are also the coordinates of a rigid clamp.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from tracker import FloatArray

PAD = 7
BAND = 2 * PAD + 1
COLUMN = 2 * (PAD + 1)
# sums may be reordered and products fused; one machine still gives reproducible bytes
REORDER = {"contract", "reassoc"}


@njit(cache=True)
def band_product(a: FloatArray, x_padded: FloatArray, out: FloatArray) -> None:
    """Write ``A x`` to `out`, shape (n,); `x_padded` has shape (n + 14,)."""
    for i in range(a.shape[0]):
        total = 0.0
        for k in range(BAND):
            total += a[i, k] * x_padded[i + k]
        out[i] = total


def diagonals(band: FloatArray, *, decoupled: bool) -> FloatArray:
    """Diagonals of a band matrix, (..., n, 15) to (..., 15, n), for `add_product`.

    Where motion along and across the beam is `decoupled`, every second diagonal is zero and omitted: (..., 7, n).
    """
    rows = np.swapaxes(band, -1, -2)
    return np.ascontiguousarray(rows[..., 1:-1:2, :] if decoupled else rows)


def decoupled(band: FloatArray) -> bool:
    """Whether every second diagonal of a band matrix, shape (..., 15), is zero."""
    return not np.any(band[..., 0::2])


@njit(cache=True, fastmath=REORDER)
def add_product(a: FloatArray, x: FloatArray, out: FloatArray) -> None:
    """Add ``A x`` to `out`; `a` holds the diagonals, shape (15, n) or (7, n); `x` is padded."""
    # unrolled, so that partial sums stay in registers
    if a.shape[0] < BAND:
        for i in range(out.size):
            near = a[2, i] * x[i + 5] + a[3, i] * x[i + 7] + a[4, i] * x[i + 9]
            far = a[0, i] * x[i + 1] + a[1, i] * x[i + 3] + a[5, i] * x[i + 11] + a[6, i] * x[i + 13]
            out[i] += near + far
    else:
        for k in range(0, BAND, 5):
            for i in range(out.size):
                near = a[k, i] * x[i + k] + a[k + 1, i] * x[i + k + 1] + a[k + 2, i] * x[i + k + 2]
                out[i] += near + a[k + 3, i] * x[i + k + 3] + a[k + 4, i] * x[i + k + 4]


def lower_columns(band: FloatArray) -> FloatArray:
    """Lower columns of symmetric band matrices, (..., n, 15) to (..., n + 7, 16)."""
    n = band.shape[-2]
    columns = np.zeros((*band.shape[:-2], n + PAD, COLUMN))
    for m in range(PAD + 1):
        columns[..., : n - m, m] = band[..., m:, PAD - m]
    return columns


@njit(cache=True, fastmath=REORDER, inline="always")
def _eliminate(
    below: tuple[float, float, float, float, float, float, float], m: int, inverse: float, row: FloatArray
) -> float:
    """Subtract multiple m of a column from a later one; returns the multiplier."""
    x = below[m] * inverse
    for k in range(m, PAD):
        row[k - m] -= x * below[k]
    return x


@njit(cache=True, fastmath=REORDER)
def factor_symmetric(columns: FloatArray, inverse_pivot: FloatArray) -> bool:
    """Factor lower columns, shape (n + 7, 16), in place into L D L^T; they then hold L below its unit diagonal.

    Returns False when a pivot vanishes. Negative pivots, of an indefinite matrix, are allowed.
    """
    for j in range(inverse_pivot.size):
        own = columns[j]
        pivot = own[0]
        if pivot == 0.0 or not abs(pivot) < 1e300:
            return False
        inverse = 1.0 / pivot
        inverse_pivot[j] = inverse
        # a tuple and inlined calls: the compiler cannot exclude that rows of one array overlap, and would wait for
        # memory
        below = (own[1], own[2], own[3], own[4], own[5], own[6], own[7])
        own[1] = _eliminate(below, 0, inverse, columns[j + 1])
        own[2] = _eliminate(below, 1, inverse, columns[j + 2])
        own[3] = _eliminate(below, 2, inverse, columns[j + 3])
        own[4] = _eliminate(below, 3, inverse, columns[j + 4])
        own[5] = _eliminate(below, 4, inverse, columns[j + 5])
        own[6] = _eliminate(below, 5, inverse, columns[j + 6])
        own[7] = _eliminate(below, 6, inverse, columns[j + 7])
    return True


@njit(cache=True, fastmath=REORDER)
def solve_symmetric(columns: FloatArray, inverse_pivot: FloatArray, x: FloatArray) -> None:
    """Solve in place with the factors of `factor_symmetric`.

    `x` has shape (n + 7,); its last seven values are scratch. The seven values that a row acts on stay in variables, so
    that no row waits for memory.
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


def to_band(dense: FloatArray) -> FloatArray:
    """Band form, shape (n, 15), of a matrix with half bandwidth 7."""
    n = dense.shape[0]
    band = np.zeros((n, BAND))
    for k in range(BAND):
        diagonal = np.diagonal(dense, k - PAD)
        start = max(0, PAD - k)
        band[start : start + diagonal.size, k] = diagonal
    return band


def from_band(band: FloatArray) -> FloatArray:
    """Dense matrix, shape (n, n), of a band form."""
    n = band.shape[0]
    rows = np.zeros((n, n + BAND))
    rows[:, :BAND] = band
    # read with rows shorter by one, each begins one further to the right
    return np.ascontiguousarray(rows.ravel()[: n * (n + 2 * PAD)].reshape(n, -1)[:, PAD:-PAD])
