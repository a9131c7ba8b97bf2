"""Likelihood of one mode's pole from moments about the fitted pole, which replace the samples exactly."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from modal_id.fit.linear import Problem, real_columns
from modal_id.fit.poles import PoleFit, mode_functions
from tracker.arrays import ComplexArray, FloatArray

# Relative size of the first neglected term of the series.
_REMAINDER = 1e-9
_MAX_TERMS = 60


@dataclass(frozen=True)
class ReducedLikelihood:
    """Weighted residual sum of squares of one mode's pole, all other parameters eliminated, from a few moments.

    For a pole ``lambda_0 + d`` each inner product with ``exp(lambda t)`` is a power series in d. Amplitudes and
    baseline are projected out exactly; changes of the poles of close modes are projected out through their derivatives.

    Attributes
    ----------
    centre_per_s : complex
        lambda_0.
    data_moments : complex array, shape (terms, k, v)
        Of the channels' data and the close modes' derivatives, projected.
    fixed_moments : complex array, shape (terms, g, b)
        Of the orthonormal basis of baseline and other modes, for each group of weights.
    square_moments, modulus_moments : complex and real array, shape (terms, g)
        Of ``exp(2 lambda t)`` and ``|exp(lambda t)|^2``.
    products : array, shape (k, v, v)
        Inner products among data and derivatives.
    group : int array, shape (k,)
    variance : array, shape (k,)
    """

    centre_per_s: complex
    data_moments: ComplexArray
    fixed_moments: ComplexArray
    square_moments: ComplexArray
    modulus_moments: FloatArray
    products: FloatArray
    group: NDArray[np.intp]
    variance: FloatArray

    def chi_square(self, change_per_s: ComplexArray) -> FloatArray:
        """Residual sum of squares over the noise variance for poles ``centre + change``; shape (w,) in and out."""
        terms = self.data_moments.shape[0]
        series = np.vander(change_per_s, terms, increasing=True)
        data = np.tensordot(series, self.data_moments, 1)
        fixed = np.tensordot(series, self.fixed_moments, 1)
        square = np.vander(2.0 * change_per_s, terms, increasing=True) @ self.square_moments
        modulus = np.vander(2.0 * change_per_s.real, terms, increasing=True) @ self.modulus_moments
        # Gram matrix of the wave's real and imaginary part, all other columns projected out.
        rr = (0.5 * (modulus + square.real) - np.sum(fixed.real**2, axis=2))[:, self.group]
        ii = (0.5 * (modulus - square.real) - np.sum(fixed.imag**2, axis=2))[:, self.group]
        ri = (0.5 * square.imag - np.sum(fixed.real * fixed.imag, axis=2))[:, self.group]
        scale = 1.0 / (self.variance * (rr * ii - ri**2))
        left = (ii * scale)[..., None] * data.real - (ri * scale)[..., None] * data.imag
        right = (rr * scale)[..., None] * data.imag - (ri * scale)[..., None] * data.real
        explained = np.einsum("wka,wkb->wab", left, data.real) + np.einsum("wka,wkb->wab", right, data.imag)
        total = np.sum(self.products / self.variance[:, None, None], axis=0) - explained
        own, cross, close = total[:, 0, 0], total[:, 1:, 0], total[:, 1:, 1:]
        if not cross.size:
            return np.asarray(own)
        shared = np.sum(cross * np.linalg.solve(close, cross[..., None])[..., 0], axis=1)
        return np.where(np.linalg.eigvalsh(close)[:, 0] > 0.0, own - shared, np.nan)


def reduce_mode(
    problem: Problem, fit: PoleFit, mode: int, close: NDArray[np.intp], reach_per_s: float
) -> ReducedLikelihood | None:
    """Moments for the pole with index `mode`.

    `close` are the indices of the poles whose uncertainty contributes to that of this one, `reach_per_s` is the largest
    change of the pole for which the series must hold. None when the series would need more than 60 terms, because the
    pole is too uncertain.
    """
    data = problem.data
    time = data.time_s
    centre = complex(fit.poles[mode])
    wave = np.exp(centre * time)
    terms = _terms_needed(time, wave, reach_per_s)
    if terms is None:
        return None
    powers = np.empty((time.size, terms), dtype=complex)
    powers[:, 0] = wave
    for power in range(1, terms):
        powers[:, power] = powers[:, power - 1] * time / power
    others = real_columns(mode_functions(time, np.delete(fit.poles, mode)))
    k, v = data.values.shape[1], 1 + 2 * close.size
    slopes = time[:, None] * mode_functions(time, fit.poles[close])
    group = np.zeros(k, dtype=np.intp)
    data_moments, products = np.empty((terms, k, v), dtype=complex), np.empty((k, v, v))
    fixed_moments, square_moments, modulus_moments = [], [], []
    for index, (channels, weights) in enumerate(data.groups):
        eliminate = _Eliminated(problem, index, others)
        fixed_moments.append(eliminate.whitened(powers).T)
        square_moments.append((weights * wave) @ powers)
        modulus_moments.append(np.real((weights * np.conj(wave)) @ powers))
        for channel in channels:
            group[channel] = index
            vectors = np.empty((time.size, v))
            vectors[:, 0] = data.values[:, channel]
            vectors[:, 1:] = real_columns(slopes * fit.linear.amplitudes[close, channel])
            vectors = eliminate.removed(vectors)
            weighted = vectors * weights[:, None]
            products[channel] = weighted.T @ vectors
            data_moments[:, channel] = powers.T @ weighted
    return ReducedLikelihood(
        centre,
        data_moments,
        np.stack(fixed_moments, axis=1),
        np.stack(square_moments, axis=1),
        np.stack(modulus_moments, axis=1),
        products,
        group,
        fit.linear.noise_variance,
    )


class _Eliminated:
    """Projection that removes baseline and other modes, for one group of channels."""

    def __init__(self, problem: Problem, group: int, others: FloatArray) -> None:
        _, weights = problem.data.groups[group]
        self._sparse, self._others = problem.sparse, others
        self._sparse_t = problem.slow[group].weighted_t
        self._others_t = (others * weights[:, None]).T
        slow = (self._sparse_t @ problem.sparse).toarray()
        mixed = self._sparse_t @ others
        gram = np.block([[slow, mixed], [mixed.T, self._others_t @ others]])
        # The ridge bounds the coefficient of a spline without samples in these channels.
        gram[np.diag_indices_from(gram)] += 1e-13 * float(np.max(np.diag(gram)))
        self._factor = np.linalg.cholesky(gram)

    def whitened(self, columns: FloatArray | ComplexArray) -> Any:
        """Inner products with an orthonormal basis of the eliminated columns."""
        products = np.concatenate([self._sparse_t @ columns, self._others_t @ columns])
        return np.asarray(solve_triangular(self._factor, products, lower=True, check_finite=False))

    def removed(self, columns: FloatArray) -> FloatArray:
        """The columns minus their projection."""
        coefficients = solve_triangular(self._factor, self.whitened(columns), lower=True, trans="T")
        b = self._sparse.shape[1]
        return np.asarray(columns - self._sparse @ coefficients[:b] - self._others @ coefficients[b:])


def _terms_needed(time_s: FloatArray, wave: ComplexArray, reach_per_s: float) -> int | None:
    # The radius is set by the time at which the wave has lost its energy; doubled for exp(2 lambda t).
    energy = np.cumsum(np.abs(wave) ** 2 * np.gradient(time_s))
    last = float(time_s[np.searchsorted(energy, (1.0 - 1e-6) * energy[-1])])
    radius, size = 2.0 * reach_per_s * last, 1.0
    for power in range(1, _MAX_TERMS):
        size *= radius / power
        if size < _REMAINDER and power >= 6:
            return power + 1
    return None
