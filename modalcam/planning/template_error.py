"""What the tracker's template, learnt from the first frames of a recording, adds to the scatter of its modes.

Noise of those frames stays in the template, and biases every position of the recording by a small function of where in
the pixel the marker stands. Other than the noise of each frame it does not average out over a longer record.
"""

from __future__ import annotations

import numpy as np

from modal_id.data.baseline import bandwidth_hz, baseline_matrix
from tracker.arrays import FloatArray

# Standard deviation of either quadrature of the bias's first harmonic over the pixel, relative to that of a position in
# a frame: measured over rendered recordings of ArUco codes and dots, 64 frames to learn from. The second is not seen.
BIAS_SHARE = 0.09
# Enough samples for the share of the variance: the function of the pixel is smooth in the phase.
_MOST_SAMPLES = 4000
_PHASES_RAD = (0.0, 0.5 * np.pi)


def template_factors(
    time_s: FloatArray, frequency_hz: float, damping_ratio: float, amplitude_px: FloatArray, sd_px: FloatArray
) -> tuple[float, float]:
    """Factors by which the standard deviations of frequency and damping ratio are larger than the noise makes them.

    Parameters
    ----------
    time_s : array, shape (n,)
        From the beginning of the free decay.
    frequency_hz, damping_ratio : float
    amplitude_px : array, shape (m,)
        Of each marker at time 0.
    sd_px : array, shape (m,)
        Of a position of each marker.

    Notes
    -----
    The bias ``a cos 2 pi x(t) + b sin 2 pi x(t)`` of each marker, with a and b of its own, is projected on what a
    change of frequency or damping does to its motion, amplitudes and drift aside, and weighed as the fit weighs
    markers.
    """
    every = -(-time_s.size // _MOST_SAMPLES)
    squares = [
        _excess(time_s[::every], float(every), frequency_hz, damping_ratio, amplitude_px, sd_px, phase)
        for phase in _PHASES_RAD
    ]
    frequency, damping = np.sqrt(1.0 + np.mean(squares, axis=0))
    return float(frequency), float(damping)


def _excess(
    time_s: FloatArray,
    stands_for: float,
    frequency_hz: float,
    damping_ratio: float,
    amplitude_px: FloatArray,
    sd_px: FloatArray,
    phase_rad: float,
) -> FloatArray:
    """Variance by the template over that by noise, for frequency and damping ratio."""
    pole = 2.0 * np.pi * frequency_hz * complex(-damping_ratio, np.sqrt(1.0 - damping_ratio**2))
    wave = np.exp(pole * time_s + 1j * phase_rad)
    drift = baseline_matrix(time_s, bandwidth_hz(frequency_hz))
    slopes = np.column_stack([(1j * time_s * wave).real, (time_s * wave).real])
    known = np.column_stack([wave.real, wave.imag, drift])
    slopes = slopes - known @ np.linalg.lstsq(known, slopes, rcond=None)[0]
    # Each in the direction that the other cannot imitate.
    gram = slopes.T @ slopes
    own = slopes @ np.linalg.inv(gram)
    power = np.diag(np.linalg.inv(gram))
    total, weight = np.zeros(2), 0.0
    for size, sd in zip(amplitude_px, sd_px, strict=True):
        turn = 2.0 * np.pi * size * wave.real
        pushed = own.T @ np.column_stack([np.cos(turn), np.sin(turn)])
        share = np.sum(pushed**2, axis=1) * BIAS_SHARE**2 / power * stands_for
        information = (size / sd) ** 2
        total += information * share
        weight += information
    return np.asarray(total / max(weight, 1e-300))
