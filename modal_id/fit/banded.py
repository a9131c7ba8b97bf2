"""Symmetric banded matrices: those of splines, of which each overlaps a few others only."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar, cast

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded
from scipy.linalg.lapack import dtbtrs
from scipy.sparse import sparray

from tracker.arrays import ComplexArray, FloatArray

Right = TypeVar("Right", FloatArray, ComplexArray)


def lower_band(matrix: sparray) -> FloatArray:
    """Diagonal and lower diagonals of a symmetric matrix, (b, b), as LAPACK stores them: entry (i, j) at (i - j, j)."""
    entries = matrix.tocoo()
    below = entries.row - entries.col
    band = np.zeros((int(np.max(below, initial=0)) + 1, matrix.shape[0]))
    lower = below >= 0
    band[below[lower], entries.col[lower]] = entries.data[lower]
    return band


@dataclass(frozen=True)
class BandedFactor:
    """Cholesky factor L of a banded matrix A = L L^T, its band stored as by `lower_band`."""

    lower: FloatArray

    @classmethod
    def of(cls, band: FloatArray) -> BandedFactor:
        """Factor of the matrix with this band; LinAlgError where it is not positive definite."""
        return cls(cholesky_banded(band, lower=True, check_finite=False))

    def solve(self, right: Right) -> Right:
        """``A^-1 right``, shape (b, c)."""
        return cast("Right", cho_solve_banded((self.lower, True), right, check_finite=False))

    def whiten(self, right: FloatArray) -> FloatArray:
        """``L^-1 right``, shape (b, c)."""
        return np.asarray(dtbtrs(self.lower, right, uplo="L")[0])
