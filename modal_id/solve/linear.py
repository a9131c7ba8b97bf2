"""The linear part of the fit: amplitudes and baseline of every channel for given mode functions."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.sparse import csr_array, vstack

from modal_id.data import FitData, neighbour_sums, row_blocks
from modal_id.solve.weighting import (
    BLOCK_ROWS,
    BandedFactor,
    LongArray,
    SparseColumns,
    Weighting,
    cholesky,
    scaled_rows,
    solve,
    some_rows,
    weighting,
)
from tracker import ComplexArray, FloatArray


@dataclass(frozen=True)
class Tuning:
    """Rounding."""

    #: [1] relative ridge of the normal equations
    #: physics: Keeps them solvable where a baseline spline sees no sample; above rounding.
    ridge: float = 1e-13


TUNING = Tuning()
RIDGE = TUNING.ridge

_ROUNDING = 32.0 * np.finfo(float).eps


@dataclass(frozen=True)
class Problem:
    """Data and the baseline that is projected out of them.

    The baseline's columns, shape (n, b), B-splines or any array, are fixed: their part of the normal equations is
    computed once.
    """

    data: FitData
    baseline: FloatArray | SparseColumns

    @cached_property
    def sparse(self) -> SparseColumns:
        """Columns of the baseline, sparse."""
        return csr_array(self.baseline) if isinstance(self.baseline, np.ndarray) else self.baseline

    @cached_property
    def mean_square(self) -> float:
        """Weighted mean square of the data."""
        data = self.data
        total = np.einsum("nk,nk,nk->", data.weights, data.values, data.values)
        return float(total) / max(float(np.sum(data.counts)), 1.0)

    @cached_property
    def weighting(self) -> Weighting:
        """Weighted inner products for each group of channels."""
        return weighting(self.data, self.sparse)

    @cached_property
    def slow(self) -> tuple[SlowPart, ...]:
        """Part of the normal equations that the baseline contributes, for each group of channels."""
        parts = []
        normals = self.weighting.baseline_normal()
        for normal, moment in zip(normals, self.weighting.baseline_own(self.data.values), strict=True):
            normal[0] += RIDGE * float(np.max(normal[0])) + 1e-300
            factor = BandedFactor.of(normal)
            parts.append(SlowPart(factor, moment, factor.solve(moment)))
        return tuple(parts)

    def thinned(self, factor: int) -> Problem:
        """The problem with each `factor` neighbouring samples averaged, close to it where they hardly differ."""
        parts = []
        for rows in row_blocks(self.data.time_s.size, factor * BLOCK_ROWS):
            own = self.sparse[rows]
            total, count = neighbour_sums(own.shape[0], factor)
            parts.append(scaled_rows(total @ own, 1.0 / count))
        return Problem(self.data.averaged(factor), vstack(parts, format="csr"))


@dataclass(frozen=True)
class SlowPart:
    """Baseline of one group: Cholesky factor of its Gram matrix, moments with the data."""

    factor: BandedFactor
    moment: FloatArray
    solved: FloatArray


@dataclass(frozen=True)
class GroupFactor:
    """Normal equations of the mode functions for one group, baseline eliminated.

    ``factor`` is the Cholesky factor of the Gram matrix of the real columns, ``slow``, shape (b, 2 m), the baseline
    coefficients of each column.
    """

    factor: tuple[FloatArray, bool]
    slow: FloatArray


@dataclass(frozen=True)
class LinearSolution:
    """Best amplitudes and baseline for given mode functions.

    Attributes
    ----------
    amplitudes : complex array, shape (m, k)
        Channel k moves as ``Re(sum_m amplitudes[m, k] functions[:, m])`` above its baseline.
    slow : array, shape (b, k)
        Coefficients of the baseline.
    splines : SparseColumns, shape (n, b)
        Its columns.
    residual : array, shape (n, k)
        Data less fit; meaningless where the weight is 0.
    rss : array, shape (k,)
        Weighted sum of squares of the residual.
    noise_variance : array, shape (k,)
        Of a sample with weight 1.
    columns : LongArray, shape (n, 2 m)
        Real and imaginary parts of the functions.
    factors : tuple of GroupFactor
    """

    amplitudes: ComplexArray
    slow: FloatArray
    splines: SparseColumns
    residual: FloatArray
    rss: FloatArray
    noise_variance: FloatArray
    columns: LongArray
    factors: tuple[GroupFactor, ...]

    @property
    def baseline(self) -> FloatArray:
        """Of each channel, shape (n, k)."""
        return _baseline(self.splines, self.slow)


def solve_linear(problem: Problem, columns: LongArray) -> LinearSolution:
    """Weighted least squares of every channel on mode functions and baseline.

    `columns`, shape (n, 2 m), are the real and imaginary parts of the functions as neighbouring columns.
    The noise variance is at least 1e-16 of the channels' mean square, so that noise-free data can be fitted.
    """
    data = problem.data
    k, p = data.values.shape[1], columns.shape[1]
    coefficients = np.zeros((p, k))
    slow = np.zeros((problem.baseline.shape[1], k))
    factors = []
    products = problem.weighting.products(columns, data.values)
    for group, part, own in zip(problem.weighting.groups, problem.slow, products, strict=True):
        bound = part.factor.solve(own.baseline)
        gram = own.inner - own.baseline.T @ bound
        # Where the baseline explains the functions at the used samples, or they are 0 there, only rounding errors of
        # the products are left: of functions that begin with 1.
        ridge = max(
            RIDGE * (np.max(np.diag(gram), initial=0.0) + 1e-300),
            _ROUNDING * np.max(np.diag(own.inner), initial=1.0),
        )
        gram.flat[:: p + 1] += ridge
        factor = cholesky(gram)
        if p:
            moment = own.values - bound.T @ part.moment
            coefficients[:, group.channels] = solve(factor, moment)
        slow[:, group.channels] = part.solved - bound @ coefficients[:, group.channels]
        factors.append(GroupFactor(factor, bound))
    residual, rss = _residual(problem, slow, columns, coefficients)
    dof = np.maximum(data.counts - p - slow.shape[0], 1.0)
    variance = np.maximum(rss / dof, 1e-16 * problem.mean_square + 1e-300)
    amplitudes = coefficients[0::2] - 1j * coefficients[1::2]
    return LinearSolution(amplitudes, slow, problem.sparse, residual, rss, variance, columns, tuple(factors))


def _baseline(splines: SparseColumns, slow: FloatArray) -> FloatArray:
    """Baseline with these coefficients, shape (b, k); shape (n, k)."""
    n = splines.shape[0]
    found = np.empty((n, slow.shape[1]))
    for rows in row_blocks(n, BLOCK_ROWS):
        found[rows] = some_rows(splines, rows) @ slow
    return found


def _residual(
    problem: Problem, slow: FloatArray, columns: LongArray, coefficients: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Values less baseline and modes, shape (n, k), and their weighted sums of squares, shape (k,)."""
    values, weights = np.ascontiguousarray(problem.data.values), np.ascontiguousarray(problem.data.weights)
    residual, rss = np.empty(values.shape), np.zeros(values.shape[1])
    for rows in row_blocks(values.shape[0], BLOCK_ROWS):
        splines = some_rows(problem.sparse, rows)
        _subtract(
            values[rows],
            weights[rows],
            (splines.indptr, splines.indices, splines.data),
            slow,
            np.ascontiguousarray(columns[rows]),
            coefficients,
            residual[rows],
            rss,
        )
    return residual, rss


