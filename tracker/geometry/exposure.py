"""What the exposure time takes from an amplitude."""

from __future__ import annotations

import math

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
