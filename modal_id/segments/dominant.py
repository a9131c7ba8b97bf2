"""Frequency of the dominant motion of a record."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modal_id.data import FitData, detrended
from modal_id.fit import Candidate, candidates
from modal_id.segments.swing import FEW_CYCLES
from tracker import FloatArray

# Shares of the record in which the dominant motion is looked for, each at every half of its length.
_WINDOWS = (1.0, 0.25, 0.0625)


@dataclass(frozen=True)
class Tuning:
    """The dominant motion."""

    #: [samples] shortest window
    least_window: int = 32
    #: [1] logarithm of the ratio of frequencies within which windows show one line
    same_line: float = 0.2
    #: [cycles] shortest window
    least_window_cycles: float = 6.0


TUNING = Tuning()


def dominant_hz(
    data: FitData, variance: FloatArray, lowest_hz: float, wanted_hz: float | None
) -> float | None:
    """Frequency of the strongest line of any window, or of the line nearest to the wanted frequency."""
    found: list[Candidate] = []
    for share in _WINDOWS:
        length = int(share * data.time_s.size)
        if length < min(TUNING.least_window, data.time_s.size):
            continue
        for first in range(0, data.time_s.size - length + 1, max(length // 2, 1)):
            part = data.rows(slice(first, first + length))
            # In part of the record, the curvature of a swing may appear as a line of a few cycles.
            least_hz = lowest_hz if share == 1.0 else max(lowest_hz, TUNING.least_window_cycles / part.span_s)
            found += candidates(part, detrended(part), variance, least_hz, ())
    if not found:
        return None
    if wanted_hz is not None:
        nearest = min((c.frequency_hz for c in found), key=lambda f: abs(np.log(f / wanted_hz)))
        found = [c for c in found if abs(np.log(c.frequency_hz / nearest)) < TUNING.same_line]
    # A swing of few cycles is a motion of the support, if there is anything faster.
    many = [c for c in found if c.frequency_hz * data.span_s > FEW_CYCLES]
    return max(many or found, key=lambda c: c.score).frequency_hz
