"""Compiled kernels of the sampler: chi-square of a pole from its moments, and the kernel density of the proposals."""

from __future__ import annotations

from math import exp, log, sqrt

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tracker.arrays import ComplexArray, FloatArray


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


@njit(cache=True, nogil=True, error_model="numpy")
def propose_from_kernels(
    own: FloatArray, centres: FloatArray, picks: NDArray[np.intp], normals: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Draws from Gaussian kernels at the centres, and log density at `own` less that at the draws.

    Of several ensembles: `own` has shape (e, w, 2), `centres` (e, m, 2), `picks` (e, w), `normals` (e, w, 2); the
    results (e, w, 2) and (e, w). The kernels have the covariance of the centres times ``m^(-1/3)`` (Scott's factor in
    two dimensions). NaN where the centres coincide or lie on a line.
    """
    proposed, ratio = np.empty_like(own), np.empty(picks.shape)
    white = np.empty_like(centres[0])
    for e in range(own.shape[0]):
        mean_x, mean_y, a, b, d = _whitened(centres[e], white)
        for w in range(own.shape[1]):
            pick = picks[e, w]
            u, v = normals[e, w]
            proposed[e, w, 0] = centres[e, pick, 0] + a * u
            proposed[e, w, 1] = centres[e, pick, 1] + b * u + d * v
            x = (own[e, w, 0] - mean_x) / a
            before = _log_kernel_density(x, (own[e, w, 1] - mean_y - b * x) / d, white)
            after = _log_kernel_density(white[pick, 0] + u, white[pick, 1] + v, white)
            ratio[e, w] = before - after
    return proposed, ratio


@njit(cache=True, nogil=True, error_model="numpy")
def _whitened(centres: FloatArray, white: FloatArray) -> tuple[float, float, float, float, float]:
    """Mean (x, y) and Cholesky factor (a, b, d) of the kernels' covariance; `white` receives the whitened centres."""
    m = centres.shape[0]
    mean_x, mean_y = float(np.mean(centres[:, 0])), float(np.mean(centres[:, 1]))
    xx, xy, yy = 0.0, 0.0, 0.0
    for c in range(m):
        x, y = centres[c, 0] - mean_x, centres[c, 1] - mean_y
        xx += x * x
        xy += x * y
        yy += y * y
    scale = m ** (-1.0 / 3.0) / (m - 1.0)
    a = sqrt(scale * xx)
    b = scale * xy / a
    d = sqrt(scale * yy - b * b)
    for c in range(m):
        white[c, 0] = (centres[c, 0] - mean_x) / a
        white[c, 1] = (centres[c, 1] - mean_y - b * white[c, 0]) / d
    return mean_x, mean_y, a, b, d


@njit(cache=True, nogil=True, error_model="numpy")
def _log_kernel_density(x: float, y: float, centres: FloatArray) -> float:
    """Log of the sum of unit Gaussian kernels at the centres."""
    nearest = np.inf
    for c in range(centres.shape[0]):
        nearest = min(nearest, (x - centres[c, 0]) ** 2 + (y - centres[c, 1]) ** 2)
    total = 0.0
    for c in range(centres.shape[0]):
        total += exp(-0.5 * ((x - centres[c, 0]) ** 2 + (y - centres[c, 1]) ** 2 - nearest))
    return log(total) - 0.5 * nearest
