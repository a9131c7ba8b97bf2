"""Weighted inner products of columns for each group of channels; groups that differ in few samples share them.

Cholesky factors by LAPACK directly: what NumPy and SciPy do around it takes most of the time of small systems.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol, TypeVar, cast

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.linalg import LinAlgError, cho_solve_banded, cholesky_banded
from scipy.linalg.lapack import dpbtrs, dpotrf, dpotrs, dtbtrs
from scipy.sparse import csc_array, csr_array

from modal_id.data import FitData, row_blocks
from tracker import ComplexArray, FloatArray


@dataclass(frozen=True)
class Tuning:
    """Rounding, products shared."""

    #: [1] eigenvalue over the largest that counts as 0
    #: convention: As in `numpy.linalg.pinv`.
    negligible: float = 1e-15
    #: [1] largest share of samples in which the weights of groups that share products may differ
    #: convention: Limits the computing time.
    max_different: float = 0.1


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


# Samples at a time: SciPy copies both factors of a sparse product, and columns are made when they are needed.
BLOCK_ROWS = 16_384


class LongArray(Protocol):
    """An array of shape (n, c), or one of which any rows are made when they are needed."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Of the array."""

    def __getitem__(self, rows: Any, /) -> FloatArray:
        """Some of its rows."""


class SparseColumns(Protocol):
    """A sparse array of shape (n, b), or one of which any rows are made when they are needed."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Of the array."""

    def __getitem__(self, rows: Any, /) -> csr_array:
        """Some of its rows."""


@dataclass(frozen=True)
class Base:
    """Weights that groups share up to a few samples.

    ``channels`` are those of all groups of the base; ``is_one`` where all weights are 1.
    """

    weights: FloatArray
    channels: NDArray[np.intp]
    is_one: bool

    def times(self, some: FloatArray, rows: slice) -> FloatArray:
        """These rows of columns times weights; not a copy where these are 1."""
        return some if self.is_one else some * self.weights[rows, None]

    def own(self, values: FloatArray) -> FloatArray:
        """Columns of its channels; not a copy where these are all."""
        is_all = self._are_neighbours and self.channels.size == values.shape[1]
        return values if is_all else values[:, self.channels]

    @cached_property
    def _are_neighbours(self) -> bool:
        return bool(np.all(np.diff(self.channels) == 1))


@dataclass(frozen=True)
class Group:
    """Channels of equal weights: those of a base plus ``delta`` at ``rows``; ``splines``: the baseline there."""

    channels: NDArray[np.intp]
    base: int
    rows: NDArray[np.intp]
    delta: FloatArray
    splines: csr_array

    @cached_property
    def transposed(self) -> csc_array:
        """The baseline there, transposed once: to SciPy that costs more than a product."""
        return self.splines.T


@dataclass(frozen=True)
class Products:
    """Weighted inner products of columns C for one group of channels.

    ``baseline`` is ``B^T W C`` with the baseline's columns B, ``inner`` is ``C^T W C``, ``values`` is ``C^T W Y`` with
    the values Y of the group's own channels, ``fitted`` is ``F^T W C`` with the columns F of a fit.
    """

    baseline: FloatArray
    inner: FloatArray
    values: FloatArray
    fitted: FloatArray


