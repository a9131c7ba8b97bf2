"""Spectrum of one mode under white modal force, as the periodogram of an evenly sampled record has it on average."""

from __future__ import annotations

import numpy as np

from tracker import ComplexArray, FloatArray


def transfer(
    frequency_hz: FloatArray, natural_hz: float, zeta: float, samples: int, step_s: float
) -> ComplexArray:
    """Receptance of a mode, 1 at rest, with the modulus that leakage and aliasing leave; shape of `frequency_hz`.

    Parameters
    ----------
    frequency_hz : array, shape (g,)
        Frequencies of the periodogram, 0 to half the sampling rate.
    natural_hz, zeta : float
        Undamped natural frequency and damping ratio, 0 < zeta < 1.
    samples, step_s : int, float
        Length of the record and its time step.

    Notes
    -----
    The squared modulus is the expected periodogram of the displacement of
    ``x'' + 2 zeta w x' + w^2 x = w^2 p``, p white with one-sided spectral density 1: the transform of its
    autocovariance under the triangular window of a record without taper,
    ``2 dt [R(0) + 2 sum_m (1 - m / n) R(m dt) cos(2 pi f m dt)]``, summed in closed form, as
    ``R(t) = (pi f / 4 zeta) Re[(1 - i zeta / sqrt(1 - zeta^2)) exp(lambda |t|)]``. With the receptance itself,
    ``1 / ((1 - b^2)^2 + (2 zeta b)^2)``, zeta would be too large by 1 / (w T): leakage widens a peak of the half-width
    zeta w to zeta w + 1 / T. The idea is that of the debiased Whittle likelihood: Sykulski et al. (2019),
    doi:10.1093/biomet/asy071. The phase is that of the receptance.
    """
    omega = 2.0 * np.pi * natural_hz
    root = np.sqrt(1.0 - zeta**2)
    factor = complex(1.0, -zeta / root)
    pole = omega * complex(-zeta, root)
    turn = 2.0 * np.pi * frequency_hz * step_s
    total = np.ones(frequency_hz.size)
    for sign in (-1.0, 1.0):
        log_q = pole * step_s + sign * 1j * turn
        # 1 - q without cancellation where the step is short
        rest = -np.expm1(log_q)
        q = np.exp(log_q)
        total += np.real(factor * (q / rest + q * np.expm1(samples * log_q) / (samples * rest**2)))
    power = (np.pi * natural_hz / (4.0 * zeta)) * 2.0 * step_s * np.maximum(total, 1e-300)
    ratio = frequency_hz / natural_hz
    angle = -np.arctan2(2.0 * zeta * ratio, 1.0 - ratio**2)
    return np.asarray(np.sqrt(power) * np.exp(1j * angle))


def variance(natural_hz: float, zeta: float) -> float:
    """Variance of the motion for one-sided spectral density 1 of the force: ``pi f / (4 zeta)``."""
    return np.pi * natural_hz / (4.0 * zeta)
