"""Types of the arrays that all four packages pass around.

NumPy's type hints carry the element type only, so a docstring states each array's shape and unit. Missing values are
NaN in floating-point arrays.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

# positions, times, frequencies, matrices
FloatArray: TypeAlias = NDArray[np.float64]

# spectra, complex amplitudes, poles
ComplexArray: TypeAlias = NDArray[np.complex128]

# frame numbers, indices, counts
IntArray: TypeAlias = NDArray[np.int64]

# masks
BoolArray: TypeAlias = NDArray[np.bool_]

# quality flags, one bit per entry of a registry (`tracker.flags`, `modal_id.flags`)
FlagArray: TypeAlias = NDArray[np.uint32]

# one decoded frame, shape (height, width), rows from the top
GrayImage: TypeAlias = NDArray[np.uint8] | NDArray[np.uint16]
