"""The linear part of the fit: amplitudes and baseline of every channel for given mode functions."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

# Relative ridge that keeps the normal equations solvable where a baseline spline sees no sample.
_RIDGE = 1e-13


@dataclass(frozen=True)
class FitData:
    """Samples as the fit sees them.

    Attributes
    ----------
    time_s : array, shape (n,)
        From the start of the fit.
    values : array, shape (n, k)
        0 where missing; the weight is 0 there too.
    weights : array, shape (n, k)
        Inverse variance relative to the channel's best samples: 0 to 1; 0 where a sample is not used.
    """

    time_s: FloatArray
    values: FloatArray
    weights: FloatArray

    @cached_property
    def groups(self) -> tuple[tuple[NDArray[np.intp], FloatArray], ...]:
        """Channels that share their weights, so that they share the normal equations: (channels, weights)."""
        found: dict[bytes, list[int]] = {}
        for channel in range(self.values.shape[1]):
            found.setdefault(self.weights[:, channel].tobytes(), []).append(channel)
        return tuple((np.array(cs), self.weights[:, cs[0]]) for cs in found.values())

    @cached_property
    def counts(self) -> FloatArray:
        """Number of used samples of each channel; shape (k,)."""
        return np.asarray(np.count_nonzero(self.weights > 0.0, axis=0).astype(float))

    @property
    def span_s(self) -> float:
        """From the first to the last time."""
        return float(self.time_s[-1] - self.time_s[0])


@dataclass(frozen=True)
class LinearSolution:
    """Best amplitudes and baseline for given mode functions.

    Attributes
    ----------
    amplitudes : complex array, shape (m, k)
        Channel k moves as ``Re(sum_m amplitudes[m, k] functions[:, m])`` above its baseline.
    baseline : array, shape (n, k)
    residual : array, shape (n, k)
        Data less fit; 0 where the weight is 0 and the value is missing is not guaranteed: use the weights.
    rss : array, shape (k,)
        Weighted sum of squares of the residual.
    noise_variance : array, shape (k,)
        Of a sample of weight 1.
    factors : tuple
        Cholesky factor of the normal equations of each group.
    """

    amplitudes: ComplexArray
    baseline: FloatArray
    residual: FloatArray
    rss: FloatArray
    noise_variance: FloatArray
    factors: tuple[tuple[FloatArray, bool], ...]
    design: FloatArray


def real_columns(functions: ComplexArray) -> FloatArray:
    """Real and imaginary part of each function as neighbouring columns; shape (n, 2 m)."""
    columns = np.empty((functions.shape[0], 2 * functions.shape[1]))
    columns[:, 0::2], columns[:, 1::2] = functions.real, functions.imag
    return columns


def solve_linear(data: FitData, functions: ComplexArray, baseline: FloatArray) -> LinearSolution:
    """Weighted least squares of every channel on mode functions and baseline.

    Parameters
    ----------
    data : FitData
    functions : complex array, shape (n, m)
        For example ``exp(lambda t)`` of each mode.
    baseline : array, shape (n, b)

    Returns
    -------
    LinearSolution
        The noise variance has a floor of 1e-16 of the channels' mean square, so that data without noise
        stay solvable.
    """
    n_functions = 2 * functions.shape[1]
    design = np.concatenate([real_columns(functions), baseline], axis=1)
    k = data.values.shape[1]
    coefficients = np.zeros((design.shape[1], k))
    factors = []
    for channels, weights in data.groups:
        weighted = design * weights[:, None]
        normal = weighted.T @ design
        normal[np.diag_indices_from(normal)] += _RIDGE * (np.diag(normal).max() + 1e-300)
        factor = cho_factor(normal, check_finite=False)
        coefficients[:, channels] = cho_solve(
            factor, weighted.T @ data.values[:, channels], check_finite=False
        )
        factors.append(factor)
    real, imaginary = coefficients[0:n_functions:2], coefficients[1:n_functions:2]
    slow = baseline @ coefficients[n_functions:]
    residual = data.values - design[:, :n_functions] @ coefficients[:n_functions] - slow
    rss = np.sum(data.weights * residual**2, axis=0)
    freedom = np.maximum(data.counts - design.shape[1], 1.0)
    mean_square = np.sum(data.weights * data.values**2) / max(float(np.sum(data.counts)), 1.0)
    variance = np.maximum(rss / freedom, 1e-16 * mean_square + 1e-300)
    return LinearSolution(real - 1j * imaginary, slow, residual, rss, variance, tuple(factors), design)
