"""Whether a fit is the marker."""

from __future__ import annotations

import numpy as np
from numba import njit

from tracker.arrays import FloatArray
from tracker.register import kernel

# A fit is accepted when the template explains this share of the image, or its residual is noise.
LEAST_CORRELATION = 0.85
GOOD_CHI2 = 3.0
# Chi-square by which the template must improve on a uniform surface: five standard deviations.
LEAST_SIGNAL = 25.0
LEAST_SEEN_SHARE = 0.45


@njit(cache=True, nogil=True, error_model="numpy")
def correlation(result: FloatArray) -> float:
    """Correlation of pixels and template after a fit, 0 where it failed."""
    if result[kernel.CONVERGED] == 0.0:
        return 0.0
    signal, rest = result[kernel.SIGNAL], result[kernel.CHI2]
    return float(np.sqrt(signal / (signal + rest))) if signal + rest > 0.0 else 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def acceptable(result: FloatArray, gain: float, typical_chi2: float, least: float) -> bool:
    """Whether a fit is the marker; `gain` is that of the last good fit or NaN, `least` the smallest correlation."""
    if result[kernel.CONVERGED] == 0.0 or result[kernel.SEEN] < LEAST_SEEN_SHARE:
        return False
    # A template without contrast explains a uniform surface perfectly: that is no marker.
    if result[kernel.SIGNAL] * result[kernel.PIXELS] < LEAST_SIGNAL:
        return False
    if np.isfinite(gain) and not 0.3 < result[kernel.GAIN] / gain < 3.0:
        return False
    # With low contrast the correlation is low even for a good fit: then the noise decides.
    noise_explains = result[kernel.CHI2] < GOOD_CHI2 * typical_chi2 and least <= LEAST_CORRELATION
    return correlation(result) >= least or noise_explains
