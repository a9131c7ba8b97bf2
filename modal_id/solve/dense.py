"""Small dense systems: what NumPy and SciPy do around the same LAPACK routines takes most of their time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import LinAlgError
from scipy.linalg.lapack import dpotrf, dpotrs

from tracker import FloatArray


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
