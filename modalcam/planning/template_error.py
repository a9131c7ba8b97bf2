"""Effect of the noise in the tracker's template on the standard deviations of frequency and damping.

The template is learnt from the first frames of a recording. Their noise remains in it and biases every position by a
small function of the marker's position within the pixel. Unlike the noise of each frame, this bias does not average
out over a longer record.
"""

from __future__ import annotations

import numpy as np

from modal_id.data.baseline import bandwidth_hz, baseline_matrix
from tracker.arrays import FloatArray

# Standard deviation of either quadrature of the bias's first harmonic over the pixel, relative to that of a position in
# a frame: measured on rendered recordings of ArUco codes and dots, learnt from 64 frames. The second is negligible.
BIAS_SHARE = 0.09
# Enough samples for the share of the variance: the function of the pixel is smooth in the phase.
_MOST_SAMPLES = 4000
_PHASES_RAD = (0.0, 0.5 * np.pi)


def template_factors(
    time_s: FloatArray, frequency_hz: float, damping_ratio: float, amplitude_px: FloatArray, sd_px: FloatArray
) -> tuple[float, float]:
    """Factors by which template noise increases the standard deviations of frequency and damping ratio.

    Times, shape (n,), are from the beginning of the free decay; `amplitude_px` and `sd_px`, shape (m,), are the
    amplitude of each marker at time 0 and the standard deviation of its position.

    Notes
    -----
    The bias ``a cos 2 pi x(t) + b sin 2 pi x(t)`` of each marker, with independent a and b, is projected on the
    derivatives of its motion by frequency and damping, orthogonal to amplitudes and drift; markers are weighted as in
    the fit.
    """
    every = -(-time_s.size // _MOST_SAMPLES)
    thin_s = time_s[::every]
    excess = [
        _excess(thin_s, frequency_hz, damping_ratio, amplitude_px, sd_px, phase) for phase in _PHASES_RAD
    ]
    frequency, damping = np.sqrt(1.0 + every * np.mean(excess, axis=0))
    return float(frequency), float(damping)


def _excess(
    time_s: FloatArray,
    frequency_hz: float,
    damping_ratio: float,
    amplitude_px: FloatArray,
    sd_px: FloatArray,
    phase_rad: float,
) -> FloatArray:
    """Variance from the template relative to that from noise, for frequency and damping ratio."""
    pole = 2.0 * np.pi * frequency_hz * complex(-damping_ratio, np.sqrt(1.0 - damping_ratio**2))
    wave = np.exp(pole * time_s + 1j * phase_rad)
    drift = baseline_matrix(time_s, bandwidth_hz(frequency_hz))
    slopes = np.column_stack([(1j * time_s * wave).real, (time_s * wave).real])
    known = np.column_stack([wave.real, wave.imag, drift])
    slopes = slopes - known @ np.linalg.lstsq(known, slopes, rcond=None)[0]
    # Each orthogonal to the other.
    gram = slopes.T @ slopes
    own = slopes @ np.linalg.inv(gram)
    power = np.diag(np.linalg.inv(gram))
    total, weight = np.zeros(2), 0.0
    for size, sd in zip(amplitude_px, sd_px, strict=True):
        turn = 2.0 * np.pi * size * wave.real
        pushed = own.T @ np.column_stack([np.cos(turn), np.sin(turn)])
        share = np.sum(pushed**2, axis=1) * BIAS_SHARE**2 / power
        information = (size / sd) ** 2
        total += information * share
        weight += information
    return np.asarray(total / max(weight, 1e-300))
