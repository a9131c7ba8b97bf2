"""Errors of envelope and phase of a simulated decay."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tracker import ComplexArray, FloatArray

# least number of periods and of samples in a window, which holds whole periods of the mode
_PERIODS, _SAMPLES = 2, 12


def envelope_and_phase_error(
    time_s: FloatArray, measured: FloatArray, simulated: FloatArray, omega_rad_s: float
) -> tuple[float, float]:
    """Errors of amplitude and phase of a simulated motion, demodulated at `omega_rad_s`; NaN where it was not measured.

    Returns
    -------
    envelope : float
        rms of the difference of the amplitudes over the decay, relative to the rms of the measured amplitude.
    phase_rad : float
        rms of the difference of the phases, weighted by the square of the measured amplitude.

    Notes
    -----
    Amplitude and phase in each window of whole periods are those of a least squares sine with an offset. NaN for a
    record shorter than one window.
    """
    known = np.isfinite(measured)
    one = _amplitudes(time_s, np.where(known, measured, 0.0), known, omega_rad_s)
    other = _amplitudes(time_s, np.where(known, simulated, 0.0), known, omega_rad_s)
    power = np.abs(one) ** 2
    if not power.sum() > 0.0:
        return float("nan"), float("nan")
    envelope = np.sum((np.abs(other) - np.abs(one)) ** 2)
    phase = np.angle(other * np.conj(one))
    return float(np.sqrt(envelope / power.sum())), float(np.sqrt(power @ phase**2 / power.sum()))


def _amplitudes(
    time_s: FloatArray, values: FloatArray, known: NDArray[np.bool_], omega_rad_s: float
) -> ComplexArray:
    """Complex amplitude in each window, relative to ``exp(i omega t)``."""
    period_s = 2.0 * np.pi / omega_rad_s
    interval_s = float(np.median(np.diff(time_s))) if time_s.size > 1 else np.inf
    span_s = period_s * max(_PERIODS, np.ceil(_SAMPLES * interval_s / period_s))
    found = []
    for begin in np.arange(time_s[0], time_s[-1] - span_s + interval_s, span_s):
        inside = known & (time_s >= begin) & (time_s < begin + span_s)
        if np.count_nonzero(inside) < _SAMPLES // 2:
            continue
        carrier = np.exp(1j * omega_rad_s * time_s[inside])
        columns = np.stack([carrier.real, -carrier.imag, np.ones(carrier.size)], axis=1)
        cosine, sine, _ = np.linalg.lstsq(columns, values[inside], rcond=None)[0]
        found.append(complex(cosine, sine))
    return np.array(found, dtype=np.complex128)
