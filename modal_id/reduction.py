"""Exact reduction of the data: moments about the fitted pole replace the samples in every later likelihood."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from modal_id.linear import FitData, real_columns
from modal_id.varpro import PoleFit, mode_functions

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

# Relative size of the first neglected term of the series.
_REMAINDER = 1e-9
_MAX_TERMS = 60


@dataclass(frozen=True)
class ReducedLikelihood:
    """Weighted residual sum of squares of one mode's pole, all else eliminated, as sums of a few moments.

    For a pole ``lambda_0 + d`` each inner product with ``exp(lambda t)`` is a power series in d. Amplitudes,
    baseline and the amplitudes of the other modes are projected out exactly; small changes of close
    neighbours' poles are projected out through their derivatives.

    Attributes
    ----------
    centre_per_s : complex
        lambda_0.
    data_moments : complex array, shape (terms, k, v)
        Of the channels' data and the neighbours' derivatives, projected, over the noise variance.
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
        """Residual sum of squares over the noise variance for poles ``centre + change``.

        Parameters
        ----------
        change_per_s : complex array, shape (w,)

        Returns
        -------
        array, shape (w,)
        """
        terms = self.data_moments.shape[0]
        single = _powers(change_per_s, terms)
        double = _powers(2.0 * change_per_s, terms)
        modulus = _powers(2.0 * change_per_s.real, terms).real @ self.modulus_moments
        square = double @ self.square_moments
        data = np.tensordot(single, self.data_moments, axes=1)
        fixed = np.tensordot(single, self.fixed_moments, axes=1)
        rr = 0.5 * (modulus + square.real) - np.sum(fixed.real**2, axis=2)
        ii = 0.5 * (modulus - square.real) - np.sum(fixed.imag**2, axis=2)
        ri = 0.5 * square.imag - np.sum(fixed.real * fixed.imag, axis=2)
        determinant = rr * ii - ri * ri
        rr, ii, ri, determinant = (x[:, self.group] for x in (rr, ii, ri, determinant))
        real, imag = data.real, data.imag
        weighted_r = (ii[..., None] * real - ri[..., None] * imag) / determinant[..., None]
        weighted_i = (rr[..., None] * imag - ri[..., None] * real) / determinant[..., None]
        inverse = 1.0 / self.variance
        explained = np.einsum("wkv,wku,k->wvu", weighted_r, real, inverse)
        explained += np.einsum("wkv,wku,k->wvu", weighted_i, imag, inverse)
        total = np.einsum("kvu,k->vu", self.products, inverse)[None] - explained
        chi = total[:, 0, 0]
        if total.shape[1] > 1:
            side = total[:, 1:, 0]
            chi = chi - np.einsum(
                "wv,wv->w", side, np.linalg.solve(total[:, 1:, 1:], side[..., None])[..., 0]
            )
        return np.asarray(chi)


def reduce_mode(
    data: FitData, fit: PoleFit, baseline: FloatArray, mode: int, close: NDArray[np.intp], reach_per_s: float
) -> ReducedLikelihood | None:
    """Moments for the pole of one mode.

    Parameters
    ----------
    data : FitData
    fit : PoleFit
    baseline : array, shape (n, b)
    mode : int
        Index of the pole.
    close : int array
        Indices of poles whose uncertainty matters to this one.
    reach_per_s : float
        Largest change of the pole that will be asked for.

    Returns
    -------
    ReducedLikelihood or None
        None when the series would need more than 60 terms: the pole is too uncertain for its neighbourhood.
    """
    time = data.time_s
    centre = complex(fit.poles[mode])
    wave = np.exp(centre * time)
    terms = _terms_needed(time, wave, reach_per_s)
    if terms is None:
        return None
    others = np.delete(np.arange(fit.poles.size), mode)
    functions = mode_functions(time, fit.poles[others])
    fixed = np.concatenate([real_columns(functions), baseline], axis=1)
    k, v = data.values.shape[1], 1 + 2 * close.size
    slopes = time[:, None] * mode_functions(time, fit.poles[close])
    group = np.zeros(k, dtype=np.intp)
    data_moments = np.empty((terms, k, v), dtype=complex)
    products = np.empty((k, v, v))
    fixed_moments, square, modulus = [], [], []
    for index, (channels, weights) in enumerate(data.groups):
        root = np.sqrt(weights)
        basis = _orthonormal(fixed * root[:, None])
        rooted_wave = wave * root
        fixed_moments.append(_moments(basis, rooted_wave, time, terms))
        square.append(_moments((wave * root)[:, None], rooted_wave, time, terms)[:, 0])
        modulus.append(_moments(np.conj(rooted_wave)[:, None], rooted_wave, time, terms)[:, 0].real)
        for channel in channels:
            group[channel] = index
            vectors = np.empty((time.size, v))
            vectors[:, 0] = data.values[:, channel]
            vectors[:, 1:] = real_columns(slopes * fit.linear.amplitudes[close, channel])
            vectors *= root[:, None]
            vectors -= basis @ (basis.T @ vectors)
            products[channel] = vectors.T @ vectors
            data_moments[:, channel] = _moments(vectors, rooted_wave, time, terms)
    return ReducedLikelihood(
        centre,
        data_moments,
        np.stack(fixed_moments, axis=1),
        np.stack(square, axis=1),
        np.stack(modulus, axis=1),
        products,
        group,
        fit.linear.noise_variance,
    )


def _orthonormal(columns: FloatArray) -> FloatArray:
    # A spline that sees no sample of this channel spans nothing and must not take a direction away.
    basis, triangle = np.linalg.qr(columns)
    diagonal = np.abs(np.diag(triangle))
    return np.asarray(basis * (diagonal > 1e-10 * np.max(diagonal)))


def _moments(
    vectors: FloatArray | ComplexArray, wave: ComplexArray, time_s: FloatArray, terms: int
) -> ComplexArray:
    # sum_t v(t) exp(lambda_0 t) t^j, j = 0 .. terms - 1, one row a power
    rows = np.empty((terms, vectors.shape[1]), dtype=complex)
    weight = wave.copy()
    for power in range(terms):
        rows[power] = weight @ vectors
        weight *= time_s / (power + 1.0)
    return rows


def _powers(change: ComplexArray | FloatArray, terms: int) -> ComplexArray:
    # The factorials stand in the moments.
    return np.asarray(np.power(np.asarray(change, dtype=complex)[:, None], np.arange(terms)[None, :]))


def _terms_needed(time_s: FloatArray, wave: ComplexArray, reach_per_s: float) -> int | None:
    # The longest time at which the wave still carries weight sets the radius; doubled for exp(2 lambda t).
    energy = np.cumsum(np.abs(wave) ** 2 * np.gradient(time_s))
    last = float(time_s[np.searchsorted(energy, (1.0 - 1e-6) * energy[-1])])
    radius, size = 2.0 * reach_per_s * last, 1.0
    for power in range(1, _MAX_TERMS):
        size *= radius / power
        if size < _REMAINDER and power >= 6:
            return power + 1
    return None
