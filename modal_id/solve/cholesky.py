"""Cholesky factors of small dense systems, and of symmetric banded matrices, those of splines.

Small dense systems are solved by LAPACK directly: what NumPy and SciPy do around it takes most of their time.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar, cast

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.linalg import LinAlgError, cho_solve_banded, cholesky_banded
from scipy.linalg.lapack import dpbtrs, dpotrf, dpotrs, dtbtrs
from scipy.sparse import csr_array

from tracker import ComplexArray, FloatArray


@dataclass(frozen=True)
class Tuning:
    """Rounding."""

    #: [1] eigenvalue over the largest that counts as 0
    #: convention: As in `numpy.linalg.pinv`.
    negligible: float = 1e-15


TUNING = Tuning()


def cholesky(matrix: FloatArray) -> tuple[FloatArray, bool]:
    """Cholesky factor as `scipy.linalg.cho_factor` returns it; LinAlgError where it is not positive definite."""
    if matrix.size == 0:
        return matrix, False
    factor, info = dpotrf(matrix, lower=0, clean=0)
    if info:
        msg = f"a matrix of {len(matrix)} rows is not positive definite"
        raise LinAlgError(msg)
    return factor, False


def solve(factor: tuple[FloatArray, bool], right: FloatArray) -> FloatArray:
    """``A^-1 right`` of the matrix with this factor; right of shape (p, c)."""
    if right.size == 0:
        return np.empty(right.shape)
    return np.asarray(dpotrs(factor[0], right, lower=factor[1])[0])


def pseudo_inverse(matrix: FloatArray) -> FloatArray:
    """Of a symmetric matrix: the bytes of ``numpy.linalg.pinv(matrix, hermitian=True)``."""
    if matrix.size == 0:
        return matrix
    values, vectors = np.linalg.eigh(matrix)
    order = np.argsort(np.abs(values))[::-1]
    signed = values[order]
    size, left = np.abs(signed), np.take(vectors, order, axis=1)
    inverse = np.zeros(size.shape)
    np.divide(1.0, size, where=size > TUNING.negligible * size[0], out=inverse)
    return np.asarray((left * np.copysign(1.0, signed)) @ (inverse[:, None] * left.T))


Right = TypeVar("Right", FloatArray, ComplexArray)


def normal_band(matrix: csr_array, weights: FloatArray) -> FloatArray:
    """Lower band of ``A^T W A`` for A of shape (n, b), as LAPACK stores it: entry (i, j) at (i - j, j).

    It has as many diagonals as the entries of any row of A are apart; all others are 0.
    """
    size = _most_apart(matrix) + 1
    band = np.zeros((size, matrix.shape[1]))
    # One layout and writable, so that one kernel is compiled for all weights.
    _add_normal(
        band, matrix.indptr, matrix.indices, matrix.data, np.require(weights, requirements=["C", "W"])
    )
    return band


def _most_apart(matrix: csr_array) -> int:
    """Largest distance of two columns with entries in the same row."""
    starts = matrix.indptr[:-1][np.diff(matrix.indptr) > 0]
    if not starts.size:
        return 0
    apart = np.maximum.reduceat(matrix.indices, starts) - np.minimum.reduceat(matrix.indices, starts)
    return int(np.max(apart))


@njit(cache=True, nogil=True)
def _add_normal(
    band: FloatArray,
    pointers: NDArray[np.intp],
    indices: NDArray[np.intp],
    entries: FloatArray,
    weights: FloatArray,
) -> None:
    for row in range(pointers.size - 1):
        for at in range(pointers[row], pointers[row + 1]):
            scaled = entries[at] * weights[row]
            column = indices[at]
            for other in range(pointers[row], pointers[row + 1]):
                below = indices[other] - column
                if below >= 0:
                    band[below, column] += entries[other] * scaled


@dataclass(frozen=True)
class BandedFactor:
    """Cholesky factor L of a banded matrix A = L L^T, its band stored as by `normal_band`."""

    lower: FloatArray

    @classmethod
    def of(cls, band: FloatArray) -> BandedFactor:
        """Factor of the matrix with this band; LinAlgError where it is not positive definite."""
        return cls(cholesky_banded(band, lower=True, check_finite=False))

    def solve(self, right: Right) -> Right:
        """``A^-1 right``, shape (b, c)."""
        if np.iscomplexobj(right) or right.size == 0:
            return cast("Right", cho_solve_banded((self.lower, True), right, check_finite=False))
        # Of small matrices, what SciPy does around the same routine takes most of the time.
        return cast("Right", dpbtrs(self.lower, right, lower=1)[0])

    def whiten(self, right: FloatArray) -> FloatArray:
        """``L^-1 right``, shape (b, c)."""
        return np.asarray(dtbtrs(self.lower, right, uplo="L")[0])