@dataclass(frozen=True)
class Weighting:
    """Weights of some data as bases and groups, and the columns of the baseline, shape (n, b)."""

    splines: SparseColumns
    bases: tuple[Base, ...]
    groups: tuple[Group, ...]

    @cached_property
    def _all_transposed(self) -> csc_array:
        """``B^T`` of the baseline's columns B: to SciPy it costs more than a product."""
        return self.splines[:].T

    def _transposed(self, rows: slice) -> csc_array:
        """``B^T`` for some samples; that of all is kept where they are one block."""
        return self._all_transposed if self.splines.shape[0] <= BLOCK_ROWS else self.splines[rows].T

    def inner(self, left: LongArray, right: LongArray) -> list[FloatArray]:
        """``left^T W right`` for the weights W of each group."""
        full = [self._product(base, left, right) for base in self.bases]
        return [
            full[g.base] + left[g.rows].T @ (g.delta[:, None] * right[g.rows])
            if g.rows.size
            else full[g.base]
            for g in self.groups
        ]

    def products(
        self, columns: LongArray, values: FloatArray, fitted: LongArray | None = None
    ) -> Iterator[Products]:
        """Products of columns for each group, in one pass; `values` have shape (n, k)."""
        full = [self._products(base, columns, values, fitted) for base in self.bases]
        for group in self.groups:
            own, channels = full[group.base], group.channels
            if group.rows.size:
                some, rows = columns[group.rows], group.rows
                scaled = group.delta[:, None] * some
                beside = scaled[:, :0] if fitted is None else fitted[rows]
                yield Products(
                    own.baseline + group.transposed @ scaled,
                    own.inner + some.T @ scaled,
                    own.values[:, channels] + scaled.T @ values[np.ix_(rows, channels)],
                    own.fitted + beside.T @ scaled,
                )
            else:
                yield Products(own.baseline, own.inner, own.values[:, channels], own.fitted)

    def _products(
        self, base: Base, columns: LongArray, values: FloatArray, fitted: LongArray | None
    ) -> Products:
        count = columns.shape[1]
        baseline, inner = np.zeros((self.splines.shape[1], count)), np.zeros((count, count))
        own = np.zeros((count, values.shape[1]))
        beside = np.zeros((0 if fitted is None else fitted.shape[1], count))
        for rows in row_blocks(base.weights.size, BLOCK_ROWS):
            some = columns[rows]
            weighted = base.times(some, rows)
            baseline += self._transposed(rows) @ weighted
            inner += some.T @ weighted
            own[:, base.channels] += weighted.T @ base.own(values[rows])
            if fitted is not None:
                beside += fitted[rows].T @ weighted
        return Products(baseline, inner, own, beside)

    def baseline(self, right: LongArray) -> list[FloatArray]:
        """``B^T W right`` for the baseline's columns B."""
        full = [self._spline_product(base, right) for base in self.bases]
        return [
            full[g.base] + g.transposed @ (g.delta[:, None] * right[g.rows]) if g.rows.size else full[g.base]
            for g in self.groups
        ]

    def baseline_own(self, values: FloatArray) -> list[FloatArray]:
        """``B^T W values`` with the values, shape (n, k), of the group's own channels only."""
        full = [self._spline_product(base, values) for base in self.bases]
        return [
            full[g.base][:, g.channels]
            + g.transposed @ (g.delta[:, None] * values[np.ix_(g.rows, g.channels)])
            for g in self.groups
        ]

    def _spline_product(self, base: Base, right: LongArray) -> FloatArray:
        """``B^T W right``, summed like `_product`."""
        total = np.zeros((self.splines.shape[1], right.shape[1]))
        for rows in row_blocks(base.weights.size, BLOCK_ROWS):
            total += self._transposed(rows) @ base.times(right[rows], rows)
        return total

    def _product(self, base: Base, left: LongArray, right: LongArray) -> FloatArray:
        """``left^T W right``, summed over some samples at a time: no factor is held for all of them."""
        total = np.zeros((left.shape[1], right.shape[1]))
        for rows in row_blocks(base.weights.size, BLOCK_ROWS):
            total += left[rows].T @ base.times(right[rows], rows)
        return total

    def baseline_normal(self) -> list[FloatArray]:
        """``B^T W B``, which is banded: each as by `normal_band`."""
        full = [_normal(self.splines, base) for base in self.bases]
        return [_sum_of_bands(full[g.base], normal_band(g.splines, g.delta)) for g in self.groups]


def weighting(data: FitData, splines: SparseColumns) -> Weighting:
    """Bases and groups of the data's weights, with the baseline's columns, shape (n, b)."""
    top = np.max(data.weights, axis=1)
    usual = np.count_nonzero(top != 1.0) <= TUNING.max_different * top.size
    chosen: list[FloatArray] = [np.broadcast_to(1.0, top.shape) if usual else top]
    members: list[list[int]] = [[]]
    groups = []
    for channels, weights in data.groups:
        differs = [np.flatnonzero(weights != base) for base in chosen]
        near = [
            place for place, rows in enumerate(differs) if rows.size <= TUNING.max_different * weights.size
        ]
        if not near:
            near = [len(chosen)]
            chosen.append(weights)
            members.append([])
            differs.append(np.empty(0, dtype=np.intp))
        place, rows = near[0], differs[near[0]]
        members[place].extend(channels)
        groups.append((channels, place, rows, weights[rows] - chosen[place][rows]))
    # The first base has no group where the weights of every channel are its own.
    unused = 0 if members[0] else 1
    bases = []
    for weights, own in zip(chosen[unused:], members[unused:], strict=True):
        is_one = bool(np.all(weights == 1.0))
        bases.append(Base(weights, np.array(own, dtype=np.intp), is_one))
    parts = (Group(c, place - unused, rows, delta, splines[rows]) for c, place, rows, delta in groups)
    return Weighting(splines, tuple(bases), tuple(parts))


def some_rows(splines: SparseColumns, rows: slice) -> csr_array:
    """Some rows of sparse columns; where these are all, not the copy that SciPy would make."""
    count = splines.shape[0]
    is_whole = isinstance(splines, csr_array) and rows.indices(count) == (0, count, 1)
    return splines if is_whole else splines[rows]


def scaled_rows(matrix: csr_array, factor: FloatArray) -> csr_array:
    """The matrix with each row times its factor."""
    entries = matrix.data * np.repeat(factor, np.diff(matrix.indptr))
    return csr_array((entries, matrix.indices, matrix.indptr), shape=matrix.shape)


def _normal(splines: SparseColumns, base: Base) -> FloatArray:
    """``B^T W B`` of the weights of a base, as by `normal_band`."""
    total = np.zeros((1, splines.shape[1]))
    for rows in row_blocks(splines.shape[0], BLOCK_ROWS):
        total = _sum_of_bands(total, normal_band(some_rows(splines, rows), base.weights[rows]))
    return total


def _sum_of_bands(one: FloatArray, other: FloatArray) -> FloatArray:
    total = np.zeros((max(len(one), len(other)), one.shape[1]))
    total[: len(one)] = one
    total[: len(other)] += other
    return total
