"""Compiled kernel of the sampler: chi-square of a pole from its moments."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tracker import ComplexArray, FloatArray


@njit(cache=True, nogil=True, error_model="numpy")
def chi_square_of(
    change: ComplexArray,
    data: ComplexArray,
    fixed_squares: ComplexArray,
    fixed_moduli: ComplexArray,
    square: ComplexArray,
    modulus: FloatArray,
    products: FloatArray,
    group: NDArray[np.intp],
    variance: FloatArray,
) -> FloatArray:
    """Residual sum of squares over the noise variance for each change, shape (w,); NaN where it is undefined.

    The arrays are those of `modal_id.posterior.likelihood.ReducedLikelihood`.
    """
    terms, k, v = data.shape
    groups = square.shape[1]
    result = np.empty(change.size)
    powers = np.empty(terms, dtype=np.complex128)
    gram = np.empty((groups, 3))
    moment = np.empty(v, dtype=np.complex128)
    total = np.empty((v, v))
    for w in range(change.size):
        powers[0] = 1.0
        for p in range(1, terms):
            powers[p] = powers[p - 1] * change[w]
        for g in range(groups):
            _wave_gram(
                change[w], powers, square[:, g], modulus[:, g], fixed_squares[g], fixed_moduli[g], gram[g]
            )
        total[:] = 0.0
        for c in range(k):
            rr, ii, ri = gram[group[c]]
            scale = 1.0 / (variance[c] * (rr * ii - ri * ri))
            for a in range(v):
                value = 0.0j
                for p in range(terms):
                    value += powers[p] * data[p, c, a]
                moment[a] = value
            for a in range(v):
                left = scale * (ii * moment[a].real - ri * moment[a].imag)
                right = scale * (rr * moment[a].imag - ri * moment[a].real)
                for b in range(v):
                    explained = left * moment[b].real + right * moment[b].imag
                    total[a, b] += products[c, a, b] / variance[c] - explained
        result[w] = _less_shared(total)
    return result


@njit(cache=True, nogil=True, error_model="numpy")
def _wave_gram(
    change: complex,
    powers: ComplexArray,
    square: ComplexArray,
    modulus: FloatArray,
    fixed_squares: ComplexArray,
    fixed_moduli: ComplexArray,
    gram: FloatArray,
) -> None:
    """Inner products of the wave's real and imaginary part (rr, ii, ri), all other columns projected out."""
    both, absolute, both_power, absolute_power = 0.0j, 0.0, 1.0 + 0.0j, 1.0
    for p in range(powers.size):
        both += both_power * square[p]
        absolute += absolute_power * modulus[p]
        both_power *= 2.0 * change
        absolute_power *= 2.0 * change.real
        row, mixed = 0.0j, 0.0j
        for q in range(powers.size):
            row += powers[q] * fixed_squares[p, q]
            mixed += powers[q].conjugate() * fixed_moduli[p, q]
        both -= powers[p] * row
        absolute -= (powers[p] * mixed).real
    gram[0], gram[1], gram[2] = 0.5 * (absolute + both.real), 0.5 * (absolute - both.real), 0.5 * both.imag


@njit(cache=True, nogil=True, error_model="numpy")
def _less_shared(total: FloatArray) -> float:
    """``total[0, 0]`` less what the other rows explain (Schur complement); NaN where they are not positive definite."""
    v = total.shape[0]
    for pivot in range(v - 1, 0, -1):
        if not total[pivot, pivot] > 0.0:
            return np.nan
        for a in range(pivot):
            ratio = total[a, pivot] / total[pivot, pivot]
            for b in range(pivot):
                total[a, b] -= ratio * total[pivot, b]
    return float(total[0, 0])
