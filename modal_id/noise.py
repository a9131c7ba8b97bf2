"""Colour of the noise: its level at the mode's frequency against the white level that the fit assumes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

_RELATIVE_HALF_WIDTH = 0.06
_MIN_BINS_ASIDE = 12
_OWN_BINS = 1.25
_MAX_BINS = 150


@dataclass(frozen=True)
class NoiseLevel:
    """Local noise level.

    Attributes
    ----------
    factor : float
        By which white-noise standard deviations are multiplied.
    freedom : float
        Degrees of freedom of the estimate of ``factor**2``.
    """

    factor: float
    freedom: float


def noise_level(
    time_s: FloatArray,
    residual: FloatArray,
    weights: FloatArray,
    variance: FloatArray,
    amplitudes: ComplexArray,
    frequencies_hz: FloatArray,
    mode: int,
    bandwidth_hz: float,
) -> NoiseLevel:
    """Spectral level of the residual near a mode, as the mode's fit sees it.

    The score of the poles is one complex series, the residuals summed over channels with the conjugate
    amplitudes of the mode and inverse variances. Its spectrum at the mode's frequency contains the channels'
    cross-spectra, so noise common to all of them (a shaking camera) counts as what it is.

    Parameters
    ----------
    time_s : array, shape (n,)
    residual, weights : array, shape (n, k)
    variance : array, shape (k,)
        Of a sample of weight 1.
    amplitudes : complex array, shape (k,)
        Of the mode.
    frequencies_hz : array, shape (m,)
        Of all modes: their own bins were emptied by the fit and are left out.
    mode : int
        Index into `frequencies_hz`.
    bandwidth_hz : float
        Of the baseline, which emptied the bins below.

    Returns
    -------
    NoiseLevel
        Factor 1 with one degree of freedom a channel's sample when the record holds no bin to look at.
    """
    span = float(time_s[-1] - time_s[0])
    centre = float(frequencies_hz[mode])
    half = min(max(_MIN_BINS_ASIDE / span, _RELATIVE_HALF_WIDTH * centre), 0.6 * centre)
    stride = max(1, int(np.ceil(2.0 * half * span / _MAX_BINS)))
    aside = int(half * span / stride)
    bins = centre + np.arange(-aside, aside + 1) * (stride / span) + 0.5 / span
    nyquist = 0.5 / float(np.median(np.diff(time_s)))
    keep = (bins > max(1.3 * bandwidth_hz, 1.0 / span)) & (bins < nyquist)
    for frequency in frequencies_hz:
        keep &= np.abs(bins - frequency) > _OWN_BINS / span
    inverse = 1.0 / variance
    expected = float(np.sum(weights * (np.abs(amplitudes) ** 2 * inverse)))
    if np.count_nonzero(keep) < 3 or expected <= 0.0:
        return NoiseLevel(1.0, 3.0)
    score = (weights * residual) @ (np.conj(amplitudes) * inverse)
    turned = score * np.exp(-2j * np.pi * bins[0] * time_s)
    turn = np.exp(-2j * np.pi * (stride / span) * time_s)
    power = np.zeros(bins.size)
    for index in range(bins.size):
        power[index] = abs(np.sum(turned)) ** 2
        turned *= turn
    mean = float(np.mean(power[keep])) / expected
    return NoiseLevel(float(np.sqrt(max(mean, 1e-12))), 2.0 * float(np.count_nonzero(keep)))
