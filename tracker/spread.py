"""Numbers by which the four packages state a spread: the robust standard deviation and the 90 % interval."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

# Standard deviation of a normal density over its median modulus, and the inverse; each is rounded by itself.
MAD_TO_SD = 1.4826
MEDIAN_MODULUS = 0.6745
# Probability inside an interval where no other one is asked for, and the quantiles of draws at its ends.
INTERVAL_LEVEL = 0.9
INTERVAL_ENDS = (0.05, 0.95)
# Its half width for a normal density, in standard deviations.
INTERVAL_SD = 1.6448536269514722


def robust_sd(residual: ArrayLike) -> float:
    """Standard deviation about zero, by the median modulus of values of any shape; NaN without values."""
    return MAD_TO_SD * float(np.median(np.abs(residual)))
