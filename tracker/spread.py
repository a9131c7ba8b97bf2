"""Numbers by which the four packages state a spread: the robust standard deviation."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

# Standard deviation of a normal density over its median modulus, and the inverse; each is rounded by itself.
MAD_TO_SD = 1.4826
MEDIAN_MODULUS = 0.6745


def robust_sd(residual: ArrayLike) -> float:
    """Standard deviation about zero, by the median modulus of values of any shape; NaN without values."""
    return MAD_TO_SD * float(np.median(np.abs(residual)))
