"""Effect of errors that return with the motion on the standard deviations of frequency and damping.

The template is learnt from the first frames of a recording. Their noise remains in it and biases every position by a
small function of the marker's position within the pixel, which does not average out over a longer record. `identify`
estimates that function together with the modes; what it cannot tell apart from damping widens the interval.
"""

from __future__ import annotations

import numpy as np

from modal_id.data import bandwidth_hz, baseline_matrix
from tracker import LOSSLESS_SHARE, FloatArray, harmonics

# Enough samples for the share of the variance: the function of the pixel is smooth in the phase.
_MOST_SAMPLES = 4000
_PHASES_RAD = (0.0, 0.5 * np.pi)


def template_factors(
    time_s: FloatArray, frequency_hz: float, damping_ratio: float, amplitude_px: FloatArray, sd_px: FloatArray
) -> tuple[float, float]:
    """Factors by which template noise increases the standard deviations of frequency and damping ratio.

    Times, shape (n,), are from the beginning of the free decay; `amplitude_px` and `sd_px`, shape (m,), are the
    amplitude of each marker at time 0 and the standard deviation of its position. Markers at rest have factors of 1.

    Notes
    -----
    Information of frequency and damping with the periodic error of each marker marginalised, against that without it;
    amplitudes and drift are unknown in both. Markers are weighted as in the fit.
    """
    if not np.any(amplitude_px):
        return 1.0, 1.0
    every = -(-time_s.size // _MOST_SAMPLES)
    variance = np.zeros(2)
    for phase_rad in _PHASES_RAD:
        plain, marginal = _information(
            time_s[::every], every, frequency_hz, damping_ratio, amplitude_px, sd_px, phase_rad
        )
        variance += np.diag(np.linalg.inv(marginal)) / np.diag(np.linalg.inv(plain)) / len(_PHASES_RAD)
    frequency, damping = np.sqrt(variance)
    return float(frequency), float(damping)


def _information(
    time_s: FloatArray,
    every: int,
    frequency_hz: float,
    damping_ratio: float,
    amplitude_px: FloatArray,
    sd_px: FloatArray,
    phase_rad: float,
) -> tuple[FloatArray, FloatArray]:
    """Information of frequency and damping ratio without and with the error, each sample standing for `every`."""
    pole = 2.0 * np.pi * frequency_hz * complex(-damping_ratio, np.sqrt(1.0 - damping_ratio**2))
    wave = np.exp(pole * time_s + 1j * phase_rad)
    drift = baseline_matrix(time_s, bandwidth_hz(frequency_hz))
    slopes = np.column_stack([(1j * time_s * wave).real, (time_s * wave).real])
    basis = np.linalg.qr(np.column_stack([wave.real, wave.imag, drift]))[0]
    slopes -= basis @ (basis.T @ slopes)
    plain, marginal = np.zeros((2, 2)), np.zeros((2, 2))
    for size, sd in zip(amplitude_px, sd_px, strict=True):
        error = LOSSLESS_SHARE * np.sqrt(every) * harmonics(size * wave.real)
        error -= basis @ (basis.T @ error)
        shared = error.T @ slopes
        seen = np.linalg.solve(error.T @ error + np.eye(error.shape[1]), shared)
        plain += (size / sd) ** 2 * (slopes.T @ slopes)
        marginal += (size / sd) ** 2 * (slopes.T @ slopes - shared.T @ seen)
    return plain, marginal
