"""Eq. 1, free decay of one mode, and the complex poles and amplitudes that stand for its parameters."""

from __future__ import annotations

import numpy as np

from tracker.arrays import ComplexArray, FloatArray


def free_decay(
    time_s: FloatArray, omega_n_rad_s: float, zeta: float, x0: float, v0_per_s: float
) -> FloatArray:
    """Displacement of an underdamped mode released at time 0 with x0 and v0.

    Parameters
    ----------
    time_s : array, shape (n,)
    omega_n_rad_s : float
        Undamped natural angular frequency.
    zeta : float
        Damping ratio, 0 <= zeta < 1.
    x0, v0_per_s : float
        Displacement and velocity at time 0.

    Returns
    -------
    array, shape (n,)

    Notes
    -----
    Eq. 1 of Yoo, Lee & Kim, "Tracking for high-order damping of thin beam oscillation":
    ``x = exp(-zeta w_n t) (x0 cos w_d t + (v0 + zeta w_n x0) / w_d sin w_d t)``.
    """
    omega_d = omega_n_rad_s * np.sqrt(1.0 - zeta**2)
    sine = (v0_per_s + zeta * omega_n_rad_s * x0) / omega_d
    envelope = np.exp(-zeta * omega_n_rad_s * time_s)
    return np.asarray(envelope * (x0 * np.cos(omega_d * time_s) + sine * np.sin(omega_d * time_s)))


def pole(omega_n_rad_s: float | FloatArray, zeta: float | FloatArray) -> ComplexArray:
    """Pole ``-zeta w_n + i w_n sqrt(1 - zeta^2)`` in 1/s."""
    omega, ratio = np.asarray(omega_n_rad_s), np.asarray(zeta)
    return np.asarray(-ratio * omega + 1j * omega * np.sqrt(1.0 - ratio**2))


def frequency_hz(poles: ComplexArray | complex) -> FloatArray:
    """Undamped natural frequency of each pole in Hz."""
    return np.asarray(np.abs(poles) / (2.0 * np.pi))


def damping_ratio(poles: ComplexArray | complex) -> FloatArray:
    """Damping ratio of each pole; negative for a growing motion."""
    values = np.asarray(poles, dtype=complex)
    return np.asarray(-values.real / np.abs(values))


def complex_amplitude(poles: complex, x0: float, v0_per_s: float) -> complex:
    """Amplitude c with ``Re(c exp(lambda t))`` equal to Eq. 1 started at x0 and v0."""
    decay, omega_d = -poles.real, poles.imag
    return complex(x0, -(v0_per_s + decay * x0) / omega_d)


def initial_conditions(poles: complex, amplitude: complex) -> tuple[float, float]:
    """Displacement and velocity at time 0: the inverse of `complex_amplitude`."""
    return amplitude.real, (poles * amplitude).real
