"""Likelihood of one mode's pole from moments about the fitted pole, which replace the samples exactly."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from modal_id.fit.linear import Problem, real_columns
from modal_id.fit.poles import PoleFit, mode_functions
from modal_id.posterior.likelihood_kernels import chi_squares, own_moments
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
    square_moments : complex array, shape (terms, g)
        Of ``exp(2 lambda t)``.
    modulus_moments : array, shape (terms, g)
        Of ``|exp(lambda t)|^2``.
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
        return np.asarray(
            chi_squares(
                np.asarray(change_per_s, dtype=complex),
                self.data_moments,
                self.fixed_moments,
                self.square_moments,
                self.modulus_moments,
                self.products,
                self.group,
                self.variance,
            )
        )


def reduce_mode(
    problem: Problem, fit: PoleFit, mode: int, close: NDArray[np.intp], reach_per_s: float
) -> ReducedLikelihood | None:
    """Moments for the pole of one mode.

    Parameters
    ----------
    problem : Problem
    fit : PoleFit
    mode : int
        Index of the pole.
    close : int array
        Indices of the poles whose uncertainty contributes to that of this one.
    reach_per_s : float
        Largest change of the pole for which the series must hold.

    Returns
    -------
    ReducedLikelihood or None
        None when the series would need more than 60 terms, because the pole is too uncertain.
    """
    data = problem.data
    time = data.time_s
    centre = complex(fit.poles[mode])
    wave = np.exp(centre * time)
    terms = _terms_needed(time, wave, reach_per_s)
    if terms is None:
        return None
    powers = _power_columns(wave, time, terms)
    others = real_columns(mode_functions(time, np.delete(fit.poles, mode)))
    k, v = data.values.shape[1], 1 + 2 * close.size
    slopes = time[:, None] * mode_functions(time, fit.poles[close])
    group = np.zeros(k, dtype=np.intp)
    data_moments, products = np.empty((terms, k, v), dtype=complex), np.empty((k, v, v))
    fixed_moments, square_moments, modulus_moments = [], [], []
    for index, (channels, weights) in enumerate(data.groups):
        eliminate = _Eliminated(problem, index, others)
        weighted = powers * weights[:, None]
        fixed_moments.append(_paired(eliminate.whitened(powers)).T)
        square, modulus = own_moments(wave, time, weights, terms)
        square_moments.append(square)
        modulus_moments.append(modulus)
        for channel in channels:
            group[channel] = index
            vectors = np.empty((time.size, v))
            vectors[:, 0] = data.values[:, channel]
            vectors[:, 1:] = real_columns(slopes * fit.linear.amplitudes[close, channel])
            vectors = eliminate.removed(vectors)
            products[channel] = (vectors * weights[:, None]).T @ vectors
            data_moments[:, channel] = _paired(vectors.T @ weighted).T
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

    def whitened(self, columns: FloatArray) -> FloatArray:
        """Inner products with an orthonormal basis of the eliminated columns."""
        products = np.concatenate([self._sparse_t @ columns, self._others_t @ columns])
        return np.asarray(solve_triangular(self._factor, products, lower=True, check_finite=False))

    def removed(self, columns: FloatArray) -> FloatArray:
        """The columns minus their projection."""
        coefficients = solve_triangular(self._factor, self.whitened(columns), lower=True, trans="T")
        b = self._sparse.shape[1]
        return np.asarray(columns - self._sparse @ coefficients[:b] - self._others @ coefficients[b:])


def _power_columns(wave: ComplexArray, time_s: FloatArray, terms: int) -> FloatArray:
    """Real and imaginary part of ``wave t^j / j!`` for each power j, neighbouring columns."""
    columns = np.empty((time_s.size, 2 * terms))
    weight = wave.copy()
    for power in range(terms):
        columns[:, 2 * power], columns[:, 2 * power + 1] = weight.real, weight.imag
        weight *= time_s / (power + 1.0)
    return columns


def _paired(products: FloatArray) -> ComplexArray:
    """Neighbouring real and imaginary parts joined along the last axis."""
    return np.asarray(products[..., 0::2] + 1j * products[..., 1::2])


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
