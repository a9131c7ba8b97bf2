"""Types of the arrays that all four packages pass around, and the numbers by which they state a spread.

NumPy's type hints carry the element type only, so a docstring states each array's shape and unit. Missing values are
NaN in floating-point arrays.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

# positions, times, frequencies, matrices
FloatArray: TypeAlias = NDArray[np.float64]

# spectra, complex amplitudes, poles
ComplexArray: TypeAlias = NDArray[np.complex128]

# frame numbers, indices, counts
IntArray: TypeAlias = NDArray[np.int64]

# masks
BoolArray: TypeAlias = NDArray[np.bool_]

# quality flags, one bit per entry of a registry (`tracker.flags`, `modal_id.sentences`)
FlagArray: TypeAlias = NDArray[np.uint32]

# one decoded frame, shape (height, width), rows from the top
GrayImage: TypeAlias = NDArray[np.uint8] | NDArray[np.uint16]

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
