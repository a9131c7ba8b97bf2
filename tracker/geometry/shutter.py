"""Shutter effects: rolling shutter brought to one time, and attenuation of vibration by the exposure."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tracker.arrays import FloatArray
from tracker.checks import checked


@dataclass(frozen=True)
class Tuning:
    """Limits of the corrections for the shutter."""

    #: [1] steps that differ by more than this share of their mean are uneven
    #: physics: the error of a value moved by half a step then is a twothousandth of its change from frame to frame
    uneven: float = 1e-3
    #: [1] product of frequency and exposure beyond which an amplitude is not corrected
    #: convention: the factor is 0.50 there and falls to zero at 1
    largest_product: float = 0.6


TUNING = Tuning()

# Samples of the interpolating polynomial of degree 4, in steps from the shifted one.
_NODES = np.arange(-2.0, 3.0)


def row_delay_s(y_px: FloatArray, height_px: int, readout_s: float) -> FloatArray:
    """Delay of a row relative to the middle row; shape of `y_px`. Negative readout: from the bottom."""
    return readout_s * (y_px - 0.5 * (height_px - 1)) / max(height_px - 1, 1)


def to_common_time(
    time_s: FloatArray, values: FloatArray, sd: FloatArray, delay_s: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Values at `time_s` of k channels that were exposed `delay_s` later, and their sd; shapes (n,), (n, k), (k,).

    NaN where a required neighbour is missing: two on each side at even steps, one at uneven ones.

    Notes
    -----
    At even steps a polynomial of degree 4 through five samples is evaluated `delay_s` earlier; at uneven ones a line
    along the central difference. At a tenth of the sampling rate and a delay of half a step, the error of the
    polynomial is 0.12 % of the amplitude. A marker's row is assumed constant: its own motion across rows, which shifts
    its time by displacement times readout over height, is neglected.
    """
    if time_s.size < _NODES.size:
        return np.full(values.shape, np.nan), np.full(values.shape, np.nan)
    steps = np.diff(time_s)
    step = float(np.mean(steps))
    if float(np.max(np.abs(steps - step))) > TUNING.uneven * step:
        velocity = np.gradient(values, time_s, axis=0)
        return values - delay_s * velocity, sd * np.sqrt(1.0 + 0.5 * (delay_s / step) ** 2)
    weights = _lagrange(-delay_s / step)
    windows = np.lib.stride_tricks.sliding_window_view(values, _NODES.size, axis=0)
    moved = np.full(values.shape, np.nan)
    moved[2:-2] = np.einsum("nkj,kj->nk", windows, weights)
    return moved, sd * np.sqrt(np.sum(weights**2, axis=1))


def _lagrange(at: FloatArray) -> FloatArray:
    """Weights of the nodes' values at positions `at` of shape (k,), in steps; shape (k, 5)."""
    weights = np.ones((at.size, _NODES.size))
    for j, node in enumerate(_NODES):
        for other in _NODES[node != _NODES]:
            weights[:, j] *= (at - other) / (node - other)
    return weights


def exposure_attenuation(frequency_hz: float, exposure_s: float) -> float:
    """Observed over true amplitude of a sinusoid that each frame averages over its exposure.

    sin(pi f T) / (pi f T): 1 for zero exposure, 0 for a whole period, negative beyond.

    Raises
    ------
    ValueError
        If either is negative or not finite.

    Notes
    -----
    The mean of exp(i omega t) over T about the middle of the exposure. The registered position of a blurred marker is
    this mean, whether or not the template includes the blur, because the blur is symmetric about it. Biased where the
    motion within one exposure deviates strongly from a straight line and the blur is wider than the marker's details.
    """
    checked("frequency_hz", frequency_hz, at_least=0.0)
    checked("exposure_s", exposure_s, at_least=0.0)
    phase = math.pi * frequency_hz * exposure_s
    return math.sin(phase) / phase if phase > 0.0 else 1.0
