"""Frequency response: of the fitted modes with bands, and by local polynomials without a model."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.ndimage import uniform_filter1d

from modal_id.response.columns import FIXED, Samples, amplitudes, spline_gain, transfer
from modal_id.response.solution import ResponseFit
from tracker import ComplexArray, FloatArray


@dataclass(frozen=True)
class Tuning:
    """Bins and draws of frequency responses."""

    #: [bins] half width of the window of a local polynomial
    #: statistics: 13 bins for 6 unknowns leave 7 complex degrees of freedom for the variance.
    half_window: int = 6
    #: [1] degree of the local polynomials of response and transient
    degree: int = 2
    #: [1] draws of the fit from which bands are made
    #: statistics: The 5 % and 95 % quantiles scatter by a seventh of the standard deviation.
    draws: int = 200
    #: [1] largest number of frequencies of the model
    #: convention: A figure shows no more; each mode has its own beside them.
    frequencies: int = 1000
    #: [1] power of the input in a window, over its median power, below which there is no local estimate
    least_power: float = 1e-6


TUNING = Tuning()


def model_bands(
    found: ResponseFit, frequency_hz: FloatArray, seed: list[int]
) -> tuple[FloatArray, FloatArray]:
    """5 % and 95 % quantiles of the modulus of the fitted response; shape (f, k) each."""
    generator = np.random.default_rng(seed)
    k = found.coefficients.shape[1]
    moves = _normal(generator, found.covariance)
    sizes = np.empty((TUNING.draws, frequency_hz.size, k))
    coefficients = np.zeros((TUNING.draws, *found.coefficients.shape))
    # Coefficients of the drift do not matter, and their variance would hide that of the others by rounding.
    used = np.r_[0, 1, FIXED : len(found.coefficients)]
    for out in range(k):
        slope = found.coefficient_slopes[out][used]
        own = found.coefficient_covariance[out][np.ix_(used, used)] - slope @ found.covariance @ slope.T
        scale = np.sqrt(np.maximum(np.diag(own), 1e-300))
        noise = scale * _normal(generator, own / np.outer(scale, scale))
        coefficients[:, used, out] = found.coefficients[used, out] + noise + moves @ slope.T
    loss = spline_gain(np.abs(found.poles) / (2.0 * np.pi), found.samples.step_s)
    for draw, move in enumerate(moves):
        own_move = move[: 2 * found.poles.size]
        poles = found.poles + own_move[0::2] + 1j * own_move[1::2]
        own = coefficients[draw]
        sizes[draw] = np.abs(transfer(frequency_hz, poles, own[:2], amplitudes(own)[0] * loss[:, None]))
    low, high = np.quantile(sizes, (0.05, 0.95), axis=0)
    return low, high


def _normal(generator: np.random.Generator, covariance: FloatArray) -> FloatArray:
    """Draws, shape (draws, p); directions whose variance is negative by rounding stay at 0."""
    values, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    return np.asarray(generator.standard_normal((TUNING.draws, len(values))) @ root.T)


def local_polynomial(samples: Samples) -> tuple[ComplexArray, FloatArray]:
    """Frequency response at each bin and the sd of its real and imaginary part; shape (b, k) each.

    Around each bin, response and transient are polynomials of the bin's distance; NaN where the input has no power.

    Notes
    -----
    Pintelon & Schoukens, *System Identification*, 2nd ed. (2012), section 7.2, doi:10.1002/9781118287422. Biased where
    a resonance is narrower than the window (13 bins), and towards zero by noise in the input.
    """
    half, degree = TUNING.half_window, TUNING.degree
    offset = np.arange(-half, half + 1) / half
    powers = offset[:, None] ** np.arange(degree + 1)
    given, outputs = samples.input_bins, samples.bins(samples.values)
    b = len(outputs)
    starts = np.clip(np.arange(b) - half, 0, b - 2 * half - 1)
    u = sliding_window_view(given, 2 * half + 1)[starts]
    y = np.moveaxis(sliding_window_view(outputs, 2 * half + 1, axis=0)[starts], 1, 2)
    columns = np.concatenate([u[:, :, None] * powers, np.broadcast_to(powers, (b, *powers.shape))], axis=2)
    scale = np.sqrt(np.sum(np.abs(columns) ** 2, axis=1, keepdims=True)) + 1e-300
    inverse = np.linalg.pinv(columns / scale) / np.swapaxes(scale, 1, 2)
    solved = inverse @ y
    rest = y - columns @ solved
    dof = 2 * half + 1 - columns.shape[2]
    variance = np.sum(np.abs(rest) ** 2, axis=1) / (2.0 * dof)
    # At the bin itself, which is not the middle of the first and last windows.
    at = ((np.arange(b) - starts - half) / half)[:, None] ** np.arange(degree + 1)
    row = np.einsum("bd,bdw->bw", at, inverse[:, : degree + 1])
    value = np.einsum("bd,bdk->bk", at, solved[:, : degree + 1])
    sd = np.sqrt(variance * np.sum(np.abs(row) ** 2, axis=1)[:, None])
    power = np.mean(np.abs(u) ** 2, axis=1)
    weak = power < TUNING.least_power * np.median(power)
    return np.where(weak[:, None], np.nan, value), np.where(weak[:, None], np.nan, sd)


def coherence(samples: Samples) -> FloatArray:
    """Squared coherence of each output with the input over the windows of `local_polynomial`; shape (b, k)."""
    given, outputs = samples.input_bins[:, None], samples.bins(samples.values)

    def mean(values: FloatArray) -> FloatArray:
        return np.asarray(uniform_filter1d(values, 2 * TUNING.half_window + 1, axis=0))

    cross = outputs * np.conj(given)
    size = mean(np.abs(outputs) ** 2) * mean(np.abs(given) ** 2)
    return np.clip((mean(cross.real) ** 2 + mean(cross.imag) ** 2) / np.maximum(size, 1e-300), 0.0, 1.0)
