"""Rest in the first cycles of a record, too short to show in the envelope."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modal_id.data import FitData
from tracker import FloatArray


@dataclass(frozen=True)
class Tuning:
    """Rest before the motion."""

    #: [sd] deviation that samples at rest do not exceed
    #: statistics: Noise exceeds it once in 5e8 samples.
    within: float = 6.0
    #: [sd] least amplitude of a motion after rest
    #: physics: Half a cycle of such a motion exceeds the limit of rest.
    moves: float = 15.0
    #: [samples] shortest rest
    least_samples: int = 10
    #: [cycles] longest rest that is looked for
    #: physics: Longer rest shows in the envelope.
    most_cycles: float = 6.0
    #: [cycles] length of the motion examined after the rest
    motion_cycles: float = 2.0


TUNING = Tuning()


def rest_until(data: FitData, variance: FloatArray, frequency_hz: float) -> float | None:
    """Time of the last sample at rest, where a motion of this frequency begins in the first cycles of the record.

    `variance`, shape (k,), is the noise variance of each channel. None where the record moves within its first half
    cycle, or where no motion follows.
    """
    cycle = 1.0 / (frequency_hz * data.step_s)
    first = max(TUNING.least_samples, int(np.ceil(0.5 * cycle)))
    part = data.rows(slice(0, int((TUNING.most_cycles + TUNING.motion_cycles) * cycle) + first))
    used = part.weights > 0.0
    if part.time_s.size <= 2 * first or not np.all(np.any(used[:first], axis=0)):
        return None
    values = np.where(used, part.values, np.nan)
    level = np.nanmedian(values[:first], axis=0)
    size = np.nan_to_num(np.abs(values - level) * np.sqrt(part.weights / variance))
    moving = np.any(size > TUNING.within, axis=1)
    begin = int(np.argmax(moving))
    follows = size[begin : begin + int(TUNING.motion_cycles * cycle) + 1]
    if (
        not moving[begin]
        or begin < first
        or begin > TUNING.most_cycles * cycle
        or np.max(follows) < TUNING.moves
    ):
        return None
    return float(part.time_s[begin - 1])
