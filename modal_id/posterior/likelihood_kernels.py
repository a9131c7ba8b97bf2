"""Compiled loops of the likelihood: chi-square of one mode's pole from its moments, for each walker."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from tracker.arrays import ComplexArray, FloatArray


@numba.njit(cache=True, error_model="numpy")
def own_moments(
    wave: ComplexArray, time_s: FloatArray, weights: FloatArray, terms: int
) -> tuple[ComplexArray, FloatArray]:
    """Weighted sums of ``wave^2 t^j / j!`` and ``|wave|^2 t^j / j!`` for each power j."""
    square, modulus = np.zeros(terms, dtype=np.complex128), np.zeros(terms)
    for row in range(wave.size):
        factor = weights[row]
        value = wave[row] * wave[row]
        size = wave[row].real ** 2 + wave[row].imag ** 2
        for power in range(terms):
            square[power] += factor * value
            modulus[power] += factor * size
            factor *= time_s[row] / (power + 1.0)
    return square, modulus


@numba.njit(cache=True, error_model="numpy")
def horner(moments: ComplexArray, change: complex, out: ComplexArray) -> None:
    """``sum_j moments[j] change^j`` into `out`; moments of shape (terms, m)."""
    last = moments.shape[0] - 1
    for item in range(out.size):
        total = moments[last, item]
        for power in range(last - 1, -1, -1):
            total = total * change + moments[power, item]
        out[item] = total


@numba.njit(cache=True, error_model="numpy")
def _quadratic_form(matrix: FloatArray, right: FloatArray) -> float:
    """``right^T matrix^-1 right`` of a positive definite matrix by Cholesky's factor, in place; NaN if it is not."""
    size = right.size
    total = 0.0
    for i in range(size):
        for j in range(i):
            entry = matrix[i, j]
            for m in range(j):
                entry -= matrix[i, m] * matrix[j, m]
            matrix[i, j] = entry / matrix[j, j]
        pivot = matrix[i, i]
        value = right[i]
        for m in range(i):
            pivot -= matrix[i, m] ** 2
            value -= matrix[i, m] * right[m]
        if not pivot > 0.0:
            return np.nan
        matrix[i, i] = np.sqrt(pivot)
        right[i] = value / matrix[i, i]
        total += right[i] ** 2
    return total


@numba.njit(cache=True, error_model="numpy")
def _gram(
    change: complex,
    fixed_moments: ComplexArray,
    square_moments: ComplexArray,
    modulus_moments: FloatArray,
    group: int,
) -> tuple[float, float, float]:
    """Gram matrix (rr, ri, ii) of the wave's real and imaginary part, all other columns projected out."""
    terms = fixed_moments.shape[0]
    modulus, square = modulus_moments[terms - 1, group], square_moments[terms - 1, group]
    for power in range(terms - 2, -1, -1):
        modulus = modulus * (2.0 * change.real) + modulus_moments[power, group]
        square = square * (2.0 * change) + square_moments[power, group]
    fixed = np.empty(fixed_moments.shape[2], dtype=np.complex128)
    horner(fixed_moments[:, group], change, fixed)
    rr, ii, ri = 0.5 * (modulus + square.real), 0.5 * (modulus - square.real), 0.5 * square.imag
    for value in fixed:
        rr -= value.real**2
        ii -= value.imag**2
        ri -= value.real * value.imag
    return rr, ri, ii


@numba.njit(cache=True, error_model="numpy")
def chi_squares(
    changes: ComplexArray,
    data_moments: ComplexArray,
    fixed_moments: ComplexArray,
    square_moments: ComplexArray,
    modulus_moments: FloatArray,
    products: FloatArray,
    group: NDArray[np.intp],
    variance: FloatArray,
) -> FloatArray:
    """Residual sum of squares over the noise variance; arguments as in `likelihood.ReducedLikelihood`."""
    k, v = products.shape[0], products.shape[1]
    result = np.empty(changes.size)
    grams = np.empty((square_moments.shape[1], 3))
    data = np.empty(v, dtype=np.complex128)
    total = np.empty((v, v))
    for walker in range(changes.size):
        change = changes[walker]
        for index in range(grams.shape[0]):
            grams[index] = _gram(change, fixed_moments, square_moments, modulus_moments, index)
        total[:] = 0.0
        for channel in range(k):
            rr, ri, ii = grams[group[channel]]
            scale = 1.0 / (variance[channel] * (rr * ii - ri * ri))
            horner(data_moments[:, channel], change, data)
            for a in range(v):
                left_r = (ii * data[a].real - ri * data[a].imag) * scale
                left_i = (rr * data[a].imag - ri * data[a].real) * scale
                for b in range(a + 1):
                    explained = left_r * data[b].real + left_i * data[b].imag
                    total[a, b] += products[channel, a, b] / variance[channel] - explained
        result[walker] = total[0, 0]
        if v > 1:
            result[walker] -= _quadratic_form(total[1:, 1:], total[1:, 0].copy())
    return result
