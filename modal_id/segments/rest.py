"""Rest in the first cycles of a record, too short to show in the envelope."""

from __future__ import annotations

import numpy as np

from modal_id.data import FitData
from tracker import FloatArray

# Standard deviations of noise that samples at rest do not exceed, and that the amplitude of the motion exceeds; half a
# cycle of such a motion exceeds the former.
_WITHIN, _MOVES = 6.0, 15.0
_LEAST_SAMPLES = 10
# Longer rest shows in the envelope.
_MOST_CYCLES = 6.0
_MOTION_CYCLES = 2.0


def rest_until(data: FitData, variance: FloatArray, frequency_hz: float) -> float | None:
    """Time of the last sample at rest, where a motion of this frequency begins in the first cycles of the record.

    `variance`, shape (k,), is the noise variance of each channel. None where the record moves within its first half
    cycle, or where no motion follows.
    """
    cycle = 1.0 / (frequency_hz * data.step_s)
    first = max(_LEAST_SAMPLES, int(np.ceil(0.5 * cycle)))
    part = data.rows(slice(0, int((_MOST_CYCLES + _MOTION_CYCLES) * cycle) + first))
    used = part.weights > 0.0
    if part.time_s.size <= 2 * first or not np.all(np.any(used[:first], axis=0)):
        return None
    values = np.where(used, part.values, np.nan)
    level = np.nanmedian(values[:first], axis=0)
    size = np.nan_to_num(np.abs(values - level) * np.sqrt(part.weights / variance))
    moving = np.any(size > _WITHIN, axis=1)
    begin = int(np.argmax(moving))
    follows = size[begin : begin + int(_MOTION_CYCLES * cycle) + 1]
    if not moving[begin] or begin < first or begin > _MOST_CYCLES * cycle or np.max(follows) < _MOVES:
        return None
    return float(part.time_s[begin - 1])