@njit(cache=True, nogil=True, error_model="numpy")
def _subtract(
    values: FloatArray,
    weights: FloatArray,
    splines: tuple[NDArray[np.intp], NDArray[np.intp], FloatArray],
    slow: FloatArray,
    columns: FloatArray,
    coefficients: FloatArray,
    residual: FloatArray,
    rss: FloatArray,
) -> None:
    """Residual of some rows, and its weighted squares added to `rss`.

    In one pass, because each pass over a long record takes longer than its arithmetic. `splines` are the row pointers,
    column indices and entries of a sparse array.
    """
    pointers, indices, entries = splines
    n, k = values.shape
    for row in range(n):
        for channel in range(k):
            left = values[row, channel]
            for at in range(pointers[row], pointers[row + 1]):
                left -= entries[at] * slow[indices[at], channel]
            for column in range(columns.shape[1]):
                left -= columns[row, column] * coefficients[column, channel]
            residual[row, channel] = left
            rss[channel] += weights[row, channel] * left * left


def without_fit(problem: Problem, linear: LinearSolution, values: FloatArray) -> FloatArray:
    """Other values, shape (n, c), at the same samples less their fit by baseline and mode functions.

    The weights of the first group of channels hold for all of them.
    """
    part, own, weighted = problem.slow[0], linear.factors[0], problem.weighting
    moment = weighted.baseline(values)[0]
    score = weighted.inner(linear.columns, values)[0] - own.slow.T @ moment
    coefficients = solve(own.factor, score)
    slow = part.factor.solve(moment) - own.slow @ coefficients
    left = values - _baseline(problem.sparse, slow)
    for rows in row_blocks(values.shape[0], BLOCK_ROWS):
        left[rows] -= linear.columns[rows] @ coefficients
    return np.asarray(left)


def projected_grams(
    problem: Problem, linear: LinearSolution, columns: LongArray
) -> list[tuple[FloatArray, FloatArray]]:
    """Gram matrix (q, q) of further columns (n, q) with mode functions and baseline projected out, and their score.

    For each group of channels. The score, shape (q, channels of the group), is their weighted inner product with the
    residual.
    """
    products = problem.weighting.products(columns, linear.residual, linear.columns)
    result = []
    for part, own, found in zip(problem.slow, linear.factors, products, strict=True):
        mixed = found.fitted - own.slow.T @ found.baseline
        gram = found.inner - found.baseline.T @ part.factor.solve(found.baseline)
        gram -= mixed.T @ solve(own.factor, mixed)
        result.append((gram, found.values))
    return result
