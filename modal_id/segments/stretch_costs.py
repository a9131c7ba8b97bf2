"""Compiled cost of every stretch of a line's block amplitudes, as noise, one damped wave or two."""

from __future__ import annotations

import numpy as np
from numba import njit

from tracker import ComplexArray, FloatArray

# Gauss-Newton steps of each wave; the pole of a stretch is nearly known from one block less.
_STEPS = 3
# Largest exponent of a wave from the middle of its stretch, largest growth of a pole in a block, and of each of two.
_MOST_GROWTH, _GROWS, _BOTH_GROW = 40.0, 0.05, 1.3
# Share of the largest possible determinant below which two columns are one.
_SINGULAR = 1e-12


@njit(cache=True, nogil=True, error_model="numpy")
def stretch_costs(amplitude: ComplexArray, relative: float, penalty: float) -> tuple[FloatArray, FloatArray]:
    """-2 ln likelihood and penalty of the stretch from each edge to each later one, and its number of waves.

    Parameters
    ----------
    amplitude : complex array, shape (b, k)
        In b blocks, with noise of variance 1; NaN where unknown.
    relative : float
        Error of a wave over its amplitude.
    penalty : float
        Cost of each real parameter.

    Returns
    -------
    cost, waves : array, shape (b + 1, b + 1)
        Infinite and 0 where there is no stretch.
    """
    n, k = amplitude.shape
    cost, waves = np.full((n + 1, n + 1), np.inf), np.zeros((n + 1, n + 1))
    a, power, weight = np.zeros((n, k), dtype=np.complex128), np.zeros(n), np.zeros(n)
    for b in range(n):
        own = np.sum(np.abs(amplitude[b]) ** 2)
        if np.isfinite(own):
            a[b], power[b], weight[b] = amplitude[b], own, 1.0 / (1.0 + relative**2 * own)
    for i in range(n):
        log_variance, energy, count, lag, before = 0.0, 0.0, 0, 0j, 0.0
        for j in range(i + 1, n + 1):
            b = j - 1
            if weight[b] > 0.0:
                log_variance -= 2.0 * k * np.log(weight[b])
                energy += power[b]
                count += 1
                if b > i and weight[b - 1] > 0.0:
                    lag += np.sum(np.conj(a[b - 1]) * a[b]) * weight[b - 1]
                    before += (power[b - 1] - k) * weight[b - 1]
            variance = max(energy / max(k * count, 1), 1.0)
            cost[i, j] = 2.0 * k * count * np.log(variance) + 2.0 * energy / variance + penalty
            if count >= 3:
                start = lag / max(before, 0.8 * abs(lag) + 1e-300)
                found, which = _of_waves(a[i:j], weight[i:j], start, count, penalty)
                if found + log_variance < cost[i, j]:
                    cost[i, j], waves[i, j] = found + log_variance, which
    return cost, waves


@njit(cache=True, nogil=True, error_model="numpy")
def _of_waves(
    a: ComplexArray, weight: FloatArray, start: complex, count: int, penalty: float
) -> tuple[float, float]:
    """Least cost of a wave, a bent wave or two waves, and their number."""
    k = a.shape[1]
    rss, pole = _one_wave(a, weight, start, 0)
    least, which = rss + (2 + 2 * k) * penalty, 1.0
    if count >= 5 and rss > 2.0 * k * count + 2.0 * penalty:
        rss, _ = _one_wave(a, weight, pole, 1)
        least = min(least, rss + (4 + 2 * k) * penalty)
        if count >= 6 and rss > 2.0 * k * count + 2.0 * k * penalty:
            rss = _two_waves(a, weight)
            if rss + (4 + 4 * k) * penalty < least:
                least, which = rss + (4 + 4 * k) * penalty, 2.0
    return least, which


@njit(cache=True, nogil=True, error_model="numpy")
def _one_wave(a: ComplexArray, weight: FloatArray, pole: complex, bends: int) -> tuple[float, complex]:
    """Twice the least weighted rss of ``c exp(l x + q x^2)``, x from the middle, and ``exp(l)``; q = 0 unless it bends.

    The wave is holomorphic in l and q: Gauss-Newton in complex numbers, the amplitudes projected out.
    """
    n, k = a.shape
    x = np.arange(n) - 0.5 * (n - 1)
    rate, bend = np.log(pole + 1e-12), 0j
    least, best = np.inf, rate
    for _ in range(_STEPS + 1):
        exponent = rate * x + bend * x * x
        wave = np.exp(np.minimum(exponent.real, _MOST_GROWTH) + 1j * exponent.imag)
        own = weight * np.abs(wave) ** 2
        s0, s1, s2 = np.sum(own), np.sum(own * x), np.sum(own * x**2)
        s3, s4 = np.sum(own * x**3), np.sum(own * x**4)
        rss, size, g1, g2 = 0.0, 0.0, 0j, 0j
        for c in range(k):
            amplitude = np.sum(weight * np.conj(wave) * a[:, c]) / max(s0, 1e-300)
            left = a[:, c] - amplitude * wave
            along = weight * np.conj(amplitude * wave) * left
            rss += 2.0 * np.sum(weight * np.abs(left) ** 2)
            size += abs(amplitude) ** 2
            g1 += np.sum(along * x)
            g2 += np.sum(along * x * x)
        if rss < least:
            least, best = rss, rate
        h11, h12, h22 = (s2 - s1**2 / s0) * size, (s3 - s1 * s2 / s0) * size, (s4 - s2**2 / s0) * size
        det = h11 * h22 - h12 * h12
        if not h11 > 0.0 or (bends and not det > _SINGULAR * h11 * h22):
            break
        if bends:
            rate, bend = rate + (h22 * g1 - h12 * g2) / det, bend + (h11 * g2 - h12 * g1) / det
        else:
            rate = rate + g1 / h11
            # no free motion grows
            rate = min(rate.real, _GROWS) + 1j * rate.imag
    return least, np.exp(best)


