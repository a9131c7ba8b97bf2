"""Draws of a posterior widened by a model error."""

from __future__ import annotations

import numpy as np
from scipy.special import ndtri

from tracker import FloatArray


def widened(
    frequencies_hz: FloatArray,
    zetas: FloatArray,
    extra_sd: tuple[float, float],
    rng: np.random.Generator,
) -> tuple[FloatArray, FloatArray]:
    """Draws of frequency and damping ratio plus a normal error of standard deviations `extra_sd`, in any shape.

    The medians do not change. Damping ratios stay positive: a sum below half of the draw is mapped by an exponential
    that joins smoothly. A reflection at zero would raise the median.
    """
    # Normal scores in random order: the sum of the errors is zero.
    scores = ndtri((np.arange(zetas.size) + 0.5) / zetas.size)
    wide_hz = frequencies_hz + extra_sd[0] * rng.permutation(scores).reshape(zetas.shape)
    wide = zetas + extra_sd[1] * rng.permutation(scores).reshape(zetas.shape)
    half = 0.5 * zetas
    return wide_hz, np.where(wide < half, half * np.exp(np.minimum(wide / half, 1.0) - 1.0), wide)
