"""What errors of positions that return with the motion add to the standard deviations of mode shapes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from modal_id.data import FitData
from modal_id.solve import LinearSolution
from tracker import FloatArray, PositionErrors

# A part of the samples determines these standard deviations well enough; they are spread by the golden section, which
# has no common period with the motion.
_SAMPLES, _GOLDEN = 2048, 0.6180339887498949


def repeating_shape_sd(
    data: FitData, linear: LinearSolution, errors: PositionErrors | None, channels: NDArray[np.intp]
) -> FloatArray:
    """Standard deviations of the shapes of m modes in k channels due to periodic errors; shape (m, k).

    Parameters
    ----------
    channels : int array, shape (k,)
        Index in `errors` of each channel of `linear`.

    Notes
    -----
    Noise averages out over the samples, a function of the position does not: its part that is proportional to the
    motion is the same in every cycle. That part is the projection of the periodic functions, whose multiples
    are normal, on the modes; both real and imaginary parts take all of it, since its phase is that of the motion.
    """
    modes_count, channels_count = linear.amplitudes.shape
    sd = np.zeros((modes_count, channels_count))
    if errors is None or not errors.periodic_sd.size:
        return sd
    count = data.time_s.size
    rows = np.arange(count)
    if count > _SAMPLES:
        rows = np.unique((np.arange(1, _SAMPLES + 1) * _GOLDEN % 1.0 * count).astype(np.intp))
    columns = np.ascontiguousarray(linear.columns[rows])
    project = np.linalg.pinv(columns)
    modes = columns.view(np.complex128)
    for k, channel in enumerate(channels.tolist()):
        functions = errors.periodic(channel, np.real(modes @ linear.amplitudes[:, k]))
        parts = project @ (functions - functions.mean(axis=0))
        sd[:, k] = np.sqrt(np.sum((parts**2).reshape(modes_count, -1), axis=1))
    return sd