@njit(cache=True, nogil=True, error_model="numpy")
def _two_waves(a: ComplexArray, weight: FloatArray) -> float:
    """Twice the least weighted rss of two waves, from linear prediction by two blocks and Gauss-Newton."""
    known = weight[:-2] * weight[1:-1] * weight[2:] > 0.0
    g00 = g11 = 0.0
    g01 = y0 = y1 = 0j
    for c in range(a.shape[1]):
        first, second, third = a[:-2, c] * known, a[1:-1, c] * known, a[2:, c] * known
        g00 += np.sum(np.abs(second) ** 2)
        g11 += np.sum(np.abs(first) ** 2)
        g01 += np.sum(np.conj(second) * first)
        y0 += np.sum(np.conj(second) * third)
        y1 += np.sum(np.conj(first) * third)
    det = g00 * g11 - abs(g01) ** 2
    if not det > _SINGULAR * g00 * g11:
        return np.inf
    first_, second_ = (g11 * y0 - g01 * y1) / det, (g00 * y1 - np.conj(g01) * y0) / det
    root = np.sqrt(first_ * first_ + 4.0 * second_)
    poles = np.array([0.5 * (first_ + root), 0.5 * (first_ - root)])
    least = np.inf
    for _ in range(_STEPS + 1):
        if not (np.max(np.abs(poles)) < _BOTH_GROW and abs(poles[0] - poles[1]) > 1e-9):
            break
        rss, step = _step_of_two(a, weight, poles)
        least = min(least, rss)
        if not np.all(np.isfinite(step)):
            break
        poles = poles + step
    return least


@njit(cache=True, nogil=True, error_model="numpy")
def _step_of_two(a: ComplexArray, weight: FloatArray, poles: ComplexArray) -> tuple[float, ComplexArray]:
    """Twice the weighted rss of two waves, and the Gauss-Newton step of their poles, amplitudes projected out."""
    n, k = a.shape
    waves, slopes = np.zeros((2, n), dtype=np.complex128), np.zeros((2, n), dtype=np.complex128)
    waves[:, 0] = 1.0
    for b in range(1, n):
        waves[:, b] = waves[:, b - 1] * poles
        slopes[:, b] = slopes[:, b - 1] * poles + waves[:, b - 1]
    gram = _products(waves, waves, weight)
    step = np.full(2, np.nan, dtype=np.complex128)
    if not _is_regular(gram):
        return np.inf, step
    inverse = _inverse(gram)
    # what the waves do not explain of their derivatives by the poles
    cross = _products(waves, slopes, weight)
    for u in range(2):
        shares = inverse[:, 0] * cross[0, u] + inverse[:, 1] * cross[1, u]
        slopes[u] -= shares[0] * waves[0] + shares[1] * waves[1]
    curvature = np.zeros((2, 2), dtype=np.complex128)
    rss, along = 0.0, np.zeros(2, dtype=np.complex128)
    for c in range(k):
        moment0 = np.sum(weight * np.conj(waves[0]) * a[:, c])
        moment1 = np.sum(weight * np.conj(waves[1]) * a[:, c])
        amplitude = inverse[:, 0] * moment0 + inverse[:, 1] * moment1
        left = a[:, c] - amplitude[0] * waves[0] - amplitude[1] * waves[1]
        rss += 2.0 * np.sum(weight * np.abs(left) ** 2)
        for u in range(2):
            along[u] += np.conj(amplitude[u]) * np.sum(weight * np.conj(slopes[u]) * left)
            curvature[u] += np.conj(amplitude[u]) * amplitude
    curvature *= _products(slopes, slopes, weight)
    if _is_regular(curvature):
        solved = _inverse(curvature)
        step[:] = solved[:, 0] * along[0] + solved[:, 1] * along[1]
    return rss, step


@njit(cache=True, nogil=True, error_model="numpy")
def _products(left: ComplexArray, right: ComplexArray, weight: FloatArray) -> ComplexArray:
    """Weighted inner products of the rows of two arrays of two rows."""
    found = np.empty((2, 2), dtype=np.complex128)
    for u in range(2):
        for v in range(2):
            found[u, v] = np.sum(weight * np.conj(left[u]) * right[v])
    return found


@njit(cache=True, nogil=True, error_model="numpy")
def _is_regular(m: ComplexArray) -> bool:
    return bool(abs(m[0, 0] * m[1, 1] - m[0, 1] * m[1, 0]) > _SINGULAR * abs(m[0, 0] * m[1, 1]))


@njit(cache=True, nogil=True, error_model="numpy")
def _inverse(m: ComplexArray) -> ComplexArray:
    """Of a matrix of two rows."""
    found = np.empty((2, 2), dtype=np.complex128)
    det = m[0, 0] * m[1, 1] - m[0, 1] * m[1, 0]
    found[0, 0], found[0, 1], found[1, 0], found[1, 1] = m[1, 1], -m[0, 1], -m[1, 0], m[0, 0]
    found /= det
    return found
