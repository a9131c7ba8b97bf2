"""Rolling shutter: each marker seen at the time of its row, moved to the time of the middle row."""

from __future__ import annotations

import math

import numpy as np

from tracker.arrays import FloatArray

# Samples through which the polynomial of degree 4 goes, in steps from the one that is moved.
_NODES = np.arange(-2.0, 3.0)
# Steps that differ by more than this share of their mean are uneven.
_UNEVEN = 1e-3


def row_delay_s(y_px: FloatArray, height_px: int, readout_s: float) -> FloatArray:
    """Time by which a row is read later than the middle row; shape as `y_px`.

    Parameters
    ----------
    readout_s : float
        Time from the first row's exposure to the last one's; negative for a sensor read from below.
    """
    return readout_s * (y_px - 0.5 * (height_px - 1)) / max(height_px - 1, 1)


def to_common_time(
    time_s: FloatArray, values: FloatArray, sd: FloatArray, delay_s: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Values at `time_s` of channels that were seen `delay_s` later, and their standard deviations.

    Parameters
    ----------
    time_s : array, shape (n,)
    values, sd : array, shape (n, k)
    delay_s : array, shape (k,)

    Returns
    -------
    two arrays, shape (n, k)
        NaN where a neighbour that the velocity needs is missing: two on each side at even steps, one at uneven ones.

    Notes
    -----
    At even steps a polynomial of degree 4 through five samples is read `delay_s` earlier; at uneven ones a straight
    line along the central difference. At a tenth of the sampling rate and a delay of half a step the polynomial is
    off by 0.12 % of the amplitude. A marker's row is taken as constant: its own motion across rows, which shifts its
    time by displacement times readout over height, is left out.
    """
    if time_s.size < _NODES.size:
        return np.full(values.shape, np.nan), np.full(values.shape, np.nan)
    steps = np.diff(time_s)
    step = float(np.mean(steps))
    if float(np.max(np.abs(steps - step))) > _UNEVEN * step:
        velocity = np.gradient(values, time_s, axis=0)
        return values - delay_s * velocity, sd * np.sqrt(1.0 + 0.5 * (delay_s / step) ** 2)
    weights = _lagrange(-delay_s / step)
    windows = np.lib.stride_tricks.sliding_window_view(values, _NODES.size, axis=0)
    moved = np.full(values.shape, np.nan)
    moved[2:-2] = np.einsum("nkj,kj->nk", windows, weights)
    return moved, sd * np.sqrt(np.sum(weights**2, axis=1))


def _lagrange(at: FloatArray) -> FloatArray:
    """Weights of the nodes' values at places `at` of shape (k,), in steps; shape (k, 5)."""
    weights = np.ones((at.size, _NODES.size))
    for j, node in enumerate(_NODES):
        for other in _NODES[node != _NODES]:
            weights[:, j] *= (at - other) / (node - other)
    return weights


# Beyond this product of frequency and exposure the factor falls fast to zero, and dividing by it says little.
LARGEST_PRODUCT = 0.6


def exposure_attenuation(frequency_hz: float, exposure_s: float) -> float:
    """Amplitude seen over true amplitude of a sinusoid that each frame averages over its exposure.

    Parameters
    ----------
    frequency_hz, exposure_s : float
        Not negative.

    Returns
    -------
    float
        sin(pi f T) / (pi f T): 1 for no exposure, 0 when it lasts a whole period, negative beyond.

    Raises
    ------
    ValueError
        If either is negative or not finite.

    Notes
    -----
    The mean of exp(i omega t) over T about the middle of the exposure. A position that registration takes from a
    blurred marker is that mean, whether the blur is in the template or not: the blur is even about it. Biased where
    the motion within one exposure is far from a straight line and its blur wider than the marker's details, and for
    a global shutter only in that all markers share the time.
    """
    if not (math.isfinite(frequency_hz) and frequency_hz >= 0.0):
        msg = f"frequency_hz must be finite and not negative, got {frequency_hz}"
        raise ValueError(msg)
    if not (math.isfinite(exposure_s) and exposure_s >= 0.0):
        msg = f"exposure_s must be finite and not negative, got {exposure_s}"
        raise ValueError(msg)
    phase = math.pi * frequency_hz * exposure_s
    return math.sin(phase) / phase if phase > 0.0 else 1.0
