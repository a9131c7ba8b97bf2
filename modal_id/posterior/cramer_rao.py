"""Cramer-Rao bound of the frequency and damping ratio of a free decay measured by several markers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modal_id.data import bandwidth_hz, baseline_matrix
from modal_id.solve import modal_slopes
from modal_id.solve import pole as modal_pole
from tracker import FloatArray


@dataclass(frozen=True)
class ModalBound:
    """Smallest standard deviations of an unbiased estimate of the undamped natural frequency and the damping ratio."""

    frequency_sd_hz: float
    damping_sd: float


def modal_bound(
    time_s: FloatArray,
    frequency_hz: float,
    damping_ratio: float,
    amplitude: FloatArray,
    phase_rad: float,
    sd: FloatArray,
    *,
    with_drift: bool = True,
) -> ModalBound:
    """Bound for one mode with white noise of known standard deviation.

    Parameters
    ----------
    time_s : array, shape (n,)
        From the start of the free decay.
    frequency_hz, damping_ratio : float
    amplitude : array, shape (m,)
        Of each marker at time 0, signed, in the unit of `sd`.
    phase_rad : float
        Of ``cos(w_d t + phase)``, common to the markers.
    sd : array, shape (n, m) or (m,)
        Of each sample.
    with_drift : bool
        Whether offset and slow drift of each marker are unknown too, as in `identify`.

    Returns
    -------
    ModalBound
        Infinite where the record does not determine the parameters.

    Notes
    -----
    Frequency and damping are common to the markers; amplitude and phase belong to each marker. For normal noise the
    Fisher information of the pole is the sum over markers of the derivatives by the pole with each marker's own
    unknowns projected out (Kay, Fundamentals of Statistical Signal Processing, 1993, 3.9). The phase is taken as
    common; over many cycles this changes nothing.
    """
    pole = complex(modal_pole(2.0 * np.pi * frequency_hz, damping_ratio))
    wave = np.exp(pole * time_s + 1j * phase_rad)
    nuisance = [wave.real, wave.imag]
    if with_drift:
        nuisance += list(baseline_matrix(time_s, bandwidth_hz(frequency_hz)).T)
    # Derivatives of Re(exp(pole t)) by the real and the imaginary part of the pole come last.
    columns = np.column_stack([*nuisance, time_s * wave.real, -time_s * wave.imag])
    precision = 1.0 / np.broadcast_to(np.asarray(sd, dtype=np.float64), (time_s.size, amplitude.size)) ** 2
    information = np.zeros((2, 2))
    left = np.ones(amplitude.size, dtype=bool)
    while np.any(left):
        # Markers with the same precision at all times differ in amplitude only.
        weights = precision[:, np.argmax(left)]
        same = left & np.all(precision == weights[:, None], axis=0)
        information += float(np.sum(amplitude[same] ** 2)) * _projected(columns, weights)
        left &= ~same
    if not np.linalg.det(information) > 0.0:
        return ModalBound(float("inf"), float("inf"))
    slopes = modal_slopes(pole) / [[2.0 * np.pi], [1.0]]  # of the frequency in Hz
    sd = np.sqrt(np.diag(slopes @ np.linalg.inv(information) @ slopes.T))
    return ModalBound(float(sd[0]), float(sd[1]))


def _projected(columns: FloatArray, precision: FloatArray) -> FloatArray:
    """Information of the last two columns with the others projected out, shape (2, 2)."""
    scaled = columns / np.sqrt(np.mean(columns**2, axis=0))
    gram = (scaled * precision[:, None]).T @ scaled
    inner, cross, outer = gram[:-2, :-2], gram[:-2, -2:], gram[-2:, -2:]
    rest = outer - cross.T @ np.linalg.lstsq(inner, cross, rcond=1e-12)[0]
    size = np.sqrt(np.mean(columns[:, -2:] ** 2, axis=0))
    return np.asarray(rest * np.outer(size, size))
